"""Needs against set-ups: a table, and what to take."""

from __future__ import annotations

from collections.abc import Sequence

from linkrover.analysis.needs import Fit

from .table import Column, Table


def need_table(fits: Sequence[Fit]) -> Table:
    """Every need against every case, best first."""
    columns = (
        Column("need"),
        Column("case"),
        Column("trials that met it"),
        Column("chance for the next trial (%)", 0),
        Column("nearest to failing"),
        Column("area where it was met (%)", 0),
        Column("verdict"),
    )
    table = Table("Needs and set-ups", columns, name="needs")
    for f in fits:
        chance = 100 * f.certainty if f.certainty is not None else None
        met = f"{f.met} of {f.trials}"
        table.rows.append([f.need, f.case, met, chance, f.worst, f.area_percent, f.verdict])
    table.notes.append(
        "The chance is that of a further trial like these (predictive t distribution over trials); with one trial it "
        "is not known. Throughput is what was carried: where less was offered, the link may carry more."
    )
    return table


def need_words(fits: Sequence[Fit]) -> list[str]:
    """One sentence a need: which case to take, and how sure that is."""
    words = []
    for need in dict.fromkeys(f.need for f in fits):
        found = [f for f in fits if f.need == need]
        met = [f for f in found if f.verdict == "met"]
        tried = [f for f in found if f.met == f.trials and f not in met]
        if met:
            chances = f"at least {100 * min(f.certainty or 0.0 for f in met):.0f} % for the next trial"
            words.append(f"{need}: take {' or '.join(f.case for f in met)} ({chances}).")
        elif tried:
            names = " or ".join(f.case for f in tried)
            words.append(f"{need}: {names} met it in every trial, but too few were driven to be sure; drive more.")
        else:
            best = found[0]
            nearest = f"{best.case} ({best.worst or best.verdict})"
            words.append(f"{need}: no set-up met it in all trials; nearest is {nearest}.")
    return words

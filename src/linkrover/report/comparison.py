"""Tables and sentences on differences: what is supported, what is not, what would settle it."""

from __future__ import annotations

from collections.abc import Sequence

from linkrover.analysis.effects import METRICS, Effect, metric_value
from linkrover.analysis.regression import Verdict
from linkrover.analysis.summary import RunSummary

from .table import Better, Column, Table
from .tables import CASE_WORDS

FACTOR_WORDS = {"ap": "access point", "band": "band", "adapter": "adapter", "motion": "motion"}


def case_table(summaries: Sequence[RunSummary]) -> Table | None:
    """Mean over the trials of each case and their spread; a trial is one value, never an average of averages."""
    import statistics

    cases: dict[str, list[RunSummary]] = {}
    for summary in summaries:
        if summary.case is not None:
            cases.setdefault(summary.case, []).append(summary)
    if len(cases) < 2:
        return None
    columns = [Column("case"), Column("trials", 0)]
    for metric in METRICS:
        unit = "%" if metric.unit == "points" else metric.unit
        better: Better = "high" if metric.better == "high" else "low"
        columns += [Column(f"{metric.name} ({unit})", better=better), Column("±")]
    table = Table("Cases over their trials", tuple(columns), name="cases")
    for found in (cases[case] for case in sorted(cases, key=case_key)):
        row: list[str | float | int | None] = [case_label(found[0]), len(found)]
        for metric in METRICS:
            values = [v for s in found if (v := metric_value(s, metric)) is not None]
            row.append(statistics.fmean(values) if values else None)
            row.append(statistics.stdev(values) if len(values) > 1 else None)
        table.rows.append(row)
    table.notes.append("± is the standard deviation between trials; unknown with one trial.")
    return table


def case_key(case: str) -> tuple[int, str]:
    """Numbers in their order, then names."""
    return (int(case), "") if case.isdigit() else (10**9, case)


def case_label(summary: RunSummary) -> str:
    """A case with its factors."""
    others = [summary.factors.get(k, "") for k in ("adapter", "band")]
    words = [CASE_WORDS.get(summary.factors.get("ap", ""), ""), *others]
    known = ", ".join(w for w in words if w)
    return f"{summary.case} ({known})" if known else str(summary.case)


def effect_table(effects: Sequence[Effect]) -> Table | None:
    """Every effect that can be judged: size and interval first, then the test."""
    known = [e for e in effects if e.interval is not None]
    if not known:
        return None
    columns = (
        Column("factor"),
        Column("figure"),
        Column("effect"),
        Column("95 % interval"),
        Column("p, corrected", 3),
        Column("trials", 0),
        Column("visible at 80 % power"),
        Column("verdict"),
    )
    table = Table("What a factor does", columns, name="effects")
    for e in known:
        assert e.interval is not None
        interval = f"{amount(e, e.interval[0])} to {amount(e, e.interval[1])}"
        figure = f"{e.metric}{f', matched by {e.matched}' if e.matched else ''}"
        verdict = "supported" if e.supported else "not supported"
        table.rows.append(
            [
                contrast(e),
                figure,
                amount(e, e.estimate),
                interval,
                e.p_adjusted if e.p_adjusted is not None else e.p_value,
                e.trials,
                amount(e, e.visible) if e.visible is not None else None,
                verdict,
            ]
        )
    table.notes.append(
        "The trial is the unit; levels are compared where the other factors are the same; p by permutation within "
        "such sets, corrected over all rows (Holm). Ratios are marked with ×."
    )
    return table


def contrast(effect: Effect) -> str:
    """The two levels, in words."""
    return f"{FACTOR_WORDS.get(effect.factor, effect.factor)}: {effect.high} against {effect.low}"


def amount(effect: Effect, value: float | None) -> str:
    """A ratio or a difference with its unit."""
    if value is None:
        return "unknown"
    return f"×{value:.2f}" if effect.ratio else f"{value:+.1f} {effect.unit}"


def effect_words(effects: Sequence[Effect]) -> list[str]:
    """What may be said: supported, not supported, and what would settle it."""
    words: list[str] = []
    supported = [e for e in effects if e.supported]
    for e in supported:
        assert e.interval is not None
        words.append(
            f"Supported: {contrast(e)} changes {_figure(e)} by {amount(e, e.estimate)} (95 %: "
            f"{amount(e, e.interval[0])} to {amount(e, e.interval[1])}; corrected p = {e.p_adjusted:.3f}, "
            f"{e.trials} trials)."
        )
    for e in effects:
        if e.interval is None or e.supported:
            continue
        words.append(
            f"Not supported: {contrast(e)}, {_figure(e)}: {amount(e, e.estimate)}, but anything from "
            f"{amount(e, e.interval[0])} to {amount(e, e.interval[1])} fits the data. {settle(e)}"
        )
    single = sorted({contrast(e) for e in effects if e.interval is None and e.estimate is not None})
    if single:
        words.append(
            f"Cannot be judged, one trial a set-up: {'; '.join(single)}. Two trials of each set-up give an interval."
        )
    unpaired = sorted({contrast(e) for e in effects if e.estimate is None})
    unpaired = [c for c in unpaired if not any(contrast(e) == c and e.estimate is not None for e in effects)]
    if unpaired:
        words.append(
            f"No comparison possible, no two set-ups differ in it alone: {'; '.join(unpaired)}. Drive both levels with "
            "everything else the same."
        )
    return words


def _figure(effect: Effect) -> str:
    return f"{effect.metric} at matched {effect.matched}" if effect.matched else effect.metric


def settle(effect: Effect) -> str:
    """What would settle an open question: the smallest visible effect, and how many trials the estimate needs."""
    parts = []
    if effect.visible is not None:
        parts.append(f"With these trials an effect below {amount(effect, effect.visible)} cannot be seen.")
    if effect.trials_needed is not None:
        parts.append(f"{effect.trials_needed} trials of each set-up would show one of the size estimated.")
    elif effect.strata:
        parts.append("An effect of the size estimated would need more than 200 trials of each set-up.")
    return " ".join(parts)


def regression_table(verdicts: Sequence[Verdict], *, stated: bool) -> Table:
    """New against base, limit by limit."""
    columns = (
        Column("limit" if stated else "figure"),
        Column("base", 2),
        Column("new", 2),
        Column("change (%)", 1),
        Column("95 % interval"),
        Column("verdict"),
    )
    table = Table("New run against base run", columns, name="compare")
    for v in verdicts:
        interval = f"{v.interval[0]:+.2f} to {v.interval[1]:+.2f}" if v.interval else ""
        if stated:
            verdict = "broken" if v.broken else v.reason or "kept"
        else:
            outside = v.interval is not None and not v.interval[0] <= 0 <= v.interval[1]
            verdict = v.reason or ("differs beyond noise" if outside else "within noise")
        table.rows.append([v.limit, v.base, v.new, v.change_percent, interval, verdict])
    what = "of the figure the limit speaks of" if stated else "of the change in the figure's unit"
    table.notes.append(f"Interval: {what}, from noise within the two runs; two drives of one set-up differ by more.")
    return table

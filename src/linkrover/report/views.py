"""From a run and its figures to what the HTML report draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path as FilePath

import msgspec
import numpy as np

from linkrover.analysis.addresses import owner_of_mac
from linkrover.analysis.channel import busy_shares
from linkrover.analysis.delay import Probes, application_probes, find_probes
from linkrover.analysis.link import signal_steps
from linkrover.analysis.recovery import recovery_sentence
from linkrover.analysis.run import HOLD_S, End, Run
from linkrover.analysis.stations import peer_signals
from linkrover.analysis.summary import RunSummary
from linkrover.records import Manifest

from .details import detail_sections
from .floor import Wall, estimated_maps, side_by_side
from .interactive import TITLES, Figure
from .page import Table as PageTable
from .place_words import place_words
from .run_words import summary_words
from .table import Table
from .tables import run_table
from .view import EventView, Line, OutageView, PartView, Path, RunView

MOST_RUNS_WITH_MAPS = 4


def view_of(run: Run, summary: RunSummary) -> RunView:
    """Everything the page shows of one run."""
    from .document import outage_table

    lines: list[Line] = []
    for role, end in run.ends.items():
        lines += _signal(run, role, end) + _survey(role, end) + _throughput(role, end)
    probes = find_probes(run)
    lines += _delays(run, probes)
    lines += _truth(run)
    tables = [run_table(summary), *([outage_table(summary)] if summary.outages else [])]
    return RunView(
        name=run.name,
        case=run.case or "",
        trial=run.trial,
        duration_s=summary.duration_s,
        summary=msgspec.to_builtins(summary),
        lines=tuple(lines),
        lost_t_s=probes.sent_s[np.isnan(probes.delay_ms)] if probes is not None else np.empty(0),
        path=_path(run),
        outages=tuple(OutageView(o.start_s, o.end_s) for o in summary.outages),
        events=_events(run),
        notes=(*summary_words(summary), *(place_words(run) if summary.method == "linkrover" else ())),
        tables=tuple(page_table(table) for table in tables),
        parts=tuple(
            PartView(part.heading, tuple(part.words), tuple(page_table(table) for table in part.tables))
            for part in detail_sections(summary)
        ),
        recoveries=tuple(recovery_sentence(r) for r in summary.recoveries),
        setup={role: _setup(end.manifest) for role, end in run.ends.items() if end.manifest is not None},
        problems=summary.problems,
        repairs=summary.repairs,
        kind=_kind(run),
    )


def views_of(runs: Sequence[Run], summaries: Sequence[RunSummary]) -> list[RunView]:
    """The views of several runs, in their order, under names that tell them apart ("trial-1" of ten cases)."""
    views = [view_of(run, summary) for run, summary in zip(runs, summaries, strict=True)]
    if len({view.name for view in views}) < len(views):
        views = [replace(view, name=f"{view.case}/{view.name}" if view.case else view.name) for view in views]
    seen: dict[str, int] = {}
    for i, view in enumerate(views):
        seen[view.name] = seen.get(view.name, 0) + 1
        if seen[view.name] > 1:
            views[i] = replace(view, name=f"{view.name} ({seen[view.name]})")
    return views


def write_html(
    runs: Sequence[Run],
    summaries: Sequence[RunSummary],
    out: FilePath,
    needs: Sequence[str] = (),
    walls: Sequence[Wall] = (),
) -> None:
    """One HTML file without network access for these runs, with the comparison where there are several."""
    from .comparison import case_key
    from .document import comparison_sections
    from .html import write_page

    views = views_of(runs, summaries)
    maps = {
        view.name: drawn
        for view, run in zip(views, runs, strict=True)
        if (drawn := _maps(run, len(runs), walls)) is not None
    }
    views.sort(key=lambda view: (*case_key(view.case), view.trial or 0, view.name))
    sections = comparison_sections(summaries, runs, needs)
    floors = {kind: side_by_side(views, kind, walls) for kind in TITLES} if len(views) > 1 else {}
    write_page(
        views,
        out,
        comparison=[sentence for section in sections for sentence in section.words],
        tables=[page_table(table) for section in sections for table in section.tables],
        maps=maps,
        floors={TITLES[kind]: figure for kind, figure in floors.items() if figure is not None},
    )


def _maps(run: Run, among: int, walls: Sequence[Wall]) -> Figure | None:
    """Estimated maps; a Gaussian process takes about a second, so a page of many runs shows the RSSI's or none."""
    if run.pose is None or among > MOST_RUNS_WITH_MAPS:
        return None
    from linkrover.analysis.space import dead_zones, locate_anchor, surface

    quantities = ("rssi", "throughput", "delay") if among == 1 else ("rssi",)
    surfaces = [found for quantity in quantities if (found := surface(run, quantity)) is not None]
    return estimated_maps(surfaces, locate_anchor(run), dead_zones(run), walls) if surfaces else None


def page_table(table: Table) -> PageTable:
    """A table for the page."""
    words = {j for row in table.rows for j, value in enumerate(row) if isinstance(value, str)}
    return PageTable(
        name=table.name,
        caption=". ".join([table.title, " ".join(table.notes)]) if table.notes else table.title,
        head=tuple(column.heading for column in table.columns),
        rows=tuple(tuple(table.text(i, j) for j in range(len(table.columns))) for i in range(len(table.rows))),
        best=frozenset(table.best()),
        text_columns=frozenset(words or {0}),
    )


def _path(run: Run) -> Path | None:
    pose = run.pose
    if pose is None or len(pose["t_s"]) < 2:
        return None
    return Path(pose["t_s"], pose["x_m"], pose["y_m"])


def _signal(run: Run, role: str, end: End) -> list[Line]:
    found = []
    peers = peer_signals(run, role)
    several = {iface for iface, _, _ in peers}
    for iface, table in end.wireless.items():
        if iface in several:
            continue
        _, _, valid, _ = signal_steps(table, run.published_2021)
        rssi = np.where(valid, table["rssi_dbm"], np.nan)
        found.append(Line("rssi", f"RSSI at the {role} ({iface})", role, table["t_s"], rssi, iface=iface))
    for iface in several:
        mine = [(peer, table) for at, peer, table in peers if at == iface]
        # the path is this run's robot's: another one's signal is no colour for it
        ours = max(mine, key=lambda one: (owner_of_mac(run, one[0]) is not None, len(one[1]["t_s"])))[0]
        for peer, table in mine:
            rssi = np.where(table["inactive_ms"] > HOLD_S * 1e3, np.nan, table["rssi_dbm"])
            name = f"RSSI of {owner_of_mac(run, peer) or peer} at the {role} ({iface})"
            direction = "" if peer == ours else "other"
            found.append(Line("rssi", name, role, table["t_s"], rssi, iface=iface, direction=direction))
    return found


def _survey(role: str, end: End) -> list[Line]:
    """Channel utilisation and noise; of several channels those in use, else the one surveyed most."""
    used = {key: table for key, table in end.surveys.items() if (table["in_use"] == 1).any()}
    if not used and end.surveys:
        most = max(end.surveys, key=lambda key: len(end.surveys[key]["t_s"]))
        used = {most: end.surveys[most]}
    found = []
    for (iface, mhz), table in used.items():
        share, _ = busy_shares(table)
        where = f"at the {role} ({iface}, {mhz} MHz)"
        found.append(Line("channel", f"channel busy {where}", role, table["t_s"], 100.0 * share, iface=iface))
        found.append(Line("noise", f"noise {where}", role, table["t_s"], table["noise_dbm"], iface=iface))
    return found


def _throughput(role: str, end: End) -> list[Line]:
    found = []
    for iface, table in end.utilization.items():
        length = np.maximum(table["t_s"] - table["begin_s"], 1e-9)
        for direction, word in (("tx", "sent"), ("rx", "received")):
            rate = np.where(table["has_base"], table[f"{direction}_bits"] / length / 1e6, np.nan)
            name = f"{word} by the {role} ({iface})"
            found.append(Line("throughput", name, role, table["t_s"], rate, iface=iface, direction=direction))
        both = np.where(table["has_base"], (table["tx_bits"] + table["rx_bits"]) / length / 1e6, np.nan)
        name = f"sent + received by the {role} ({iface})"
        found.append(Line("throughput", name, role, table["t_s"], both, iface=iface, direction="both"))
    return found


def _delays(run: Run, probes: Probes | None) -> list[Line]:
    found = []
    if probes is not None:
        name = {"stamp": "round trip (probe)"}.get(probes.source, f"round trip ({probes.source})")
        found.append(Line("delay", name, "robot", probes.sent_s, probes.delay_ms, method=probes.source))
    for role, end in run.ends.items():
        for method in end.delays:
            if probes is None or method == probes.source:
                continue
            other = application_probes(end, method, run.published_2021)
            found.append(Line("delay", f"round trip ({method})", role, other.sent_s, other.delay_ms, method=method))
    return found


def _events(run: Run) -> tuple[EventView, ...]:
    found = [
        EventView(t, role, event.kind.value, event.detail or event.kind.value)
        for role, end in run.ends.items()
        for t, event in end.events
    ]
    return tuple(sorted(found, key=lambda e: e.t_s))


def _truth(run: Run) -> list[Line]:
    """What the emulator knows of the RSSI, to lay beside what was read."""
    found = []
    for key, table in run.truth.items():
        kind, _, hop = key.partition(":")
        if kind == "LinkTruth" and np.isfinite(np.asarray(table["rssi_dbm"], dtype=np.float64)).any():
            rssi = np.asarray(table["rssi_dbm"], dtype=np.float64)
            found.append(Line("rssi", f"true RSSI {hop}", "truth", table["t_s"], rssi))
    return found


def _setup(manifest: Manifest) -> dict[str, str]:
    """The manifest, one value a line; an interface's values carry its name, absent ones are left out."""
    rows: dict[str, str] = {}
    for name, value in msgspec.to_builtins(manifest).items():
        if name == "interfaces":
            rows |= {
                f"{i['name']}: {k}": ", ".join(v) if isinstance(v, list) else str(v)
                for i in value
                for k, v in i.items()
                if k != "name" and v not in (None, [], "")
            }
        elif isinstance(value, dict):
            rows |= {k: str(v) for k, v in value.items() if name != "unknown"}
        elif value not in (None, "", [], False) and name not in ("wall_ns", "mono_ns", "record", "type"):
            rows[name] = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return rows


def _kind(run: Run) -> str:
    manifests = [end.manifest for end in run.ends.values() if end.manifest is not None]
    for word, flag in (("simulated", "simulated"), ("emulated", "emulated"), ("imported", "imported_from")):
        if any(getattr(m, flag) for m in manifests):
            return word
    return "measured"

"""The HTML report: what happened, how it was measured, figures to hover over, tables to take along."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

from linkrover import __version__

from . import interactive
from .page import Page, Table
from .view import RunView
from .words import interval, number, sentences

METHOD = (
    "Throughput is bits over the interface per second of elapsed time, received plus sent unless a direction is named.",
    "Round trips are timed by the clock named in the set-up; the time an answer spent inside the reflector is removed.",
    (
        "A probe without an answer within its deadline (2 s unless said) is lost; an outage is a stretch without any "
        "answered probe."
    ),
    (
        "Intervals are 95 % intervals by stationary block bootstrap within a run, since neighbouring samples resemble "
        "each other; between set-ups the trial is the unit."
    ),
    "TCP and UDP counters are of the whole machine by the kernel's nature, not of one interface.",
)


SURFACE = (
    "A Gaussian process fitted to the values along the way (at most 200 places), beside its standard error: trust the "
    "estimate only where the error is small. Star: the fixed end's antenna as the signal suggests; cross: dead zone."
)


def write_page(
    views: Sequence[RunView],
    out: FilePath,
    *,
    title: str = "LinkRover report",
    comparison: Sequence[str] = (),
    tables: Sequence[Table] = (),
    maps: dict[str, interactive.Figure] | None = None,
    floors: dict[str, interactive.Figure] | None = None,
) -> None:
    """Write the report of `views` to the one file `out`.

    comparison: what may be said about the set-ups, in sentences; tables: those of the comparison; maps: estimated
    maps by run name; floors: all runs side by side, by quantity.
    """
    page = Page(title)
    # Many runs on one page stay light: each line gets fewer points.
    most = 2000 if len(views) <= 4 else 700
    page.section("summary", "What happened")
    if len(views) == 1:
        page.words(sentences(views[0]), lead=True)
        page.cards(_cards(views[0]))
    else:
        page.words([f"{len(views)} runs over {len({v.case for v in views})} cases."], lead=True)
    page.warning(_problems(views))
    if len(views) > 1:
        page.table(_overview(views))
    if comparison or tables:
        page.section("comparison", "Comparing the set-ups")
        page.bullets(comparison)
        for table in tables:
            page.table(table)
    for quantity, figure in (floors or {}).items():
        page.heading(f"All runs on one scale: {quantity}")
        page.figure(f"floor-{quantity}", figure, f"paths of all runs coloured by {quantity} on one scale")
    for index, view in enumerate(views):
        _run(page, view, index, most, (maps or {}).get(view.name), alone=len(views) == 1)
    page.section("method", "Method and limits")
    page.bullets(METHOD)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(page.html(f"LinkRover {__version__}. One file, nothing is fetched."), encoding="utf-8")


def _problems(views: Sequence[RunView]) -> list[str]:
    """What is damaged or missing; the same in many runs is said once."""
    where: dict[str, list[str]] = {}
    for view in views:
        for problem in view.problems:
            where.setdefault(problem, []).append(view.name)
    return [
        f"{', '.join(names)}: {problem}"
        if len(names) <= 2
        else f"{problem} ({len(names)} of {len(views)} runs: {names[0]}, {names[1]}, ...)"
        for problem, names in where.items()
    ]


def _run(page: Page, view: RunView, index: int, most: int, surface: interactive.Figure | None, *, alone: bool) -> None:
    key = f"run{index}"
    page.section(key, view.name)
    page.badges([view.kind, f"case {view.case}", *([f"trial {view.trial}"] if view.trial is not None else [])])
    if not alone:
        page.words(sentences(view))
        page.cards(_cards(view))
    series = interactive.time_series(view, most)
    if series is not None and view.path is not None:
        step = max(1, len(view.path.t_s) // 3000)
        series["path"] = {
            "t": view.path.t_s[::step].round(3).tolist(),
            "x": view.path.x_m[::step].round(3).tolist(),
            "y": view.path.y_m[::step].round(3).tolist(),
        }
    if series is not None:
        page.heading("Over time")
        page.figure(f"{key}-series", series, f"radio, throughput and round trip of {view.name} over time")
    track = interactive.path_map(view, most)
    if track is not None:
        page.heading("Along the path")
        page.figure(f"{key}-map", track, f"path of the robot in {view.name}, coloured by what was measured there")
    if surface is not None:
        page.heading("Estimated over the floor")
        page.words([SURFACE])
        page.figure(f"{key}-surface", surface, f"estimated map of {view.name} with its standard error")
    spread = interactive.distributions(view)
    if spread is not None:
        page.heading("Distributions")
        page.figure(f"{key}-spread", spread, f"distributions of round trip and RSSI in {view.name}")
    if view.tables:
        page.heading("Figures")
    for table in view.tables:
        page.table(table)
    page.bullets(view.notes)
    for part in view.parts:
        page.heading(part.heading)
        page.bullets(part.words)
        for table in part.tables:
            page.table(table)
    if view.recoveries:
        page.heading("What came back when")
        page.bullets(view.recoveries)
    if view.events:
        page.fold(f"Timeline ({len(view.events)})", _event_table(view, key))
    if view.setup:
        page.fold("Set-up", _setup_table(view, key))
    if view.repairs:
        rows = tuple((repair,) for repair in view.repairs)
        page.fold(f"Repairs of the data ({len(rows)})", Table(f"{key}-repairs", "What was mended", ("repair",), rows))


def _cards(view: RunView) -> list[tuple[str, str]]:
    delay: dict[str, Any] = view.summary.get("delay_ms") or {}
    cards = []
    for end, figures in (view.summary.get("ends") or {}).items():
        for iface, values in (figures.get("interfaces") or {}).items():
            throughput = (values.get("throughput_mbps") or {}).get("mean")
            rssi = (values.get("rssi_dbm") or {}).get("mean")
            if throughput is not None and (throughput or rssi is not None):
                cards.append((f"{number(throughput)} Mbit/s", f"throughput, {end} {iface}"))
            if rssi is not None:
                cards.append((f"{number(rssi)} dBm", f"RSSI, {end} {iface}"))
    if delay.get("median") is not None:
        cards.append((f"{number(delay['median'])} ms", "round trip, median"))
    if delay.get("loss_percent") is not None:
        cards.append((f"{number(delay['loss_percent'])} %", "probes lost"))
    if view.of("delay"):
        out_s = sum(o.end_s - o.start_s for o in view.outages)
        what = "outage" if len(view.outages) == 1 else "outages"
        cards.append((f"{number(out_s)} s", f"in {len(view.outages)} {what}"))
    return cards


def _overview(views: Sequence[RunView]) -> Table:
    rows = []
    for view in views:
        delay: dict[str, Any] = view.summary.get("delay_ms") or {}
        robot = ((view.summary.get("ends") or {}).get("robot") or {}).get("interfaces") or {}
        throughputs = [(v.get("throughput_mbps") or {}) for v in robot.values()]
        busiest = max(throughputs, key=lambda t: t.get("mean") or 0, default={})
        rows.append(
            (
                view.name,
                view.case,
                "" if view.trial is None else str(view.trial),
                number(view.duration_s),
                number(busiest.get("mean")) + interval(busiest.get("mean_ci95")),
                number(delay.get("mean")) + interval(delay.get("mean_ci95")),
                number(delay.get("median")),
                number(delay.get("loss_percent")),
                number(delay.get("time_out_percent")),
            )
        )
    head = (
        "run",
        "case",
        "trial",
        "duration, s",
        "throughput at the robot, Mbit/s [95 %]",
        "round trip mean, ms [95 %]",
        "median, ms",
        "probes lost, %",
        "time out, %",
    )
    return Table("overview", "All runs", head, tuple(rows), text_columns=frozenset({0, 1}))


def _event_table(view: RunView, key: str) -> Table:
    rows = tuple((number(e.t_s, 5), e.end, e.kind, e.text) for e in view.events)
    return Table(
        f"{key}-events", "What happened to the link", ("at, s", "end", "event", "detail"), rows,
        text_columns=frozenset({1, 2, 3}),
    )  # fmt: skip


def _setup_table(view: RunView, key: str) -> Table:
    ends = list(view.setup)
    names = list(dict.fromkeys(name for end in ends for name in view.setup[end]))
    rows = tuple((name, *(view.setup[end].get(name, "") for end in ends)) for name in names)
    return Table(
        f"{key}-setup", "From the manifests of both recordings", ("", *ends), rows,
        text_columns=frozenset(range(len(ends) + 1)),
    )  # fmt: skip

"""What `demo`, `emulate` and `experiment` share on the terminal: progress of a trial, measured against true."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from linkrover.errors import LinkRoverError

if TYPE_CHECKING:
    from rich.console import Console

    from linkrover.emulator.agreement import Agreement, Figure
    from linkrover.experiment.trial import View

LINE_PERIOD_S = 5.0


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGTERM and a closed terminal end the run as Ctrl-C does: in order, with whole recordings."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    former = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def describe(view: View) -> str:
    """One line on where a trial stands."""
    parts = [view.stage]
    if view.distance_m is not None and view.stage == "driving":
        parts.append(f"{view.distance_m:4.1f} m")
        parts.append(f"{view.rssi_dbm:.0f} dBm" if view.associated and view.rssi_dbm is not None else "no link")
        parts.append("-" if view.rate_bps is None else f"{view.rate_bps / 1e6:5.1f} Mbit/s")
        if view.behind:
            parts.append("[machine too busy]")
    return ", ".join(parts)


@contextlib.contextmanager
def progress(console: Console) -> Iterator[Callable[[View], None]]:
    """Shows a trial: a bar on a terminal, a line every 5 s elsewhere."""
    if not console.is_terminal:
        last = 0.0
        stage = ""

        def line(view: View) -> None:
            nonlocal last, stage
            if view.stage != stage or time.monotonic() - last >= LINE_PERIOD_S:
                last, stage = time.monotonic(), view.stage
                print(f"{view.elapsed_s:5.0f} s of {view.total_s:.0f} s: {describe(view)}", file=sys.stderr, flush=True)

        yield line
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.percentage:3.0f} %"),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=console, transient=True, refresh_per_second=5) as bar:
        task = bar.add_task("starting", total=1.0)

        def show(view: View) -> None:
            bar.update(
                task, total=view.total_s, completed=min(view.elapsed_s, view.total_s), description=describe(view)
            )

        yield show


def verdict(figure: Figure) -> str:
    """One word on a figure."""
    return {True: "agrees", False: "DIFFERS", None: "nothing to compare"}[figure.agrees]


def print_agreement(console: Console, agreement: Agreement) -> None:
    """The table of measured against true."""
    from rich.table import Table

    table = Table(title="Measured against true", title_justify="left", title_style="bold")
    for heading in ("", "measured", "true", "unit", "difference", "limit", ""):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for figure in agreement.figures:
        known = figure.difference is not None
        digits = 0 if figure.difference_unit == "samples" else 3
        table.add_row(
            figure.what,
            "-" if figure.measured is None else f"{figure.measured:.3f}",
            "-" if figure.true is None else f"{figure.true:.3f}",
            figure.unit,
            f"{figure.difference:+.{digits}f} {figure.difference_unit}" if known else "-",
            f"{figure.limit:g} {figure.difference_unit}" if known else "-",
            verdict(figure) if known else figure.note,
            style="red" if figure.agrees is False else None,
        )
    console.print(table)
    if agreement.release_error_median_ms is not None and agreement.release_error_max_ms is not None:
        console.print(
            f"The emulator released packets {agreement.release_error_median_ms:.2f} ms (median) to "
            f"{agreement.release_error_max_ms:.1f} ms (worst) after the model's time"
            + (f"; it was behind in {agreement.behind:.1%} of the time." if agreement.behind else ".")
        )


def write_report(console: Console, run: Path) -> tuple[Path | None, str | None]:
    """Table on the console and `run`/report.html. Returns its path, or None and why there is none."""
    try:
        with console.status("joining the recordings and drawing the report") if console.is_terminal else _quiet():
            from linkrover.cli.report import report

            page = run / "report.html"
            report(run, format="html", out=page)
    except LinkRoverError as error:
        return None, f"No HTML report: {error}"
    return page, None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    yield

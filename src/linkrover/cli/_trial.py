"""What `demo`, `emulate` and `experiment` share on the terminal: progress of a trial, measured against true."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from linkrover.errors import LinkRoverError, missing_extra

if TYPE_CHECKING:
    from rich.console import Console

    from linkrover.emulator.agreement import Agreement
    from linkrover.experiment.trial import View

LINE_PERIOD_S = 5.0


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGTERM and a closed terminal end the run as Ctrl-C does: in order, with whole recordings."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    # nohup ignores SIGHUP, and so do we then
    heard = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    former = {number: signal.signal(number, interrupt) for number in heard}
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


def print_agreement(console: Console, agreement: Agreement) -> None:
    """The table of measured against true."""
    from rich.table import Table

    table = Table(title="Measured against true", title_justify="left", title_style="bold")
    table.add_column("figure", no_wrap=True)
    for heading in ("measured", "true"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("difference", justify="right", no_wrap=True)
    table.add_column("limit", no_wrap=True)
    for figure in agreement.figures:
        unit = figure.difference_unit
        known = figure.difference is not None
        digits = 0 if unit == "samples" else 2
        table.add_row(
            f"{figure.what}, {figure.unit}",
            "-" if figure.measured is None else f"{figure.measured:.3f}",
            "-" if figure.true is None else f"{figure.true:.3f}",
            f"{figure.difference:+.{digits}f} {unit}" if known else "-",
            (f"{figure.limit:g} {unit}" + (": DIFFERS" if figure.agrees is False else "")) if known else figure.note,
            style="red" if figure.agrees is False else None,
        )
    console.print(table)
    if agreement.release_error_median_ms is not None and agreement.release_error_max_ms is not None:
        console.print(
            f"The relay let packets go {agreement.release_error_median_ms:.2f} ms (median) to "
            f"{agreement.release_error_max_ms:.1f} ms (worst) after the model's time"
            + (f"; it was behind in {agreement.behind:.1%} of the time." if agreement.behind else "."),
            soft_wrap=True,
        )


def write_report(
    console: Console, runs: list[Path], page: Path, *, table: bool = True
) -> tuple[Path | None, str | None]:
    """Join and report runs: tables on the terminal, HTML into `page`. Returns its path, or None and why not."""
    try:
        with console.status("joining the recordings and drawing the report") if console.is_terminal else _quiet():
            from linkrover.analysis.batch import load_all
            from linkrover.analysis.summary import summarise
            from linkrover.report.document import build_document, print_document
            from linkrover.report.views import write_html

            loaded, failed = load_all(runs)
            for path, error in failed:
                console.print(f"left out of the report: {path}: {error}", soft_wrap=True, markup=False)
            if not loaded:
                return None, "No report: nothing that was recorded can be joined"
            summaries = [summarise(run) for run in loaded]
            write_html(loaded, summaries, page)
        if table:
            print_document(build_document(summaries, loaded))
    except LinkRoverError as error:
        return None, f"No report: {error}"
    except ModuleNotFoundError as error:
        extra = missing_extra(error)
        if extra is None:
            raise
        return None, f"No report: {extra}"
    return page, None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    yield

"""`linkrover compare`: a new run against a base run, for continuous integration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def compare(
    base: Path,
    new: Path,
    *,
    fail_if: Annotated[tuple[str, ...], Parameter(name="--fail-if", negative=())] = (),
    json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Is a new run worse than a base run, beyond noise?

    Without --fail-if: a table of the main figures of both runs with the change and its 95 % interval. With it: exit
    status 1 if a stated limit is broken, that is if the whole 95 % interval lies beyond it; also 1 if it cannot be
    checked. The interval is of noise within the two runs; two drives of the same set-up differ by more.

    Examples:
      linkrover compare runs/base runs/new
      linkrover compare runs/base runs/new --fail-if "delay.p95 > +20%" --fail-if "throughput < -10%"

    Parameters
    ----------
    base
        The run to compare with.
    new
        The run in question.
    fail_if
        A limit: METRIC > +20% (change in percent), METRIC > +5 (change in its unit), METRIC > 100 (level of the new
        run). Metrics: delay.mean, delay.median, delay.p95, delay.p99 (ms), loss (%), throughput, throughput.p5,
        throughput.tx, throughput.rx (Mbit/s), rssi, rssi.p5 (dBm). May be given several times.
    json
        Print one JSON object instead of a table.
    """
    import msgspec

    from linkrover.analysis.load import load_run
    from linkrover.analysis.regression import METRICS, Limit, compare_runs, parse_limit

    stated = [parse_limit(text) for text in fail_if]
    limits = stated or [Limit(name, name, above=True, value=float("inf"), kind="change") for name in METRICS]
    verdicts = compare_runs(load_run(base), load_run(new), limits)
    failed = [v for v in verdicts if stated and (v.broken or v.interval is None)]
    if json:
        print(msgspec.json.encode({"passed": not failed, "limits": verdicts}).decode())
        return 1 if failed else 0
    from rich.console import Console

    from linkrover.report.comparison import regression_table
    from linkrover.report.table import terminal

    console = Console()
    console.print(terminal(regression_table(verdicts, stated=bool(stated)), console.width))
    for verdict in failed:
        why = verdict.reason or "broken beyond noise"
        console.print(f"[bold red]limit {verdict.limit}: {why}[/]", highlight=False)
    return 1 if failed else 0

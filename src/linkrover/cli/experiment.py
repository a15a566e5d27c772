"""`linkrover experiment`: cases x trials from a plan, over the emulated link or as a real campaign."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from cyclopts import App, Parameter
from rich.markup import escape

from linkrover.errors import ConfigError, LinkRoverError

from ._trial import interruptible, write_report

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from linkrover.experiment.campaign import Campaign
    from linkrover.experiment.plan import TrialPlan
    from linkrover.experiment.runner import Run

app = App(
    name="experiment",
    help="Cases x trials from a plan (TOML): emulate them, or run a real campaign. See docs/experiment.md.",
)


@app.command
def emulate(
    plan: Path,
    *,
    out: Path | None = None,
    virtual: bool = False,
    jobs: int | None = None,
    duration: float | None = None,
    resume: bool = False,
    cases: Annotated[tuple[str, ...], Parameter(name="--case", negative=())] = (),
    json: bool = False,
) -> int:
    """Run every case and trial of a plan over the emulated link, then compare them.

    Each run goes into OUT/<case>/trial-<n>/ with the recordings of both ends and the emulator's truth. An experiment
    that was interrupted or killed goes on with --resume: whole runs are kept, a broken-off one is made again.

    Examples: `linkrover experiment emulate examples/pandey2022.toml --virtual`,
    `linkrover experiment emulate my.toml --duration 60 --case router-5 --case robot-ap-internal-2.4`

    Exit status: 0 every run is made and measured agrees with true in each, 1 not, 130 interrupted.

    Args:
        plan: The plan, a TOML file; examples/pandey2022.toml holds the paper's ten cases.
        out: Folder of the runs, by default <name of the plan>-runs here.
        virtual: In virtual time: the same models without packets, many times faster; marked as simulated.
        jobs: Runs at a time. In real time 1 by default: runs that share a core disturb each other.
        duration: Seconds of each run, instead of the plan's; the route is made to fit.
        resume: Go on with OUT.
        cases: Only these cases; may be given several times.
        json: Print one JSON object at the end and nothing else.
    """
    from rich.console import Console

    from linkrover.emulator.netns import why_not
    from linkrover.experiment.plan import load_plan, trials, world_settings
    from linkrover.experiment.runner import Made, prepare, run_all
    from linkrover.experiment.trial import check_virtual

    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs {jobs}: must be 1 or more")
    if duration is not None and not duration >= 3:
        raise ConfigError(f"--duration {duration:g}: must be at least 3 s, to hold a few samples")
    console = Console(stderr=json, highlight=False)
    the_plan = load_plan(plan)
    wanted = trials(the_plan, cases)
    for each in wanted:
        # a case that cannot be made is an error now, not in an hour
        settings = world_settings(the_plan, each, duration, str(plan))
        if virtual:
            check_virtual(settings)
    if not virtual:
        missing = why_not()
        if missing is not None:
            raise LinkRoverError(f"{missing}. Or add --virtual: the same models without packets")
    out = out or Path(f"{the_plan.name}-runs")
    made = Made(the_plan, virtual, duration)
    runs = prepare(wanted, out, made, resume=resume)
    jobs = jobs or ((os.cpu_count() or 1) if virtual else 1)
    skipped = sum(run.state == "skipped" for run in runs)
    console.print(
        f"{len(runs)} runs of {len({run.plan.case.name for run in runs})} cases"
        f"{f', {skipped} of them already whole' if skipped else ''}, into {out}"
        f"{' (virtual time)' if virtual else ''}.",
        soft_wrap=True,
    )
    began = time.monotonic()
    with interruptible(), _progress(console) as show:
        run_all(the_plan, runs, made, jobs=jobs, file=str(plan), show=show)
    seconds = time.monotonic() - began
    return _finish(console, runs, out, seconds, json)


@app.command
def run(
    plan: Path,
    *,
    out: Path | None = None,
    cases: Annotated[tuple[str, ...], Parameter(name="--case", negative=())] = (),
    duration: float | None = None,
    yes: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Guide a real campaign: case by case and trial by trial, with both ends checked, recorded and read through.

    Before, start an agent with a control port at each end; both, and the plan's campaign.key_file, hold the same key:

    robot$ linkrover agent --control campaign.key --role robot --record ~/runs

    station$ linkrover agent --control campaign.key --role station --reflect --record ~/runs

    For each trial it names the set-up, checks both ends (control port, interfaces, probes answered, clocks, free disk),
    starts both recordings, stops them when the drive is over, reads them through, and copies them into
    OUT/<case>/trial-<n>/. Nothing is ever overwritten: a trial that is repeated gets a name of its own at the ends. Run
    it again to go on where it was left.

    Exit status: 0 every trial of the plan is whole, 1 some are missing, 130 interrupted.

    Args:
        plan: The plan, a TOML file with a [campaign] table.
        out: Folder of the runs, by default <name of the plan>-campaign here.
        cases: Only these cases; may be given several times.
        duration: Seconds of each drive; by default until Enter is pressed.
        yes: Ask nothing: go on where all checks pass, stop where one does not. Needs --duration.
    """
    from rich.console import Console

    from linkrover.experiment.campaign import Campaign
    from linkrover.experiment.plan import load_plan, trials

    if duration is not None and not duration >= 1:
        raise ConfigError(f"--duration {duration:g}: must be at least 1 s")
    if yes and duration is None:
        raise ConfigError("--yes needs --duration: there is nobody to say when a drive is over")
    the_plan = load_plan(plan)
    out = out or Path(f"{the_plan.name}-campaign")
    campaign = Campaign(the_plan, out, plan.parent)
    wanted = trials(the_plan, cases)
    console = Console(highlight=False)
    guide = _Guide(console, campaign, duration, yes)
    with interruptible():
        for each in wanted:
            if not campaign.done(each) and not guide.trial(each):
                break
    missing = [each.folder for each in wanted if not campaign.done(each)]
    whole = [out / each.folder for each in wanted if campaign.done(each)]
    console.print(f"{len(whole)} of {len(wanted)} trials are whole, in {out}.", soft_wrap=True)
    if missing:
        console.print(f"Missing: {', '.join(missing)}. The same command goes on there.", soft_wrap=True)
    if whole:
        page, problem = write_report(console, whole, out / "report.html", table=False)
        console.print(f"Report: {page}" if page is not None else str(problem), soft_wrap=True, markup=False)
    return 1 if missing else 0


class _Guide:
    """Asks and tells, trial by trial."""

    def __init__(self, console: Console, campaign: Campaign, duration: float | None, yes: bool) -> None:
        self._console = console
        self._campaign = campaign
        self._duration = duration
        self._yes = yes

    def trial(self, run: TrialPlan) -> bool:
        """Guide one trial; False = leave the campaign now."""
        case = run.case
        parts = [
            None if case.access_point is None else f"access point: {case.access_point}",
            None if case.band_ghz is None else f"{case.band_ghz:g} GHz",
            None if case.adapter is None else f"{case.adapter} adapter",
            f"robot measures {', '.join(case.robot_interfaces)}, station {', '.join(case.station_interfaces)}",
            case.note or None,
        ]
        self._console.print(f"\n[bold]Next: {case.name}, trial {run.trial}[/]  ({'; '.join(p for p in parts if p)})")
        while True:
            word = self._ask("Set it up, then Enter to check both ends; s skips this trial, q leaves", "")
            if word == "q":
                return False
            if word == "s":
                return True
            if self._checked(run):
                break
            if self._yes:
                return False
        try:
            return self._record(run)
        except LinkRoverError as error:
            self._console.print(f"[red]{escape(str(error))}[/]", soft_wrap=True)
            return not self._yes

    def _checked(self, run: TrialPlan) -> bool:
        findings = self._campaign.check(run)
        for finding in findings:
            mark = {True: "[green]ok[/]  ", False: "[red]no[/]  ", None: "    "}[finding.ok]
            self._console.print(f"  {mark}{finding.what}: {escape(finding.text)}", soft_wrap=True)
        if all(finding.ok is not False for finding in findings):
            return True
        return self._ask("Not all is well. Enter checks again, g goes on all the same", "") == "g"

    def _record(self, run: TrialPlan) -> bool:
        console, campaign = self._console, self._campaign
        if self._ask("All is well. Enter starts both recordings, q leaves", "") == "q":
            return False
        campaign.start(run)
        began = time.monotonic()
        interrupted = False
        try:
            self._wait(began)
        except KeyboardInterrupt:
            interrupted = True
        seconds = time.monotonic() - began
        console.print(f"Drive over after {seconds:.0f} s; stopping both recordings.")
        trial = campaign.stop(run, seconds, lambda text: console.print(f"  {text}", soft_wrap=True))
        for problem in trial.problems:
            console.print(f"  [red]{escape(problem)}[/]", soft_wrap=True)
        keep = not trial.problems
        if trial.problems:
            keep = self._ask("k keeps this trial all the same, Enter does it again (its recordings stay)", "") == "k"
        if keep:
            out = campaign.collect(run, trial)
            counts = {end: sum(stopped.topics.values()) for end, stopped in
                      (("robot", trial.robot), ("station", trial.station))}  # fmt: skip
            console.print(f"  whole: {counts['robot']} and {counts['station']} messages, in {out}", soft_wrap=True)
        elif not self._yes and not interrupted:
            return self.trial(run)
        if interrupted:
            raise KeyboardInterrupt
        return keep or not self._yes

    def _wait(self, began: float) -> None:
        """Until the drive is over: Enter, or the duration."""
        import select
        import sys

        shown = -10.0
        while True:
            elapsed = time.monotonic() - began
            if self._duration is not None and elapsed >= self._duration:
                return
            if elapsed - shown >= 10:
                shown = elapsed
                ends = self._campaign.recording()
                states = [f"{end} {'records' if what else 'does NOT record'}" for end, what in ends.items()]
                away = [f"{end} out of reach" for end in ("robot", "station") if end not in ends]
                hint = "" if self._duration is not None else "; Enter when the drive is over"
                self._console.print(f"  {elapsed:4.0f} s: {', '.join(states + away)}{hint}", soft_wrap=True)
            if self._duration is not None:
                time.sleep(min(0.2, max(0.0, self._duration - elapsed)))
            elif select.select([sys.stdin], [], [], 0.2)[0]:
                sys.stdin.readline()
                return

    def _ask(self, text: str, default: str) -> str:
        if self._yes:
            return default
        self._console.print(f"{text}: ", end="")
        try:
            return input().strip().lower()
        except EOFError:
            return "q"


class _progress:  # noqa: N801 - used as a function
    """A bar over all runs with the time left, on a terminal; a line a finished run elsewhere."""

    def __init__(self, console: Console) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._console = console
        self._told: set[str] = set()
        self._began = time.monotonic()
        self._bar = Progress(
            TextColumn("{task.percentage:3.0f} %"), BarColumn(), TimeRemainingColumn(),
            TextColumn("{task.description}"),
            console=console, transient=True, refresh_per_second=4, disable=not console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("starting", total=1.0)

    def __enter__(self) -> Callable[[list[Run]], None]:
        self._bar.start()
        return self._show

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def _show(self, runs: list[Run]) -> None:
        todo = [run for run in runs if run.state != "skipped"]
        share = 0.0
        for run in todo:
            if run.state in ("done", "failed"):
                share += 1
                if run.plan.folder not in self._told:
                    self._told.add(run.plan.folder)
                    self._tell(run, len(self._told), len(todo))
            elif run.view is not None and run.view.total_s > 0:
                share += min(1.0, run.view.elapsed_s / run.view.total_s)
        active = ", ".join(run.plan.folder for run in todo if run.state == "running")
        self._bar.update(self._task, total=max(1, len(todo)), completed=share, description=active)

    def _tell(self, run: Run, count: int, total: int) -> None:
        elapsed = time.monotonic() - self._began
        left = elapsed / count * (total - count)
        how = "done" if run.state == "done" else f"FAILED: {run.problem}"
        self._console.print(
            f"{count:3d} of {total}  {run.plan.folder}: {how} in {run.seconds:.0f} s; about {left:.0f} s left",
            soft_wrap=True,
        )


def _finish(console: Console, runs: list[Run], out: Path, seconds: float, as_json: bool) -> int:
    """The comparison, and whether measured agrees with true in every run."""
    from linkrover.experiment.trial import load_outcome

    whole = [run for run in runs if run.state in ("done", "skipped")]
    failed = [run for run in runs if run.state == "failed"]
    outcomes = {run.plan.folder: load_outcome(run.out) for run in whole}
    disagree = [
        folder
        for folder, outcome in outcomes.items()
        if outcome is not None and outcome.agreement is not None and not outcome.agreement.agrees
    ]
    page, problem = None, None
    if whole:
        page, problem = write_report(console, [run.out for run in whole], out / "report.html", table=False)
    rows = _rows(whole) if page is not None else []
    if as_json:
        found = {
            "runs": str(out), "whole": len(whole), "seconds": seconds, "report": None if page is None else str(page),
            "failed": {run.plan.folder: run.problem for run in failed}, "disagree": disagree, "cases": rows,
        }  # fmt: skip
        print(msgspec.json.format(msgspec.json.encode(found)).decode())
    else:
        _table(console, rows)
        agreeing = len(whole) - len(disagree)
        console.print(
            f"{len(whole)} of {len(runs)} runs whole after {seconds:.0f} s; measured agrees with true in {agreeing} of "
            f"{len(whole)} (throughput 1 %, loss 0.5 points, median round trip 0.5 ms, RSSI exactly).",
            soft_wrap=True,
        )
        for folder in disagree:
            outcome = outcomes[folder]
            assert outcome is not None
            assert outcome.agreement is not None
            wrong = [figure for figure in outcome.agreement.figures if figure.agrees is False]
            texts = "; ".join(f"{f.what} by {f.difference:+.2f} {f.difference_unit}" for f in wrong)
            console.print(f"  {folder}: differs: {texts}", soft_wrap=True)
        for run in failed:
            console.print(f"  {run.plan.folder}: failed: {run.problem}", soft_wrap=True, markup=False)
        if problem is not None:
            console.print(problem, soft_wrap=True, markup=False)
        if page is not None:
            console.print(f"Report: {page}", soft_wrap=True)
    return 0 if not failed and not disagree else 1


def _rows(runs: list[Run]) -> list[dict[str, float | str | int | None]]:
    """A row a case: means over its trials, beside what the 2021 data show where it is one of theirs."""
    from linkrover.analysis.load import load_run
    from linkrover.analysis.summary import summarise
    from linkrover.emulator import presets

    cases: dict[str, list[Run]] = {}
    for run in runs:
        cases.setdefault(run.plan.case.name, []).append(run)
    rows: list[dict[str, float | str | int | None]] = []
    for name, members in cases.items():
        found = [summarise(load_run(run.out)) for run in members]
        robots = [s.ends["robot"].interfaces[s.ends["robot"].primary or "wlan0"] for s in found]
        stations = [s.ends["station"].interfaces[s.ends["station"].primary or "wlan0"] for s in found]
        preset = presets.BY_NAME.get(members[0].plan.case.preset or name)
        seen = None if preset is None else preset.observed
        rows.append(
            {
                "case": name,
                "trials": len(found),
                "throughput_mbps": _mean([r.throughput_mbps.mean for r in robots]),
                "throughput_2021_mbps": None if seen is None else seen.throughput_bps / 1e6,
                "outage_percent": _mean([s.delay_ms.time_out_percent for s in found]),
                "outage_2021_percent": None if seen is None else 100 * seen.outage_share,
                "median_ms": _mean([s.delay_ms.median for s in found]),
                "median_2021_ms": None if seen is None else 1e3 * seen.delay_median_s,
                # an access point shows none: then what the other end receives
                "rssi_dbm": _mean([r.rssi_dbm.mean for r in robots]) or _mean([r.rssi_dbm.mean for r in stations]),
            }
        )
    return rows


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _table(console: Console, rows: list[dict[str, float | str | int | None]]) -> None:
    from rich.table import Table

    if not rows:
        return
    console.print(
        "[bold]Means over the trials (n), beside the 2021 data[/]: throughput, time without answer, round trip"
    )
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("case", no_wrap=True)
    for heading in ("n", "Mbit/s", "2021", "out %", "2021", "RTT ms", "2021", "dBm"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        values = [value for key, value in row.items() if key != "case"]
        texts = [str(values[0])] + [f"{v:.1f}" if isinstance(v, float) else "-" for v in values[1:]]
        table.add_row(str(row["case"]), *texts)
    console.print(table)

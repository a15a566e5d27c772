"""`linkrover demo`: robot and station as two hosts on this machine, a real measurement of their emulated link."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from linkrover.errors import ConfigError

from ._trial import interruptible, print_agreement, progress

if TYPE_CHECKING:
    from rich.console import Console

    from linkrover.experiment.trial import Outcome

SHORTEST_S = 3.0


def demo(
    *,
    duration: float = 60.0,
    out: Path | None = None,
    seed: int = 1,
    case: str = "robot-ap-internal-2.4",
    json: bool = False,
    clean: bool = False,
) -> int:
    """A real two-ended measurement over an emulated link, with a report: no radio, no ROS needed.

    A robot drives out and back while its camera, LiDAR and the operator's commands cross an emulated Wi-Fi link:
    real packets between two network namespaces of this machine, delayed, repeated and dropped by a model of the radio.
    An agent at each end measures and records, as on a real robot. At the end the recordings are joined, reported, and
    compared with what the emulator knows to be true.

    Needs root, or an ordinary user's right to user namespaces and /dev/net/tun (stock Debian and Ubuntu). Without
    either it says what is missing and runs in virtual time instead: the same model, no packets.

    Exit status: 0 done and measured agrees with true, 1 not, 130 interrupted (the recordings so far are whole).

    Args:
        duration: Seconds of driving; the route is made to fit.
        out: Folder for the run, new; by default linkrover-demo-<date>-<time> here.
        seed: Of everything random: the same seed gives the same radio channel.
        case: A set-up of the paper by name or number, 1 to 10 (`linkrover emulate --help` lists them).
        json: Print one JSON object at the end and nothing else.
        clean: Only remove what killed runs have left: processes and working folders. Recordings stay.
    """
    from rich.console import Console

    console = Console(stderr=json, highlight=False, markup=False)
    if clean:
        return _clean()
    if not duration >= SHORTEST_S:
        raise ConfigError(f"--duration {duration:g}: must be at least {SHORTEST_S:g} s, to hold a few samples")
    from linkrover.emulator import presets
    from linkrover.emulator.netns import NotPermittedError, become_namespace_root
    from linkrover.emulator.robot import OUT_AND_BACK
    from linkrover.emulator.world import WorldSettings
    from linkrover.experiment.trial import refuse_to_overwrite, run_trial, run_virtual_trial

    setup = presets.find(case)
    out = out or Path(f"linkrover-demo-{time.strftime('%Y%m%d-%H%M%S')}")
    refuse_to_overwrite(out)
    settings = WorldSettings(case=setup, seed=seed, route=OUT_AND_BACK.fitted(duration), run=out.name)
    run, how = run_trial, "two hosts of this machine"
    try:
        if become_namespace_root():
            how += " (in a user namespace)"
    except NotPermittedError as error:
        console.print(f"{error}.", soft_wrap=True)
        console.print("Until then: in virtual time, the same models without packets. The report says so too.")
        run, how = run_virtual_trial, "two simulated hosts"
    console.print(
        f"Robot and station as {how}, joined by an emulated link: case {setup.name}, {duration:g} s, seed {seed}.",
        soft_wrap=True,
    )
    with interruptible():
        try:
            with progress(console) as show:
                outcome = run(settings, out, duration_s=duration, show=show)
            for note in outcome.notes:
                console.print(f"Note: {note}.", soft_wrap=True)
            return _finish(console, out, outcome, json)
        except KeyboardInterrupt:
            # before both ends recorded, or while the report was being made
            stays = f"; what was recorded is in {out}" if out.exists() else ""
            console.print(f"Interrupted{stays}.", soft_wrap=True)
            return 130


def _finish(console: Console, out: Path, outcome: Outcome, as_json: bool) -> int:
    """Join, report, say what was measured and whether it is true. Returns the exit status."""
    from ._trial import write_report

    page, problem = write_report(console, [out], out / "report.html", table=not as_json)
    agreement = outcome.agreement
    if as_json:
        found = {
            "run": str(out),
            "report": None if page is None else str(page),
            "agrees": None if agreement is None else agreement.agrees,
            "outcome": msgspec.to_builtins(outcome),
        }
        print(msgspec.json.format(msgspec.json.encode(found)).decode())
    elif agreement is not None:
        print_agreement(console, agreement)
    if problem is not None:
        console.print(problem, soft_wrap=True)
    if not as_json:
        console.print(f"Recordings: {out} (look inside with `linkrover info {out}`)", soft_wrap=True)
        if page is not None:
            console.print(f"Report: {page}", soft_wrap=True)
    if outcome.interrupted:
        console.print(f"Interrupted after {outcome.seconds:.0f} s of driving; the recordings until then are whole.")
        return 130
    return 0 if agreement is None or agreement.agrees else 1


def _clean() -> int:
    from linkrover.emulator.leftovers import clean, find_leftovers

    found = find_leftovers()
    for left in found:
        clean(left)
        processes = ", ".join(f"{each.what} ({each.pid})" for each in left.alive) or "no process"
        print(f"removed {left.folder}; ended {processes}")
        if left.owner is not None and Path(left.owner.out).exists():
            print(f"  its recordings stay, readable as they are: {left.owner.out}")
    if not found:
        print("nothing is left of any killed run")
    return 0

"""One emulated trial: a case driven once, recorded at both ends with the truth beside it, and checked."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from linkrover import __version__
from linkrover.bag import Recorder
from linkrover.emulator.agreement import Agreement, compare
from linkrover.emulator.world import World, WorldSettings
from linkrover.errors import ConfigError, LinkRoverError
from linkrover.records import (
    LinkTruth,
    LinkUtilization,
    Manifest,
    Pose,
    ProbeResult,
    ProbeTruth,
    Record,
    Role,
    WirelessLink,
    now,
)

ENDS = ("robot", "station")
OUTCOME_FILE = "outcome.json"
DEADLINE_S = 2.0
DRIVE_LIMIT = 1.4
"""A drive that outages made slower than this many times its nominal time is ended."""


class View(msgspec.Struct):
    """What can be shown while a trial runs. Rates are of the last whole second."""

    elapsed_s: float
    total_s: float
    stage: str
    distance_m: float | None = None
    rssi_dbm: float | None = None
    rate_bps: float | None = None
    associated: bool = True
    behind: bool = False


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How a trial went. seconds: from first traffic to the end. interrupted: ended by the user, recordings whole."""

    case: str
    trial: int | None
    seed: int
    seconds: float
    simulated: bool
    interrupted: bool
    drive_done: bool
    agreement: Agreement | None
    notes: tuple[str, ...] = ()
    summary: dict[str, Any] = {}


class _Watch:
    """Follows the truth to show where things stand."""

    def __init__(self, access_point: str) -> None:
        self._hop = "robot>" + ("station" if access_point != "router" else "router")
        self.view = View(0.0, 0.0, "starting")
        self._second: tuple[int, int] | None = None

    def take(self, record: Record) -> None:
        if isinstance(record, Pose):
            return
        if isinstance(record, LinkTruth) and record.hop == self._hop:
            view = self.view
            view.distance_m, view.rssi_dbm, view.associated = record.distance_m, record.rssi_dbm, record.associated
            view.behind = record.behind
            if self._second is None:
                self._second = (record.mono_ns, record.delivered_bytes)
            elif record.mono_ns - self._second[0] >= 1_000_000_000:
                began_ns, octets = self._second
                view.rate_bps = (record.delivered_bytes - octets) * 8e9 / (record.mono_ns - began_ns)
                self._second = (record.mono_ns, record.delivered_bytes)


def truth_manifest(settings: WorldSettings, run: str) -> Manifest:
    """The manifest of the emulator's own recording."""
    stamp, system = now(), os.uname()
    return Manifest(
        wall_ns=stamp.wall_ns,
        mono_ns=stamp.mono_ns,
        linkrover_version=__version__,
        role=Role.ROBOT,
        host=system.nodename,
        kernel=system.release,
        machine=system.machine,
        python="",
        case=settings.case.name,
        trial=settings.trial,
        run=run,
        emulated=True,
        config=msgspec.json.encode(settings).decode(),
        notes={"truth": "what the emulator knows to be so; positions in frame map", "seed": str(settings.seed)},
    )


def refuse_to_overwrite(out: Path) -> None:
    """Raise LinkRoverError if `out` holds recordings already, or is something else."""
    if out.exists() and (not out.is_dir() or any((out / end).exists() for end in (*ENDS, "truth"))):
        raise LinkRoverError(
            f"{out} holds a run already (or is no folder); runs are never overwritten: give another --out"
        )


def run_trial(
    settings: WorldSettings,
    out: Path,
    *,
    duration_s: float | None,
    show: Callable[[View], None] = lambda _view: None,
) -> Outcome:
    """Drive one trial in real time and record it into out/robot, out/station and out/truth.

    duration_s None: until the drive is over. The interrupt of a user ends it early with whole recordings; the
    outcome then says so. Call netns.become_namespace_root() before.

    Raises:
        LinkRoverError: a part could not be started or died; recordings made so far stay.
        KeyboardInterrupt: the user ended it before both ends recorded, so that there is nothing to check.
    """
    refuse_to_overwrite(out)
    out.mkdir(parents=True, exist_ok=True)
    watch = _Watch(settings.case.access_point)
    nominal_s = settings.route.nominal_s(settings.drive) + 3
    limit_s = duration_s if duration_s is not None else nominal_s * DRIVE_LIMIT
    watch.view.total_s = duration_s if duration_s is not None else nominal_s
    recorder = Recorder(out / "truth", truth_manifest(settings, settings.run or out.name), end="truth")

    def take(record: Record) -> None:
        recorder.take(record)
        watch.take(record)

    interrupted = driving = False
    began = time.monotonic()
    try:
        with World(settings, out, take) as world:
            try:
                show(watch.view)
                world.start_link()
                world.start_agents(out)
                world.start_traffic()
                world.start_others()
                began = time.monotonic()
                watch.view.stage = "driving"
                driving = True

                def each() -> bool:
                    watch.view.elapsed_s = time.monotonic() - began
                    show(watch.view)
                    return duration_s is None and world.drive_done

                world.run(limit_s, each)
            except KeyboardInterrupt:
                interrupted = True
            seconds = time.monotonic() - began
            drive_done = world.drive_done
            watch.view.stage = "stopping"
            show(watch.view)
            world.stop()
            notes, summary = world.notes, world.summary
    finally:
        recorder.close()
    if interrupted and not driving:
        raise KeyboardInterrupt
    watch.view.stage = "checking"
    show(watch.view)
    # interrupted before both ends recorded, there is nothing to compare
    begun = all((out / end).is_dir() and any((out / end).iterdir()) for end in (*ENDS, "truth"))
    agreement = check_agreement(out, _deadline_s(settings)) if begun else None
    outcome = Outcome(
        case=settings.case.name,
        trial=settings.trial,
        seed=settings.seed,
        seconds=seconds,
        simulated=False,
        interrupted=interrupted,
        drive_done=drive_done,
        agreement=agreement,
        notes=tuple(notes),
        summary=summary,
    )
    save_outcome(out, outcome)
    return outcome


def check_virtual(settings: WorldSettings) -> None:
    """Raise ConfigError for what virtual time cannot do."""
    if settings.robots > 1:
        raise ConfigError(f"robots = {settings.robots}: virtual time knows one robot; leave out --virtual")
    if _deadline_s(settings) != DEADLINE_S:
        raise ConfigError(f"probe.deadline_s = {_deadline_s(settings):g}: in virtual time it is {DEADLINE_S:g} s")


def run_virtual_trial(
    settings: WorldSettings,
    out: Path,
    *,
    duration_s: float | None,
    show: Callable[[View], None] = lambda _view: None,
) -> Outcome:
    """The same trial in virtual time: the same models, no packets, no permission needed; marked as simulated.

    Raises:
        ConfigError: more than one robot, or another deadline than virtual time's.
        LinkRoverError: `out` holds a run already, or cannot be written.
    """
    from linkrover.emulator.virtual import VirtualSettings, run

    check_virtual(settings)
    refuse_to_overwrite(out)
    out.mkdir(parents=True, exist_ok=True)
    total_s = duration_s if duration_s is not None else settings.route.nominal_s(settings.drive) + 3
    view = View(0.0, total_s, "simulating")

    def progress(share: float) -> None:
        view.elapsed_s = share * total_s
        show(view)

    run(
        settings.case,
        0 if settings.trial is None else settings.trial,
        settings.seed,
        duration_s,
        out,
        settings=VirtualSettings(
            route=settings.route,
            drive=settings.drive,
            traffic=settings.traffic,
            wireless_hz=settings.rates.get("wireless_hz", 10.0),
            utilization_hz=settings.rates.get("utilization_hz", 1.0),
            probe_hz=settings.probe.get("rate_hz", 10.0),
            access_point_shows_signal=settings.access_point_shows_signal,
        ),
        progress=progress,
    )
    view.stage = "checking"
    show(view)
    agreement = check_agreement(out)
    outcome = Outcome(
        case=settings.case.name,
        trial=settings.trial,
        seed=settings.seed,
        seconds=total_s,
        simulated=True,
        interrupted=False,
        drive_done=True,
        agreement=agreement,
    )
    save_outcome(out, outcome)
    return outcome


def _deadline_s(settings: WorldSettings) -> float:
    return float(settings.probe.get("deadline_s", DEADLINE_S))


def check_agreement(out: Path, deadline_s: float = DEADLINE_S) -> Agreement:
    """Measured against true, from the recordings of a finished run. deadline_s: of the probes."""
    from linkrover.bag.reading import read_recording

    ends = {end: list(read_recording(out / end).records(LinkUtilization, ProbeResult, WirelessLink)) for end in ENDS}
    truth = read_recording(out / "truth").records(LinkTruth, ProbeTruth)
    return compare(ends, truth, int(deadline_s * 1e9))


def save_outcome(out: Path, outcome: Outcome) -> None:
    """Write the outcome; its presence says that the run is whole."""
    new = out / (OUTCOME_FILE + ".new")
    new.write_bytes(msgspec.json.format(msgspec.json.encode(outcome)))
    new.replace(out / OUTCOME_FILE)


def load_outcome(out: Path) -> Outcome | None:
    """The outcome of a whole run, None when there is none (or it is of another make)."""
    try:
        return msgspec.json.decode((out / OUTCOME_FILE).read_bytes(), type=Outcome)
    except (OSError, msgspec.DecodeError):
        return None

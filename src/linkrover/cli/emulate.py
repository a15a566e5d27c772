"""`linkrover emulate`: any program at one end of an emulated Wi-Fi link."""

from __future__ import annotations

import contextlib
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from linkrover.errors import ConfigError

from ._trial import interruptible

if TYPE_CHECKING:
    from linkrover.emulator.world import WorldSettings

End = Literal["robot", "station"]
Trajectory = Literal["out-and-back", "lab-2021", "still"]


def emulate(
    case: Annotated[str, Parameter(allow_leading_hyphen=False)],
    *command: Annotated[str, Parameter(allow_leading_hyphen=True)],
    at: End = "robot",
    other: str | None = None,
    seed: int = 1,
    trajectory: Trajectory = "out-and-back",
    distance: float | None = None,
    traffic: bool = False,
    robots: int = 1,
    duration: float | None = None,
    out: Path | None = None,
    replay: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"])] = False,
) -> int:
    """Run any program behind an emulated Wi-Fi link: `linkrover emulate CASE -- COMMAND`.

    COMMAND runs on an emulated host of its own: its only network is `wlan0`, which leads over the emulated radio to the
    other end. There it finds the names `robot` (10.77.0.2) and `station` (10.77.0.1), and a STAMP reflector at the
    other end. The robot drives along the trajectory meanwhile, again and again, so the link gets worse and better. It
    ends with COMMAND, and with its exit status.

    Cases (Table I of the paper): 1 router-2.4, 2 router-5, 3 robot-ap-internal-2.4, 4 robot-ap-internal-5,
    5 station-ap-internal-2.4, 6 station-ap-internal-5, 7 robot-ap-external-2.4, 8 robot-ap-external-5,
    9 station-ap-external-2.4, 10 station-ap-external-5.

    Examples:
    `linkrover emulate 3 -- linkrover probe station --duration 30`,
    `linkrover emulate 8 --other "iperf3 -s" -- iperf3 -c station`,
    `linkrover emulate 4 --at station --trajectory still --distance 14 -- ping -c 20 robot`,
    `linkrover emulate --replay my-run -- ./my_robot_software`.

    The program's environment also has LINKROVER_ROBOT, LINKROVER_STATION (addresses), LINKROVER_END and
    LINKROVER_WIRELESS (the emulated driver's /proc/net/wireless text). For an ordinary user it runs as root of a user
    namespace; files it writes are the user's own.

    Args:
        case: The set-up, by number or name. Leave it out with --replay.
        command: The program and its arguments, after `--`.
        at: Which end it runs at.
        other: Another program, for the other end, started before and ended after.
        seed: Of the radio channel.
        trajectory: How the robot moves: by script here, without needing the link.
        distance: With --trajectory still: metres from the start.
        traffic: Also send the paper's camera, LiDAR and commands; the robot then drives by what comes over the link.
        robots: Robots in all, 1 to 10: the others send the paper's traffic over the same air. Not in cases where the
            robot is the access point.
        duration: End COMMAND (SIGTERM) after this many seconds.
        out: Measure and record both ends, and the emulator's truth, into this new folder.
        replay: A recorded run: its RSSI, throughput and outages become the link.
        quiet: Say nothing of our own.
    """
    if replay is not None:
        command = (case, *command)
    if not command:
        raise ConfigError("no COMMAND given: linkrover emulate CASE -- COMMAND, such as: -- linkrover probe station")
    if duration is not None and not duration > 0:
        raise ConfigError(f"--duration {duration:g}: must be above 0 s")
    if distance is not None and not 0 <= distance <= 1000:
        raise ConfigError(f"--distance {distance:g}: must be 0 to 1000 m")
    if distance is not None and trajectory != "still":
        raise ConfigError("--distance goes with --trajectory still")

    from linkrover.bag import Recorder
    from linkrover.emulator.motion import Scripted
    from linkrover.emulator.netns import become_namespace_root
    from linkrover.emulator.world import ADDRESSES, World
    from linkrover.experiment.trial import refuse_to_overwrite, truth_manifest
    from linkrover.records import LinkTruth, Record

    settings = _settings(case, seed, trajectory, replay, robots)
    if out is not None:
        refuse_to_overwrite(out)
    become_namespace_root()

    def say(text: str) -> None:
        if not quiet:
            print(f"linkrover: {text}", file=sys.stderr, flush=True)

    last: dict[str, LinkTruth] = {}
    truth: Recorder | None = None

    def take(record: Record) -> None:
        if isinstance(record, LinkTruth):
            last[record.hop] = record
        if truth is not None:
            truth.take(record)

    with ExitStack() as stack:
        stack.enter_context(interruptible())
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            truth = Recorder(out / "truth", truth_manifest(settings, out.name), end="truth")
            stack.callback(truth.close)
        world = stack.enter_context(World(settings, out or Path.cwd(), take))
        world.start_link()
        if out is None:
            world.start_reflector("station" if at == "robot" else "robot")
        else:
            world.start_agents(out, reflect_both=True)
        motion = Scripted(
            settings.route,
            settings.drive,
            world.path("pose-robot"),
            still_m=_still(trajectory, distance),
            feed_path=world.path("feed"),
        )
        if traffic:
            world.start_traffic()
        world.start_others()
        beside = None if other is None else world.popen("station" if at == "robot" else "robot", shlex.split(other))
        say(f"{command[0]} runs at the {at}, {ADDRESSES[at]}; case {settings.case.name}, seed {seed}")
        began = time.monotonic()
        process = world.popen(at, command)
        overtime = False

        def each() -> bool:
            nonlocal overtime
            if not traffic:
                motion.step()
            if duration is not None and not overtime and time.monotonic() - began > duration:
                overtime = True
                process.terminate()
            return process.poll() is not None

        stack.callback(_end, [process, *([] if beside is None else [beside])])
        with _deaf_once():
            while process.poll() is None:
                world.run(3600.0, each, 0.05)
        seconds = time.monotonic() - began
        world.stop()
    for hop in last.values():
        lost = hop.dropped_queue + hop.dropped_retries + hop.dropped_unassociated
        say(
            f"{hop.hop}: {hop.delivered_packets} of {hop.offered_packets} packets arrived, "
            f"{hop.delivered_bytes * 8 / seconds / 1e6:.2f} Mbit/s over {seconds:.0f} s; dropped {lost}: "
            f"{hop.dropped_queue} queue full, {hop.dropped_retries} after all retries, "
            f"{hop.dropped_unassociated} without association"
        )
    if out is not None:
        say(f"recorded: {out} (linkrover report {out})")
    code = process.returncode
    # a program ended by a signal, as a shell says it; ended by us because its time was over, that is no failure
    if overtime and code == -signal.SIGTERM:
        return 0
    return 128 - code if code < 0 else code


@contextlib.contextmanager
def _deaf_once() -> Iterator[None]:
    """The terminal's Ctrl-C reaches the program too, and it decides; the second one ends us all."""
    pressed = False

    def press(_number: int, _frame: object) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    former = signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)


def _end(programs: list[subprocess.Popen[bytes]]) -> None:
    for program in programs:
        if program.poll() is None:
            program.terminate()
    for program in programs:
        _wait_or_kill(program)


def _wait_or_kill(program: subprocess.Popen[bytes]) -> None:
    try:
        program.wait(5)
    except subprocess.TimeoutExpired:
        program.kill()
        program.wait()


def _still(trajectory: Trajectory, distance: float | None) -> float | None:
    return (0.0 if distance is None else distance) if trajectory == "still" else None


def _settings(case: str, seed: int, trajectory: Trajectory, replay: Path | None, robots: int) -> WorldSettings:
    from linkrover.emulator import presets
    from linkrover.emulator.robot import OUT_AND_BACK, ROUTES
    from linkrover.emulator.world import WorldSettings

    route = ROUTES.get(trajectory, OUT_AND_BACK)
    if replay is None:
        return WorldSettings(case=presets.find(case), seed=seed, route=route, robots=robots)
    from linkrover.bag.reading import read_recording
    from linkrover.emulator.replay import CASE, build

    parts = {end: replay / end for end in ("robot", "station") if (replay / end).exists()} or {"robot": replay}
    timeline = build(str(replay), {end: list(read_recording(part).records()) for end, part in parts.items()})
    return WorldSettings(case=CASE, seed=seed, route=route, replay=timeline, robots=robots)

"""A case in virtual time: the same medium, channel and robot as in real time, modelled programs instead of packets.

    run(find("3"), trial=1, seed=7, duration_s=300.0, out_dir=Path("runs/case3/trial1"))

writes `robot/`, `station/` and `truth/` recordings, marked as simulated. Nothing waits: a run of five minutes takes
seconds. Both ends share one clock.
"""

from __future__ import annotations

import heapq
import platform
import random
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

import msgspec

from linkrover import __version__
from linkrover.errors import ConfigError
from linkrover.records import Interface, Manifest, Now, Pose, Record, Role, VelocityCommand

from .medium import Fate, Medium
from .presets import Case
from .robot import LAB_2021, ODOMETRY_HZ, Drive, Operator, Robot, Route
from .tcp_model import Acknowledgement, Segment, TcpConnectionModel
from .traffic import Traffic
from .virtual_records import EndRecords
from .virtual_traffic import ActionClient, Probe, Prober, StreamSource

ADDRESSES = {"station": "10.77.0.1", "robot": "10.77.0.2"}
TICK_NS = 50_000_000
EPOCH_NS = 1_600_000_000_000_000_000  # what the simulated wall clock shows at the start, unless told otherwise
LOST_ROBOT_NS = 5_000_000_000
DRIVE_LIMIT = 1.4
"""A drive that outages made slower than this many times its nominal time is ended."""
LIDAR_FLOW, CAMERA_FLOW, COMMAND_FLOW, GOAL_FLOW, RESULT_FLOW, PROBE_FLOW = range(1, 7)
FAR = 1 << 62


class Sink(Protocol):
    """Takes records."""

    def take(self, record: Record) -> None:
        """One record."""
        ...


class VirtualSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Everything besides the case. Rates in samples per second, as an agent's defaults."""

    route: Route = LAB_2021
    drive: Drive = Drive()
    traffic: Traffic = Traffic()
    wireless_hz: float = 10.0
    utilization_hz: float = 1.0
    action_hz: float = 1.0
    probe_hz: float = 10.0
    probe_octets: int = 44
    iface: str = "wlan0"
    access_point_shows_signal: bool = True


class Simulation:
    """One run. sinks: by "robot", "station", "truth". Deterministic by its seed."""

    def __init__(
        self,
        case: Case,
        seed: int,
        sinks: dict[str, Sink],
        settings: VirtualSettings | None = None,
        wall_ns: int = EPOCH_NS,
    ) -> None:
        settings = settings or VirtualSettings()
        self.case = case
        self.settings = settings
        self.now_ns = 0
        self._wall_ns = wall_ns
        self._sinks = sinks
        self._heap: list[tuple[int, int, Callable[[int], None]]] = []
        self._order = 0
        rng = random.Random(seed)
        self.medium: Medium = case.make_medium(seed)
        self.channel = case.make_channel(seed)
        self.robot = Robot(settings.route, settings.drive, seed)
        self.operator = Operator(settings.route, settings.drive)
        self._backtracked_ns = -LOST_ROBOT_NS
        self._acknowledge: list[TcpConnectionModel] = []
        self._radio(0)
        peer = ADDRESSES["station"]
        traffic = settings.traffic
        sources: list[TcpConnectionModel] = []
        for stream, flow in ((traffic.camera, CAMERA_FLOW), (traffic.lidar, LIDAR_FLOW)):
            if stream.rate_hz > 0:
                source = StreamSource(self, "robot", "station", flow, stream.octets, stream.rate_hz)
                sources.append(source.connection)
        self.commands = StreamSource(
            self,
            "station",
            "robot",
            COMMAND_FLOW,
            40,
            traffic.command_hz,
            on_message=self._commanded,
            make=self._steer,
            offset_ns=20_000_000,
        )
        self.action = ActionClient(self, settings.iface, peer, (GOAL_FLOW, RESULT_FLOW), settings.action_hz, rng)
        self.prober = Prober(self, peer, PROBE_FLOW, settings.probe_hz, settings.probe_octets, rng)
        sources += [self.commands.connection, *self.action.connections]
        self.connections = sources
        self.ends = {end: EndRecords(self, end, self.prober) for end in ("robot", "station")}
        self.every(round(1e9 / ODOMETRY_HZ), self._step)
        self.every(TICK_NS, self._tick)

    # ---- what the programs see

    def at(self, due_ns: int, work: Callable[[int], None]) -> None:
        """Call back at a time."""
        self._order += 1
        heapq.heappush(self._heap, (due_ns, self._order, work))

    def every(self, period_ns: int, work: Callable[[int], None], offset_ns: int = 0) -> None:
        """Call back at offset_ns + k * period_ns."""

        def turn(now_ns: int) -> None:
            self.at(now_ns + period_ns, turn)
            work(now_ns)

        self.at(offset_ns, turn)

    def stamp(self, at_ns: int) -> Now:
        """Both clocks: the simulation starts at monotonic 0."""
        return Now(self._wall_ns + at_ns, at_ns)

    def record(self, end: str, record: Record) -> None:
        """To a recording."""
        self._sinks[end].take(record)

    def offer(self, sender: str, receiver: str, octets: int, tag: object, flow: int) -> bool:
        """To the medium."""
        cause = self.medium.offer(self.now_ns, sender, receiver, octets, tag, flow)
        if cause is None:
            return True
        if type(tag) is Probe:
            self.prober.dropped(tag, cause)
        return False

    # ---- the run

    def run(self, duration_s: float | None) -> Iterator[float]:
        """Simulate; yields the share done about once a simulated second. None: until the drive is over.

        Raises:
            ConfigError: duration_s is not above 0.
        """
        _check(duration_s)
        nominal_s = self.settings.route.nominal_s(self.settings.drive) + 3
        end_ns = round((nominal_s * DRIVE_LIMIT if duration_s is None else duration_s) * 1e9)
        likely_ns = nominal_s * 1e9 if duration_s is None else end_ns
        heap, medium = self._heap, self.medium
        shown_ns = 0
        while True:
            due_ns = heap[0][0]
            limit_ns = min(due_ns, end_ns)
            reached_ns, fates = medium.advance_to_fate(limit_ns)
            self.now_ns = reached_ns
            if fates:
                self._dispatch(fates, reached_ns)
                continue
            if due_ns > end_ns:
                return
            self.now_ns = due_ns
            heapq.heappop(heap)[2](due_ns)
            if due_ns - shown_ns >= 1_000_000_000:
                shown_ns = due_ns
                yield min(1.0, due_ns / likely_ns)
                if duration_s is None and self.operator.done:
                    return

    def _dispatch(self, fates: list[Fate], now_ns: int) -> None:
        for tag, _, _, _, cause in fates:
            kind = type(tag)
            if kind is Segment:
                if cause is None:
                    connection = tag.connection  # type: ignore[attr-defined]
                    if not connection.acknowledge_due:
                        self._acknowledge.append(connection)
                    connection.arrived(tag, now_ns)
            elif kind is Acknowledgement:
                if cause is None:
                    tag.connection.acknowledged(tag, now_ns)  # type: ignore[attr-defined]
            elif kind is Probe:
                assert isinstance(tag, Probe)
                if cause is None:
                    self.prober.arrived(tag, now_ns)
                else:
                    self.prober.dropped(tag, cause)
        if self._acknowledge:
            waiting, self._acknowledge = self._acknowledge, []
            for connection in waiting:
                connection.acknowledge()

    # ---- robot and radio

    def _radio(self, now_ns: int) -> None:
        self.channel.apply(self.medium, now_ns / 1e9, {**self.case.places, "robot": (self.robot.x_m, self.robot.y_m)})

    def _step(self, now_ns: int) -> None:
        self.robot.step(now_ns)
        at = self.stamp(now_ns)
        self.record("robot", self.robot.odometry(at))

    def _tick(self, now_ns: int) -> None:
        self._radio(now_ns)
        at = self.stamp(now_ns)
        pose: Pose = self.robot.true_pose(at)
        self.record("truth", pose)
        for hop in self.medium.hops():
            self.record("truth", self.medium.truth(hop.sender, hop.receiver, at.wall_ns, at.mono_ns))
        for end in self.ends.values():
            end.tick(at)

    def _steer(self, now_ns: int) -> object:
        robot = self.robot
        if robot.forward_m_per_s < -0.1:
            # it drives backwards by itself: it has lost us on the way to this waypoint
            if now_ns - self._backtracked_ns > LOST_ROBOT_NS:
                self.operator.skip()
            self._backtracked_ns = now_ns
        return self.operator.command(now_ns, robot.x_m, robot.y_m, robot.heading_rad)

    def _commanded(self, command: object, now_ns: int) -> None:
        assert isinstance(command, tuple)
        forward, turn = command
        self.robot.command(now_ns, forward, turn)
        at = self.stamp(now_ns)
        self.record(
            "robot",
            VelocityCommand(wall_ns=at.wall_ns, mono_ns=at.mono_ns, forward_m_per_s=forward, turn_rad_per_s=turn),
        )


def _check(duration_s: float | None) -> None:
    if duration_s is not None and not duration_s > 0:
        raise ConfigError(f"duration_s = {duration_s}: must be above 0, or absent to drive to the end")


def manifest(case: Case, role: Role, settings: VirtualSettings, now: Now, **more: object) -> Manifest:
    """What a simulated recording says of itself."""
    access_point = case.access_point == role.value
    return msgspec.structs.replace(
        Manifest(
            wall_ns=now.wall_ns,
            mono_ns=now.mono_ns,
            linkrover_version=__version__,
            role=role,
            host=f"simulated {role.value}",
            kernel=f"none (virtual time on {platform.system()} {platform.release()})",
            machine=platform.machine(),
            python=platform.python_version(),
            clock_source="virtual",
            peer=ADDRESSES["station" if role is Role.ROBOT else "robot"],
            middleware="simulated ros1 action",
            case=case.name,
            simulated=True,
            interfaces=(
                Interface(
                    name=settings.iface,
                    addresses=(f"{ADDRESSES[role.value]}/24",),
                    driver=f"emulated {case.adapter} adapter",
                    frequency_mhz=round(case.channel.frequency_mhz),
                    width_mhz=case.medium.width_mhz,
                    mode="ap" if access_point else "station",
                ),
            ),
        ),
        **more,
    )


def run(
    case: Case,
    trial: int,
    seed: int,
    duration_s: float | None,
    out_dir: Path,
    *,
    settings: VirtualSettings | None = None,
    progress: Callable[[float], None] | None = None,
    wall_ns: int | None = None,
    notes: dict[str, str] | None = None,
) -> None:
    """Simulate a case and write the run's folder. duration_s None: until the drive is over, at most 1.4 times as long
    as it takes without outages. wall_ns: the simulated wall clock at the start, by default now.

    Raises:
        ConfigError: a duration that is not above 0.
        LinkRoverError: the folder holds recordings already, or cannot be written.
    """
    from linkrover.bag import Recorder

    _check(duration_s)
    settings = settings or VirtualSettings()
    start = Now(time.time_ns() if wall_ns is None else wall_ns, 0)
    with ExitStack() as stack:
        sinks: dict[str, Sink] = {}
        for end in ("robot", "station", "truth"):
            role = Role.ROBOT if end == "robot" else Role.STATION
            said = manifest(
                case,
                role,
                settings,
                start,
                trial=trial,
                run=out_dir.name,
                notes={
                    **(notes or {}),
                    "seed": str(seed),
                    "medium": "virtual time",
                    **({"case": case.note} if case.note else {}),
                },
            )
            sinks[end] = stack.enter_context(Recorder(out_dir / end, said, end=end))
        simulation = Simulation(case, seed, sinks, settings, start.wall_ns)
        for share in simulation.run(duration_s):
            if progress is not None:
                progress(share)
        for records in simulation.ends.values():
            records.finish()

"""The paper's traffic as two programs: camera and LiDAR robot -> station, velocity commands station -> robot.

Each stream is a TCP connection of its own, as in ROS 1, fed from a queue that holds one message and drops the older
one: what the link cannot carry is dropped at the sender, not piled up. Started by the emulation inside the two
namespaces: `python -m linkrover.emulator.traffic SETTINGS.json robot|station`.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import msgspec

from linkrover.agent.feed import FeedSender
from linkrover.emulator.robot import COMMAND_HZ, ODOMETRY_HZ, Drive, Operator, Robot, Route
from linkrover.errors import ConfigError
from linkrover.records import Record, VelocityCommand, now

HEADER = struct.Struct("!4sIQQ")  # magic, octets after the header, sequence, wall_ns of the message
MAGIC = b"LRov"
COMMAND = struct.Struct("!dd")
POSE = struct.Struct("!ddddd")  # x m, y m, heading rad, forward m/s, turn rad/s: the true pose, outside the network
CAMERA_PORT, LIDAR_PORT, COMMAND_PORT = 7411, 7412, 7413
MAX_MESSAGE = 64 * 1024 * 1024
RECONNECT_S = 0.5
LOST_ROBOT_NS = 5_000_000_000


class Stream(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A periodic message: `octets` at `rate_hz`; rate_hz 0 turns it off."""

    octets: int
    rate_hz: float

    def __post_init__(self) -> None:
        if not 1 <= self.octets <= MAX_MESSAGE:
            raise ConfigError(f"octets of a stream must be 1 to {MAX_MESSAGE}, got {self.octets}")
        if not 0 <= self.rate_hz <= 1000:
            raise ConfigError(f"rate_hz of a stream must be 0 (off) to 1000, got {self.rate_hz}")

    @property
    def offered_bps(self) -> float:
        """Bits per second it wants, without headers."""
        return self.octets * 8 * self.rate_hz


class Traffic(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the ends send. Defaults: a raw 640 x 480 RGB camera at 10 Hz (74 Mbit/s), a LiDAR of 720 beams.

    Their clocks are their own, a little off: at exactly 10 Hz every probe would meet the same moment of a frame.
    """

    camera: Stream = Stream(octets=640 * 480 * 3, rate_hz=10.07)
    lidar: Stream = Stream(octets=720 * 8, rate_hz=9.94)
    command_hz: float = COMMAND_HZ

    def __post_init__(self) -> None:
        if not 0 < self.command_hz <= 100:
            raise ConfigError(f"traffic.command_hz must be above 0 and at most 100, got {self.command_hz}")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What both programs are told. Paths are Unix datagram sockets outside the emulated network."""

    robot_address: str
    station_address: str
    route: Route
    drive: Drive
    traffic: Traffic
    seed: int
    eyes_path: str  # the operator's sight of the robot
    pose_path: str  # the relay: where the robot is
    feed_path: str | None  # the robot's agent: odometry and commands
    result_path: str  # a JSON file each program writes at its end, with its role for {role}
    port_offset: int = 0  # added to every port: each robot talks to a program of its own at the station
    done_path: str  # appears when the operator has driven the whole route


class Received(msgspec.Struct):
    """What arrived of one stream."""

    messages: int = 0
    octets: int = 0
    missing: int = 0
    age_ns_sum: int = 0
    age_ns_max: int = 0


class Sent(msgspec.Struct):
    """What became of the messages of one stream at its sender."""

    made: int = 0
    sent: int = 0
    dropped_oldest: int = 0
    connections: int = 0


class Sender:
    """The sending end of one stream: a queue of one message in front of a TCP connection."""

    def __init__(self, read: bool = False) -> None:
        self.stats = Sent()
        self._waiting: bytes | None = None
        self._ready = asyncio.Event()
        self._read = read

    def offer(self, payload: bytes) -> None:
        """Queue a message; one that still waits is dropped."""
        self.stats.made += 1
        if self._waiting is not None:
            self.stats.dropped_oldest += 1
        self._waiting = HEADER.pack(MAGIC, len(payload), self.stats.made, time.time_ns()) + payload
        self._ready.set()

    async def pump(self, connection: socket.socket) -> None:
        """Send until the connection breaks (OSError)."""
        loop = asyncio.get_running_loop()
        # the kernel may hold little beyond what is in flight, so that "oldest" is decided here
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.IPPROTO_TCP, 25, 65536)  # TCP_NOTSENT_LOWAT
        self.stats.connections += 1
        while True:
            await self._ready.wait()
            self._ready.clear()
            message, self._waiting = self._waiting, None
            if message is not None:
                await loop.sock_sendall(connection, message)
                self.stats.sent += 1


async def receive(connection: socket.socket, stats: Received, take: Callable[[bytes], None] | None = None) -> None:
    """Read messages until the peer closes; counts them, and hands payloads to `take`.

    Raises:
        OSError: the connection broke.
        ValueError: what came is not our framing.
    """
    loop = asyncio.get_running_loop()
    chunk = bytearray(256 * 1024)
    view = memoryview(chunk)
    held = bytearray()
    remaining = last = 0
    while True:
        count = await loop.sock_recv_into(connection, chunk)
        if not count:
            return
        held += view[:count]
        while True:
            if remaining == 0:
                if len(held) < HEADER.size:
                    break
                magic, remaining, sequence, sent_ns = HEADER.unpack_from(held)
                if magic != MAGIC or not 0 < remaining <= MAX_MESSAGE:
                    raise ValueError("not a message of this program")
                del held[: HEADER.size]
            if len(held) < remaining:
                break
            if take is not None:
                take(bytes(held[:remaining]))
            age = max(0, time.time_ns() - sent_ns)
            stats.messages += 1
            stats.octets += remaining
            if last:
                stats.missing += max(0, sequence - last - 1)
            last = sequence
            stats.age_ns_sum += age
            stats.age_ns_max = max(stats.age_ns_max, age)
            del held[:remaining]
            remaining = 0


async def every(rate_hz: float, work: Callable[[], None]) -> None:
    """Call `work` on an absolute schedule; slots that passed are skipped."""
    period = 1 / rate_hz
    start = time.monotonic()
    index = 0
    while True:
        work()
        index = max(index + 1, int((time.monotonic() - start) / period))
        await asyncio.sleep(start + index * period - time.monotonic())


async def keep_connected(address: tuple[str, int], serve: Callable[[socket.socket], Coroutine[Any, Any, None]]) -> None:
    """Connect, serve, and connect again whenever the connection is refused or breaks."""
    loop = asyncio.get_running_loop()
    while True:
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        connection.setblocking(False)
        try:
            await loop.sock_connect(connection, address)
            await serve(connection)
        except (OSError, ValueError):
            await asyncio.sleep(RECONNECT_S)
        finally:
            connection.close()


async def listen(
    address: tuple[str, int],
    serve: Callable[[socket.socket], Coroutine[Any, Any, None]],
    group: set[asyncio.Task[None]],
) -> None:
    """Accept connections; a new one replaces the one before, whose peer is gone."""
    loop = asyncio.get_running_loop()
    server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    server.setblocking(False)
    server.bind(address)
    server.listen(4)
    current: asyncio.Task[None] | None = None

    async def one(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError, ValueError):
            connection.setblocking(False)
            await serve(connection)

    with server:
        while True:
            connection, _ = await loop.sock_accept(server)
            if current is not None:
                current.cancel()
            current = asyncio.ensure_future(one(connection))
            group.add(current)
            current.add_done_callback(group.discard)


def datagrams_to(path: str) -> Callable[[bytes], None]:
    """A function that sends to a Unix datagram socket and counts on nobody being there."""
    handle = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    handle.setblocking(False)

    def send(data: bytes) -> None:
        # the receiver may not be there yet, or be busy: the next pose comes in 20 ms
        with contextlib.suppress(OSError):
            handle.sendto(data, path)

    return send


def robot_program(settings: Settings) -> tuple[list[Coroutine[Any, Any, None]], Callable[[], dict[str, Any]]]:
    """The robot's coroutines, and what to report at the end."""
    robot = Robot(settings.route, settings.drive, settings.seed)
    relay, eyes = datagrams_to(settings.pose_path), datagrams_to(settings.eyes_path)
    agent = FeedSender(settings.feed_path) if settings.feed_path is not None else None

    def feed(record: Record) -> None:
        if agent is not None:
            agent.send(record)

    camera, lidar = Sender(), Sender()
    commands = Received()
    traffic = settings.traffic

    def commanded(payload: bytes) -> None:
        forward, turn = COMMAND.unpack(payload)
        at = now()
        robot.command(at.mono_ns, forward, turn)
        feed(VelocityCommand(wall_ns=at.wall_ns, mono_ns=at.mono_ns, forward_m_per_s=forward, turn_rad_per_s=turn))

    def step() -> None:
        at = now()
        robot.step(at.mono_ns)
        feed(robot.odometry(at))
        pose = POSE.pack(robot.x_m, robot.y_m, robot.heading_rad, robot.forward_m_per_s, robot.turn_rad_per_s)
        relay(pose)
        eyes(pose)

    async def hear(connection: socket.socket) -> None:
        await receive(connection, commands, commanded)

    host = settings.station_address
    work = [every(ODOMETRY_HZ, step), keep_connected((host, COMMAND_PORT + settings.port_offset), hear)]
    for stream, sender, port in ((traffic.camera, camera, CAMERA_PORT), (traffic.lidar, lidar, LIDAR_PORT)):
        if stream.rate_hz > 0:
            payload = bytes(stream.octets)
            work += [
                every(stream.rate_hz, lambda s=sender, p=payload: s.offer(p)),  # type: ignore[misc]
                keep_connected((host, port + settings.port_offset), sender.pump),
            ]

    def result() -> dict[str, Any]:
        return {"camera": camera.stats, "lidar": lidar.stats, "commands": commands, "travelled_m": robot.travelled_m}

    return work, result


def station_program(settings: Settings) -> tuple[list[Coroutine[Any, Any, None]], Callable[[], dict[str, Any]]]:
    """The station's coroutines, and what to report at the end."""
    operator = Operator(settings.route, settings.drive)
    done = Path(settings.done_path)
    sight = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sight.bind(settings.eyes_path)
    sight.setblocking(False)
    camera, lidar = Received(), Received()
    commands = Sender()
    start = settings.route.waypoints[0]
    seen: list[float] = [start.x_m, start.y_m, settings.route.start_heading_rad, 0.0, 0.0]
    backtracked_ns = 0

    def look() -> None:
        nonlocal backtracked_ns
        with contextlib.suppress(BlockingIOError):
            while True:
                seen[:] = POSE.unpack(sight.recv(POSE.size))
        forward = seen[3]
        if forward < -0.1 and time.monotonic_ns() - backtracked_ns > LOST_ROBOT_NS:
            # it drives backwards by itself: it has lost us on the way to this waypoint
            operator.skip()
        if forward < -0.1:
            backtracked_ns = time.monotonic_ns()
        if operator.done and not done.exists():
            done.touch()
        commands.offer(COMMAND.pack(*operator.command(time.monotonic_ns(), seen[0], seen[1], seen[2])))

    async def count_camera(connection: socket.socket) -> None:
        await receive(connection, camera)

    async def count_lidar(connection: socket.socket) -> None:
        await receive(connection, lidar)

    host, tasks = settings.station_address, set[asyncio.Task[None]]()
    offset = settings.port_offset
    work = [
        every(settings.traffic.command_hz, look),
        listen((host, CAMERA_PORT + offset), count_camera, tasks),
        listen((host, LIDAR_PORT + offset), count_lidar, tasks),
        listen((host, COMMAND_PORT + offset), commands.pump, tasks),
    ]
    return work, lambda: {"camera": camera, "lidar": lidar, "commands": commands.stats, "drive_done": operator.done}


async def run(role: str, settings: Settings) -> None:
    """Run one program until SIGTERM or SIGINT; then write its counts."""
    work, result = (robot_program if role == "robot" else station_program)(settings)
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    tasks = [asyncio.ensure_future(each) for each in work]
    waiter = asyncio.ensure_future(stop.wait())
    done, _ = await asyncio.wait([*tasks, waiter], return_when=asyncio.FIRST_COMPLETED)
    for task in (*tasks, waiter):
        task.cancel()
    Path(settings.result_path.format(role=role)).write_bytes(msgspec.json.encode(result()))
    for task in done:
        task.result()  # an error of a program ends it loudly


def main() -> None:
    """Entry point; see the module's text."""
    path, role = sys.argv[1:]
    asyncio.run(run(role, msgspec.json.decode(Path(path).read_bytes(), type=Settings)))


if __name__ == "__main__":
    main()

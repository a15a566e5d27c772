"""The emulator's process: medium, channel and relay in real time: `relay_process SETTINGS.json`.

It gets the TUN devices as open descriptors, the robot's true pose over a Unix datagram socket, and writes the truth
as JSON lines into a pipe, so that no disk makes a packet late.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from collections import deque
from functools import partial
from pathlib import Path

import msgspec

from linkrover.emulator.driver import DriverFile
from linkrover.emulator.medium import Medium
from linkrover.emulator.presets import Case
from linkrover.emulator.relay import Link, Port, Relay, hurry
from linkrover.emulator.replay import ReplayLink, Timeline
from linkrover.emulator.tap import Tap
from linkrover.emulator.traffic import POSE
from linkrover.records import LinkTruth, Now, Pose, ProbeTruth, Record

POSE_TRUTH_NS = 45_000_000  # the true pose about 20 times a second
TRUTH_HELD = 50_000
"""Truth records kept while the pipe is full; beyond, the oldest go and are counted."""


class HostSettings(msgspec.Struct, frozen=True):
    """One host's packets."""

    name: str
    address: str
    tun_fd: int
    tap_fd: int


class RelaySettings(msgspec.Struct, frozen=True, kw_only=True):
    """What the process is told.

    pose_paths: by robot, a Unix datagram socket to listen on. driver_paths: by end, the emulated /proc/net/wireless.
    tick_hz: radio and truth.
    """

    hosts: tuple[HostSettings, ...]
    case: Case
    seed: int
    pose_paths: dict[str, str]
    driver_paths: dict[str, str]
    truth_fd: int
    iface: str = "wlan0"
    tick_hz: float = 50.0
    access_point_shows_signal: bool = True
    replay: Timeline | None = None


class TruthPipe:
    """Writes records as JSON lines (each shorter than PIPE_BUF, so whole or not at all); never blocks."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._waiting: deque[bytes] = deque(maxlen=TRUTH_HELD)
        self.lost = 0
        os.set_blocking(fd, False)

    def take(self, record: Record) -> None:
        """Queue one record and write what goes."""
        self.lost += len(self._waiting) == TRUTH_HELD
        self._waiting.append(msgspec.json.encode(record) + b"\n")
        self.flush()

    def flush(self) -> None:
        """Write what goes."""
        try:
            while self._waiting:
                os.write(self._fd, self._waiting[0])
                self._waiting.popleft()
        except BlockingIOError:
            return


class DriverFaces:
    """The drivers' texts of all ends, written from the medium's signals."""

    def __init__(self, settings: RelaySettings, medium: Medium) -> None:
        self._noise_dbm = medium.config.noise_dbm
        self._files = {end: DriverFile(Path(path), settings.iface) for end, path in settings.driver_paths.items()}
        self._hidden = set() if settings.access_point_shows_signal else {medium.access_point}

    def write(self, medium: Medium) -> None:
        """Show each end what it receives now; headers only where not associated."""
        for end, file in self._files.items():
            if end in self._hidden:
                continue
            peer = medium.access_point if end != medium.access_point else medium.stations[0]
            hop, out = medium.hop(peer, end), medium.hop(end, peer)
            associated = medium.associated(end if end != medium.access_point else peer)
            file.write(hop.rssi_dbm if associated else None, self._noise_dbm, out.dropped_retries)


class ChannelLink:
    """The case's channel over the true places of the nodes."""

    def __init__(self, case: Case, seed: int, faces: DriverFaces, robots: tuple[str, ...]) -> None:
        self._channel = case.make_channel(seed)
        self._faces = faces
        self.places: dict[str, tuple[float, float]] = {**dict.fromkeys(robots, (0.0, 0.0)), **case.places}
        self._start_ns = time.monotonic_ns()

    def tick(self, medium: Medium, at: Now) -> None:
        """Signals as of now, then the drivers' texts."""
        self._channel.apply(medium, (at.mono_ns - self._start_ns) / 1e9, self.places)
        self._faces.write(medium)


def _pose_socket(path: str) -> socket.socket:
    handle = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    handle.bind(path)
    handle.setblocking(False)
    return handle


def main() -> None:
    """Entry point; runs until SIGTERM."""
    settings = msgspec.json.decode(Path(sys.argv[1]).read_bytes(), type=RelaySettings)
    case = settings.case
    robots = tuple(settings.pose_paths)
    medium = case.make_medium(settings.seed, robots, start_ns=time.monotonic_ns())
    truth = TruthPipe(settings.truth_fd)
    faces = DriverFaces(settings, medium)
    poses = {name: _pose_socket(path) for name, path in settings.pose_paths.items()}
    if not hurry():
        print("running at ordinary priority: on a busy machine packets leave late, as the truth will say", flush=True)

    link: Link
    places: dict[str, tuple[float, float]] = {}
    if settings.replay is None:
        link = channel = ChannelLink(case, settings.seed, faces, robots)
        places = channel.places
    else:
        link = ReplayLink(settings.replay, faces)

    ports = [Port(host.name, host.address, host.tun_fd, Tap(host.tap_fd)) for host in settings.hosts]
    relay = Relay(medium, ports, link, truth.take, int(1e9 / settings.tick_hz))
    last_pose_ns = 0

    def moved(name: str) -> None:
        nonlocal last_pose_ns
        x, y, heading, forward, turn = POSE.unpack(poses[name].recv(POSE.size))
        places[name] = (x, y)
        now_ns = time.monotonic_ns()
        if name == "robot" and now_ns - last_pose_ns >= POSE_TRUTH_NS:
            last_pose_ns = now_ns
            truth.take(
                Pose(wall_ns=time.time_ns(), mono_ns=now_ns, x_m=x, y_m=y, heading_rad=heading,
                     forward_m_per_s=forward, turn_rad_per_s=turn, frame="map")
            )  # fmt: skip

    for name, handle in poses.items():
        relay.reader(handle.fileno(), partial(moved, name))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: relay.stop())
    relay.run()
    os.set_blocking(settings.truth_fd, True)
    truth.flush()
    # what a run's summary wants to know and no record holds
    print(
        json.dumps(
            {
                "forwarded": relay.forwarded,
                "unroutable": relay.unroutable,
                "refused_writes": relay.refused_writes,
                "truth_lost": truth.lost,
            }
        )
    )


TruthRecord = LinkTruth | ProbeTruth | Pose


if __name__ == "__main__":
    main()

"""The load itself: what a robot sends, in bounded threads, and the counting at the other end."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable

import msgspec

from linkrover.errors import ConfigError

BLOCK = bytes(65_536)
DATAGRAM_BYTES = 1_200
UDP_DEFAULT_BPS = 10e6
_TICK_S = 0.001
_POLL_S = 0.2
FIRST_BYTE_S = 5.0
UDP_GRACE_S = 0.5
END_SLACK_S = 0.5


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of load. Frames go out at frame_hz; one that the link has not taken by the next is dropped."""

    name: str
    about: str
    transport: str  # "tcp" or "udp"
    streams: int = 1
    frame_hz: float | None = None
    rate_bps: float | None = None  # None: as fast as TCP lets it

    @property
    def frame_bytes(self) -> int:
        """Octets of one frame."""
        if self.frame_hz is None or self.rate_bps is None:
            return 0
        return max(1, round(self.rate_bps / 8 / self.frame_hz))


PROFILES = {
    p.name: p
    for p in (
        Profile(
            name="camera", about="compressed images, 30 a second of 50 kB, TCP", transport="tcp", frame_hz=30.0,
            rate_bps=12e6,
        ),
        Profile(
            name="lidar", about="3D scans, 10 a second of 300 kB, TCP", transport="tcp", frame_hz=10.0, rate_bps=24e6
        ),
        Profile(name="bulk", about="one TCP connection as fast as it goes (a file copy)", transport="tcp"),
        Profile(name="tcp", about="four TCP connections as fast as they go", transport="tcp", streams=4),
        Profile(name="udp", about="UDP datagrams at a steady rate", transport="udp", rate_bps=UDP_DEFAULT_BPS),
    )
}  # fmt: skip


def profile(name: str, rate_bps: float | None = None) -> Profile:
    """A profile by name, its rate changed where one is given.

    Raises:
        ConfigError: no such profile, or a rate for one that has none.
    """
    found = PROFILES.get(name)
    if found is None:
        raise ConfigError(f"profile '{name}': must be one of {', '.join(PROFILES)}")
    if rate_bps is None:
        return found
    if found.rate_bps is None:
        raise ConfigError(f"profile '{name}' sends as fast as it can: a rate is for camera, lidar and udp")
    if not 1e3 <= rate_bps <= 1e10:
        raise ConfigError(f"rate {rate_bps / 1e6:g} Mbit/s: must be from 0.001 to 10000 Mbit/s")
    return msgspec.structs.replace(found, rate_bps=rate_bps)


class Tally:
    """What one thread sent or received."""

    def __init__(self) -> None:
        self.bytes = 0
        self.datagrams = 0
        self.frames = 0
        self.dropped = 0
        self.refused = 0  # datagrams the local stack did not take
        self.seconds = 0.0
        self.error: str | None = None

    @property
    def bps(self) -> float:
        """Bits per second of the phase's length."""
        return self.bytes * 8 / self.seconds if self.seconds else 0.0


class Worker:
    """One bounded thread of load. stop() ends it early; join() waits for it."""

    def __init__(self, work: Callable[[Tally, threading.Event], None]) -> None:
        self.tally = Tally()
        self._stop = threading.Event()
        self._work = work
        self._thread = threading.Thread(target=self._run, name="linkrover-load", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._work(self.tally, self._stop)
        except OSError as error:
            self.tally.error = error.strerror or str(error)

    def stop(self) -> None:
        """Ask it to end."""
        self._stop.set()

    def join(self, timeout_s: float) -> bool:
        """Whether it has ended within the time."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()


def abort(sock: socket.socket) -> None:
    """Close a TCP connection and discard what is still queued: the phase is over."""
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()


def tcp_sender(sock: socket.socket, kind: Profile, seconds: float) -> Worker:
    """Send on a connection for `seconds`, then close it."""

    def work(tally: Tally, stop: threading.Event) -> None:
        tally.seconds = seconds
        ends = time.monotonic() + seconds
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(_POLL_S)
            if kind.frame_hz is None:
                while time.monotonic() < ends and not stop.is_set():
                    with contextlib.suppress(TimeoutError):
                        tally.bytes += sock.send(BLOCK)
            else:
                _send_frames(sock, kind, ends, tally, stop)
        except (ConnectionResetError, BrokenPipeError):
            if time.monotonic() < ends - END_SLACK_S:
                raise  # else the receiver has counted its seconds and closed first
        finally:
            abort(sock)

    return Worker(work)


def _send_frames(sock: socket.socket, kind: Profile, ends: float, tally: Tally, stop: threading.Event) -> None:
    assert kind.frame_hz is not None
    frame = memoryview(bytes(kind.frame_bytes))
    began = time.monotonic()
    slot = 0
    while not stop.is_set():
        due = began + slot / kind.frame_hz
        now = time.monotonic()
        if due >= ends or now >= ends:
            return
        if due > now and stop.wait(due - now):
            return
        at = 0
        while at < len(frame) and time.monotonic() < ends and not stop.is_set():
            with contextlib.suppress(TimeoutError):
                sent = sock.send(frame[at:])
                at += sent
                tally.bytes += sent
        tally.frames += at == len(frame)
        following = max(slot + 1, int((time.monotonic() - began) * kind.frame_hz))
        tally.dropped += following - slot - 1
        slot = following


def tcp_receiver(sock: socket.socket, seconds: float, already: int = 0) -> Worker:
    """Count what arrives in the `seconds` from the first octet on, then close the connection."""

    def work(tally: Tally, stop: threading.Event) -> None:
        room = bytearray(262_144)
        tally.seconds = seconds
        tally.bytes = already
        ends = time.monotonic() + (seconds if already else FIRST_BYTE_S)
        try:
            sock.settimeout(_POLL_S)
            while time.monotonic() < ends and not stop.is_set():
                try:
                    got = sock.recv_into(room)
                except TimeoutError:
                    continue
                except ConnectionResetError:
                    return  # the sender's way of closing
                if not got:
                    return
                if not tally.bytes:
                    ends = time.monotonic() + seconds
                tally.bytes += got
        finally:
            abort(sock)

    return Worker(work)


def phase_mark(session: bytes, phase: int) -> bytes:
    """What every datagram of one phase of one session begins with."""
    return session + phase.to_bytes(4, "big")


def udp_sender(
    sock: socket.socket, to: tuple[str, int] | tuple[str, int, int, int], mark: bytes, kind: Profile, seconds: float
) -> Worker:
    """Send datagrams at the profile's rate for `seconds`. The socket stays open."""

    def work(tally: Tally, stop: threading.Event) -> None:
        datagram = mark + bytes(DATAGRAM_BYTES - len(mark))
        per_s = (kind.rate_bps or UDP_DEFAULT_BPS) / 8 / DATAGRAM_BYTES
        began = time.monotonic()
        tally.seconds = seconds
        tried = 0
        while not stop.is_set():
            elapsed = time.monotonic() - began
            if elapsed >= seconds:
                return
            due = int(elapsed * per_s) + 1
            # what could not be sent in a tenth of a second is not caught up with in one burst
            tried = max(tried, due - int(per_s * 0.1) - 1)
            while tried < due:
                tried += 1
                try:
                    tally.bytes += sock.sendto(datagram, to)
                    tally.datagrams += 1
                except OSError:
                    tally.refused += 1
            stop.wait(_TICK_S)

    return Worker(work)


def udp_receiver(sock: socket.socket, source: str, mark: bytes, seconds: float) -> Worker:
    """Count this phase's datagrams from `source`. The socket stays open.

    Octets count in the `seconds` from the first on, datagrams half a second longer: what a queue still held is late,
    not lost.
    """

    def work(tally: Tally, stop: threading.Event) -> None:
        tally.seconds = seconds
        sock.settimeout(_POLL_S)
        ends = window = time.monotonic() + FIRST_BYTE_S
        while time.monotonic() < ends and not stop.is_set():
            try:
                data, address = sock.recvfrom(2_048)
            except TimeoutError:
                continue
            if address[0] != source or len(data) != DATAGRAM_BYTES or data[: len(mark)] != mark:
                continue
            if not tally.datagrams:
                window = time.monotonic() + seconds
                ends = window + UDP_GRACE_S
            tally.datagrams += 1
            if time.monotonic() < window:
                tally.bytes += len(data)

    return Worker(work)

"""Kernel timestamps of UDP packets (Linux, Documentation/networking/timestamping.rst) and the pairing of clocks.

Kernel stamps are CLOCK_REALTIME, which may be stepped while a probe is under way. Both clocks are read together at
sending and receiving: if their distance changed, the clock was stepped and the monotonic reading is used instead.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import socket
import struct
import time

import msgspec

from .packet import ErrorEstimate

# Linux numbers the socket module does not name (asm-generic/socket.h, linux/in.h, linux/in6.h, net_tstamp.h).
SO_TIMESTAMPNS = 35
SO_TIMESTAMPING = 37
IP_PKTINFO = 8
IP_RECVERR = 11
IP_RECVTTL = 12
IP_RECVTOS = 13
IPV6_RECVERR = 25
MSG_ERRQUEUE = 0x2000
_RX_SOFTWARE, _SOFTWARE, _OPT_ID, _TX_SCHED, _OPT_TSONLY = 1 << 3, 1 << 4, 1 << 7, 1 << 8, 1 << 11
_RECEIVE_FLAGS = _RX_SOFTWARE | _SOFTWARE
# TX_SCHED stamps before the packet scheduler. TX_SOFTWARE would stamp behind it, in the driver, and hide what a full
# queue of this machine does to every packet.
_SEND_FLAGS = _RECEIVE_FLAGS | _TX_SCHED | _OPT_ID | _OPT_TSONLY
_ORIGIN_ICMP, _ORIGIN_ICMP6, _ORIGIN_TIMESTAMPING = 2, 3, 4
_EXTENDED_ERROR = struct.Struct("=IBBBBII")

STEP_NS = 1_000_000
"""Wall minus monotonic clock moving by more than this is a step; slewing moves both clocks alike."""

Ancillary = list[tuple[int, int, bytes]]


class Pair(msgspec.Struct, frozen=True):
    """One instant on both clocks, read within a few microseconds of each other."""

    wall_ns: int
    mono_ns: int

    @property
    def distance_ns(self) -> int:
        """Wall minus monotonic."""
        return self.wall_ns - self.mono_ns


def pair() -> Pair:
    """Read both clocks, again (up to three times) if this thread was interrupted in between."""
    for _ in range(3):
        before = time.monotonic_ns()
        wall = time.time_ns()
        after = time.monotonic_ns()
        if after - before < 20_000:
            break
    return Pair(wall, (before + after) >> 1)


class SentStamp(msgspec.Struct, frozen=True):
    """A send time from the error queue: the count of the packet on this socket, and CLOCK_REALTIME ns."""

    key: int
    wall_ns: int


class PathError(msgspec.Struct, frozen=True):
    """An ICMP error from the path, as an errno (ECONNREFUSED: nothing listens there)."""

    number: int


def wants_receive_stamps(sock: socket.socket) -> bool:
    """Ask for kernel receive stamps; False where this kernel gives none and user clocks must do."""
    for option, value in ((SO_TIMESTAMPING, _RECEIVE_FLAGS), (SO_TIMESTAMPNS, 1)):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, value)
            return True
    return False


def wants_send_stamps(sock: socket.socket) -> bool:
    """Ask for receive stamps and for send stamps in the error queue, counted from 0 again."""
    try:
        # OPT_ID restarts its count only when it is switched on anew
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPING, _RECEIVE_FLAGS)
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPING, _SEND_FLAGS)
    except OSError:
        wants_receive_stamps(sock)
        return False
    return True


def wants_path_errors(sock: socket.socket) -> None:
    """Ask for ICMP errors on an unconnected socket, where the kernel has it."""
    level, option = (socket.IPPROTO_IPV6, IPV6_RECVERR) if sock.family == socket.AF_INET6 else (0, IP_RECVERR)
    with contextlib.suppress(OSError):
        sock.setsockopt(level, option, 1)


def stamp_of(ancillary: Ancillary) -> int | None:
    """The software timestamp among control messages, CLOCK_REALTIME ns; None if there is none."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind in (SO_TIMESTAMPING, SO_TIMESTAMPNS):
            # struct timespec of two longs, once or three times (software, deprecated, hardware)
            layout = "=qq" if len(data) in (16, 48) else "=ii"
            if len(data) < struct.calcsize(layout):
                continue
            seconds, nanoseconds = struct.unpack_from(layout, data)
            if seconds or nanoseconds:
                return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return None


def read_error_queue(sock: socket.socket) -> list[SentStamp | PathError]:
    """Everything the socket's error queue holds now."""
    found: list[SentStamp | PathError] = []
    while True:
        try:
            _, ancillary, _, _ = sock.recvmsg(0, 256, MSG_ERRQUEUE)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EWOULDBLOCK):
                return found
            found.append(PathError(error.errno or 0))
            return found
        entry = queue_entry(ancillary)
        if entry is not None:
            found.append(entry)


def queue_entry(ancillary: Ancillary) -> SentStamp | PathError | None:
    """What one error-queue message says (struct sock_extended_err); None if it is of no use here."""
    wall_ns = stamp_of(ancillary)
    for level, kind, data in ancillary:
        is_error = (level == socket.IPPROTO_IP and kind == IP_RECVERR) or (
            level == socket.IPPROTO_IPV6 and kind == IPV6_RECVERR
        )
        if not is_error or len(data) < _EXTENDED_ERROR.size:
            continue
        number, origin, _, _, _, _, key = _EXTENDED_ERROR.unpack_from(data)
        if origin == _ORIGIN_TIMESTAMPING and wall_ns is not None:
            return SentStamp(key, wall_ns)
        if origin in (_ORIGIN_ICMP, _ORIGIN_ICMP6):
            return PathError(number)
    return None


class _Timex(ctypes.Structure):
    # struct timex (linux/timex.h); only the leading fields are read
    _fields_ = [
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    ]


def clock_error() -> ErrorEstimate:
    """What the kernel says of CLOCK_REALTIME (adjtimex): synchronised or not, and its largest error.

    Where the kernel does not say: not synchronised, 16 s, which is what it says of an unsynchronised clock.
    """
    unsynchronised = ErrorEstimate.of_ns(16_000_000_000, synchronized=False)
    timex = _Timex()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):
        return unsynchronised
    if state < 0 or state == 5:  # TIME_ERROR: the clock is not synchronised
        return unsynchronised
    return ErrorEstimate.of_ns(max(1, int(timex.maxerror)) * 1000, synchronized=True)

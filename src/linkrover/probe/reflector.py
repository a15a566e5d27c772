"""The stateful Session-Reflector of RFC 8762."""

from __future__ import annotations

import errno
import socket
import struct
import sys
import time
from collections.abc import Callable

import msgspec

from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Job, Loop

from . import limits, packet, stamps

_READ_AT_ONCE = 64
_IN_PKTINFO = struct.Struct("=i4s4s")
_IN6_PKTINFO = struct.Struct("=16si")
_INT = struct.Struct("=i")


class ReflectorCounters(msgspec.Struct):
    """What came and what became of it, since the start. Every packet is in `received` and in one of the others."""

    received: int = 0
    answered: int = 0
    malformed: int = 0  # too short to be a test packet
    unauthenticated: int = 0  # wrong HMAC
    rate_limited: int = 0
    send_failed: int = 0  # the local stack refused the answer
    replayed: int = 0  # a sequence number seen before; counted beside `answered`, not instead of it
    user_stamped: int = 0  # T2 from the user clock, because the kernel gave no stamp; beside `answered`
    clock_steps: int = 0
    answered_bytes: int = 0
    received_bytes: int = 0


class StampReflector:
    """Answers test packets on one UDP port, IPv4 and IPv6, with a sequence of its own for each session.

    T2 is the kernel's receive stamp where there is one; T3 is read just before sending. An answer is exactly as long
    as its request, goes back from the address the request came to, with the same DSCP. A replayed or duplicated
    request is answered like any other (the network duplicates too, and the sender must see it) and counted.

    Args:
        loop: runs it.
        bind_host: address to listen on; "" for all of both families.
        port: UDP port; 0 takes any free one (see `port`).
        key: shared secret; with it only authenticated packets are answered.
        rate_per_s: packets a second answered to one source address, with bursts of half a second's worth.
        on_session: told of (address, port, SSID) when a session has lasted for a second.

    Raises:
        ConfigError: from start(): the address or port cannot be had.
    """

    def __init__(
        self,
        loop: Loop,
        bind_host: str = "",
        port: int = packet.DEFAULT_PORT,
        *,
        key: bytes | None = None,
        rate_per_s: float = limits.SOURCE_RATE_PER_S,
        on_session: Callable[[limits.SessionKey], None] | None = None,
    ) -> None:
        self.counters = ReflectorCounters()
        self.sessions = limits.SessionTable()
        self.port = port
        self._loop = loop
        self._bind_host = bind_host
        self._key = key
        self._limiter = limits.SourceLimiter(
            rate_per_s, max(1.0, rate_per_s / 2), limits.TOTAL_RATE_PER_S, time.monotonic_ns()
        )
        self._on_session = on_session
        self._known: set[limits.SessionKey] = set()
        self._sockets: list[socket.socket] = []
        self._removers: list[Callable[[], None]] = []
        self._upkeep: Job | None = None
        self._error_bits = 1
        self._distance_ns = 0
        self._buffer = bytearray(packet.MAX_BYTES + 1)
        self._view = memoryview(self._buffer)

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it listens, as `address:port`."""
        names = [s.getsockname() for s in self._sockets]
        return tuple(f"[{n[0]}]:{n[1]}" if ":" in n[0] else f"{n[0]}:{n[1]}" for n in names)

    def start(self) -> None:
        """Bind and begin to answer."""
        self._refresh_clock()
        families = [socket.AF_INET, socket.AF_INET6] if not self._bind_host else [_family_of(self._bind_host)]
        for family in families:
            try:
                sock = self._open(family)
            except OSError as error:
                if family == socket.AF_INET6 and self._sockets and error.errno != errno.EADDRINUSE:
                    continue  # a kernel without IPv6
                self.stop()
                raise ConfigError(self._cannot_bind(error)) from error
            self._sockets.append(sock)
            self.port = sock.getsockname()[1]
        for sock in self._sockets:
            self._removers.append(self._loop.reader(sock, self._reading(sock)))
        self._upkeep = self._loop.every(10_000_000_000, lambda _slot: self._look_after())

    def stop(self) -> None:
        """Close the sockets; counters stay readable."""
        if self._upkeep is not None:
            self._upkeep.cancel()
            self._upkeep = None
        for remove in self._removers:
            remove()
        self._removers.clear()
        for sock in self._sockets:
            sock.close()
        self._sockets.clear()

    def _open(self, family: int) -> socket.socket:
        sock = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                options = (
                    (socket.IPPROTO_IPV6, socket.IPV6_RECVPKTINFO),
                    (socket.IPPROTO_IPV6, socket.IPV6_RECVHOPLIMIT),
                    (socket.IPPROTO_IPV6, socket.IPV6_RECVTCLASS),
                )
            else:
                options = (
                    (socket.IPPROTO_IP, stamps.IP_PKTINFO),
                    (socket.IPPROTO_IP, stamps.IP_RECVTTL),
                    (socket.IPPROTO_IP, stamps.IP_RECVTOS),
                )
            for level, option in options:
                sock.setsockopt(level, option, 1)
            stamps.wants_receive_stamps(sock)
            sock.bind((self._bind_host, self.port))
        except BaseException:
            sock.close()
            raise
        return sock

    def _cannot_bind(self, error: OSError) -> str:
        where = f"UDP port {self.port}" + (f" on {self._bind_host}" if self._bind_host else "")
        if error.errno == errno.EACCES:
            return (
                f"not permitted to listen on {where}: ports below 1024 need a privilege. Use the default port "
                f"{packet.DEFAULT_PORT}, or run as root"
            )
        if error.errno == errno.EADDRINUSE:
            return f"{where} is taken: another reflector or agent runs here. Stop it, or give another --port"
        if error.errno == errno.EADDRNOTAVAIL:
            return f"{self._bind_host} is no address of this machine: see `ip address`"
        return f"cannot listen on {where}: {error.strerror}"

    def _reading(self, sock: socket.socket) -> Callable[[], None]:
        def read() -> None:
            for _ in range(_READ_AT_ONCE):
                try:
                    length, ancillary, _, source = sock.recvmsg_into([self._buffer], 512)
                except BlockingIOError:
                    return
                except OSError:
                    continue  # an ICMP error of an earlier answer, reported here once
                self._take(sock, bytes(self._view[:length]), ancillary, source)

        return read

    def _take(
        self, sock: socket.socket, data: bytes, ancillary: stamps.Ancillary, source: tuple[str, int, int, int]
    ) -> None:
        counters = self.counters
        counters.received += 1
        counters.received_bytes += len(data)
        now = stamps.pair()
        if not self._limiter.allows(source[0], now.mono_ns):
            counters.rate_limited += 1
            return
        try:
            request = packet.decode_sender(data, key=self._key)
        except ParseError:
            if len(data) < (packet.TWAMP_LIGHT_BYTES if self._key is None else packet.AUTHENTICATED_BYTES):
                counters.malformed += 1
            else:
                counters.unauthenticated += 1
            return
        key = (source[0], source[1], request.ssid)
        session = self.sessions.get(key, now.mono_ns)
        if session.note(request.sequence, now.mono_ns):
            counters.replayed += 1
        if session.received == limits.ESTABLISHED_PACKETS + 1:
            self._announce(key)
        receive_ns = self._receive_time(ancillary, now)
        ttl, reply_ancillary = _echo_ancillary(ancillary)
        reply = packet.answer(
            data,
            sequence=session.sequence,
            receive_ns=receive_ns,
            send_ns=max(receive_ns, time.time_ns()),
            error_estimate=self._error_bits,
            ttl=ttl,
            ssid=request.ssid,
            key=self._key,
        )
        try:
            sock.sendmsg([reply], reply_ancillary, 0, source)
        except OSError:
            counters.send_failed += 1
            return
        session.sequence += 1
        counters.answered += 1
        counters.answered_bytes += len(reply)

    def _receive_time(self, ancillary: stamps.Ancillary, now: stamps.Pair) -> int:
        kernel_ns = stamps.stamp_of(ancillary)
        stepped = abs(now.distance_ns - self._distance_ns) > stamps.STEP_NS
        if stepped:
            self.counters.clock_steps += 1
            self._distance_ns = now.distance_ns
        if kernel_ns is None or stepped or kernel_ns > now.wall_ns:
            self.counters.user_stamped += 1
            return now.wall_ns
        return kernel_ns

    def _announce(self, key: limits.SessionKey) -> None:
        if self._on_session is not None and key not in self._known:
            if len(self._known) >= limits.SESSIONS_MOST:
                self._known.clear()
            self._known.add(key)
            self._on_session(key)

    def _look_after(self) -> None:
        self._refresh_clock()
        for key, _ in self.sessions.expire(time.monotonic_ns()):
            self._known.discard(key)

    def _refresh_clock(self) -> None:
        self._error_bits = stamps.clock_error().encode()
        if self._distance_ns == 0:
            self._distance_ns = stamps.pair().distance_ns


def _family_of(host: str) -> int:
    try:
        return int(socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)[0][0])
    except OSError as error:
        raise ConfigError(f"cannot listen on '{host}': {error.strerror}; give an IP address of this machine") from error


def _echo_ancillary(ancillary: stamps.Ancillary) -> tuple[int, stamps.Ancillary]:
    """The request's TTL, and the control messages that send the answer from the same address with the same DSCP."""
    ttl = 0
    echo: stamps.Ancillary = []
    for level, kind, data in ancillary:
        if level == socket.IPPROTO_IP:
            if kind == socket.IP_TTL:
                ttl = _number(data)
            elif kind == socket.IP_TOS and data[0] >> 2:
                echo.append((level, kind, _INT.pack(data[0] & 0xFC)))
            elif kind == stamps.IP_PKTINFO:
                _, local, _ = _IN_PKTINFO.unpack_from(data)
                echo.append((level, kind, _IN_PKTINFO.pack(0, local, bytes(4))))
        elif level == socket.IPPROTO_IPV6:
            if kind == socket.IPV6_HOPLIMIT:
                ttl = _number(data)
            elif kind == socket.IPV6_TCLASS and _number(data) >> 2:
                echo.append((level, kind, _INT.pack(_number(data) & 0xFC)))
            elif kind == socket.IPV6_PKTINFO:
                address, index = _IN6_PKTINFO.unpack_from(data)
                link_local = address[0] == 0xFE and address[1] & 0xC0 == 0x80
                echo.append((level, kind, _IN6_PKTINFO.pack(address, index if link_local else 0)))
    return ttl & 0xFF, echo


def _number(data: bytes) -> int:
    return int.from_bytes(data[:4], sys.byteorder)

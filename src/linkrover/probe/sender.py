"""The Session-Sender of RFC 8762 on a fixed absolute schedule: never waits, many probes in flight."""

from __future__ import annotations

import errno
import secrets
import socket
import threading
import time
from collections.abc import Callable

import msgspec

from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Job, Loop, Slot
from linkrover.records import ClockSource, ProbeResult

from . import packet, stamps
from .address import Endpoint, numeric, resolve
from .ledger import Answer, Flight, Ledger

PERIOD_LEAST_NS = 1_000_000
PERIOD_MOST_NS = 1_000_000_000
LATE_NS = 10_000_000_000
_READ_AT_ONCE = 64
_RESOLVE_AGAIN_S = 5.0
_REOPEN = {errno.EINVAL, errno.ENODEV, errno.ENXIO, errno.EADDRNOTAVAIL, errno.EBADF}


class SenderCounters(msgspec.Struct):
    """What the sender saw beside the results themselves."""

    sent: int = 0
    not_sent: int = 0
    answers: int = 0  # including duplicates and late ones
    duplicates: int = 0
    malformed: int = 0  # too short for an answer
    unauthenticated: int = 0  # wrong HMAC
    unexpected: int = 0  # from another address, of another session, or never asked for
    user_stamped_sends: int = 0  # answered probes whose send time is the user clock's
    user_stamped_receipts: int = 0
    clock_steps: int = 0
    missed_slots: int = 0  # slots of the schedule skipped because this process was held up
    refused: int = 0  # ICMP: nothing listens on the peer's port


class StampSender:
    """Sends test packets to one reflector and reports each one's fate.

    on_result gets a ProbeResult when a probe is answered, refused by the local stack (NOT_SENT) or past its deadline;
    and, rarely, a later one of the same session and sequence that supersedes it (late answer, duplicate, direction
    of a loss known once the peer is back).

    Args:
        loop: runs it; on_result is called from its thread.
        host: name or address of the reflector. A name is looked up beside the loop, again every 5 s until known;
            until then probes are NOT_SENT.
        port: UDP port of the reflector (862 for other vendors' gear).
        on_result: receives the results.
        period_ns: 1 ms to 1 s between probes.
        deadline_ns: an answer after this is late.
        count: stop after this many slots of the schedule, missed ones included; None = until stop().
        key: shared secret of authenticated mode.
        ssid: session identifier (RFC 8972, 3), 1 to 65535; chosen at random by default.
        size: UDP payload octets; the base packet (44, authenticated 112) is padded up to it.
        dscp: differentiated services code point of the probes, 0 to 63 (Wi-Fi maps it to an access category).
        source: local address to send from; by default the kernel chooses per packet, so that an address change
            does not end the measurement.
        interface: network device to send through (SO_BINDTODEVICE).
        late_ns: how long after the deadline an answer is still recognised.

    Raises:
        ConfigError: a value out of range.
    """

    def __init__(
        self,
        loop: Loop,
        host: str,
        port: int = packet.DEFAULT_PORT,
        *,
        on_result: Callable[[ProbeResult], None],
        period_ns: int = 100_000_000,
        deadline_ns: int = 2_000_000_000,
        count: int | None = None,
        key: bytes | None = None,
        ssid: int | None = None,
        size: int = 0,
        dscp: int = 0,
        source: str | None = None,
        interface: str | None = None,
        late_ns: int = LATE_NS,
    ) -> None:
        least = packet.BASE_BYTES if key is None else packet.AUTHENTICATED_BYTES
        if not PERIOD_LEAST_NS <= period_ns <= PERIOD_MOST_NS:
            raise ConfigError(f"probe rate {1e9 / max(1, period_ns):g} Hz: must be from 1 to 1000 Hz")
        if deadline_ns <= 0:
            raise ConfigError("probe deadline: must be above 0 s")
        if size and not least <= size <= packet.MAX_BYTES:
            raise ConfigError(f"probe size {size}: must be from {least} to {packet.MAX_BYTES} octets")
        if not 0 <= dscp <= 63:
            raise ConfigError(f"dscp {dscp}: must be from 0 to 63")
        if ssid is not None and not 1 <= ssid <= 0xFFFF:
            raise ConfigError(f"session identifier {ssid}: must be from 1 to 65535")
        self.counters = SenderCounters()
        self.session = ssid if ssid is not None else 1 + secrets.randbelow(0xFFFF)
        self.host, self.port = host, port
        self.packet_bytes = max(size, least)
        self.last_error: OSError | None = None
        self._loop = loop
        self._period_ns, self._deadline_ns = period_ns, deadline_ns
        self._count = count
        self._key = key
        self._dscp = dscp
        self._source, self._interface = source, interface
        self._endpoint = numeric(host, port)
        self._lookup_error: ConfigError | None = None
        self._closing = threading.Event()
        self._sock: socket.socket | None = None
        self._remove_reader: Callable[[], None] | None = None
        self._job: Job | None = None
        self._next_sequence = 1  # see ledger: tells a stateless reflector from a stateful one
        self._armed = False
        self._stamp_base = 0
        self._stamped: dict[int, Flight] = {}
        self._stamps_doubtful = False
        self._sends_stamped = False
        self._error_estimate = packet.ErrorEstimate()
        self._ledger = Ledger(_name(host, port), self.session, self.packet_bytes, late_ns, on_result)

    @property
    def peer(self) -> str:
        """The reflector as the results name it, `host:port`."""
        return _name(self.host, self.port)

    @property
    def endpoint(self) -> Endpoint | None:
        """The reflector's address; None while its name is not resolved."""
        return self._endpoint

    @property
    def in_flight(self) -> int:
        """Probes whose fate is not known yet."""
        return self._ledger.in_flight

    @property
    def sending(self) -> bool:
        """Whether further probes will be sent."""
        return self._job is not None and not self._job.cancelled

    @property
    def reflector_restarts(self) -> int:
        """How often the reflector's own sequence began again."""
        return self._ledger.restarts

    @property
    def reflector_stateless(self) -> bool:
        """The reflector copies our sequence instead of counting: losses have no direction then."""
        return self._ledger.stateless

    @property
    def lookup_error(self) -> ConfigError | None:
        """Why the peer's name is not resolved, while it is not."""
        return self._lookup_error if self._endpoint is None else None

    def start(self, *, start_ns: int | None = None) -> None:
        """Begin to send, at start_ns (CLOCK_MONOTONIC) or now."""
        self._error_estimate = stamps.clock_error()
        if self._endpoint is None:
            threading.Thread(target=self._look_up, name="linkrover-lookup", daemon=True).start()
        self._job = self._loop.every(self._period_ns, self._turn, start_ns=start_ns)

    def stop_sending(self) -> None:
        """No further probes; answers to those in flight are still taken until stop()."""
        if self._job is not None:
            self._job.cancel()

    def stop(self) -> None:
        """Stop sending and close the socket. Probes in flight are not reported: their fate is not known."""
        self.stop_sending()
        self._closing.set()
        self._close()

    def _look_up(self) -> None:
        while not self._looked_up():
            if self._closing.wait(_RESOLVE_AGAIN_S):
                return

    def _looked_up(self) -> bool:
        try:
            self._endpoint = resolve(self.host, self.port)
        except ConfigError as error:
            self._lookup_error = error
            return False
        return True

    def _open(self, endpoint: Endpoint) -> socket.socket:
        sock = socket.socket(endpoint.family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            if self._interface is not None:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, self._interface.encode())
            if self._source is not None:
                sock.bind((self._source, 0))
            if self._dscp:
                level, option = (
                    (socket.IPPROTO_IPV6, socket.IPV6_TCLASS)
                    if endpoint.family == socket.AF_INET6
                    else (socket.IPPROTO_IP, socket.IP_TOS)
                )
                sock.setsockopt(level, option, self._dscp << 2)
            stamps.wants_path_errors(sock)
            self._sends_stamped = stamps.wants_send_stamps(sock)
        except BaseException:
            sock.close()
            raise
        self._restart_stamps()
        self._remove_reader = self._loop.reader(sock, self._read)
        return sock

    def _close(self) -> None:
        if self._remove_reader is not None:
            self._remove_reader()
            self._remove_reader = None
        if self._sock is not None:
            self._sock.close()
            self._sock = None

    def _turn(self, slot: Slot) -> None:
        beyond = max(0, slot.index - self._count) if self._count is not None else 0
        self.counters.missed_slots += slot.missed - min(beyond, slot.missed)
        if self._count is not None and slot.index >= self._count - 1:
            self.stop_sending()
            if slot.index >= self._count:
                return
        sequence = self._next_sequence
        self._next_sequence += 1
        now = stamps.pair()
        lateness_ns = max(0, now.mono_ns - slot.due_ns)
        flight = Flight(sequence, now.wall_ns, now.mono_ns, now.mono_ns + self._deadline_ns, lateness_ns)
        test_packet = packet.SenderPacket(sequence & 0xFFFF_FFFF, now.wall_ns, self._error_estimate, self.session)
        data = packet.encode_sender(test_packet, key=self._key, size=self.packet_bytes)
        if self._send(data, flight):
            self.counters.sent += 1
            self._ledger.sent(flight)
            self._drain_errors()
        else:
            self.counters.not_sent += 1
            self._ledger.not_sent(flight)
        self._settle()

    def _send(self, data: bytes, flight: Flight) -> bool:
        endpoint = self._endpoint
        if endpoint is None:
            return False
        for attempt in (1, 2):
            try:
                if self._sock is None:
                    self._sock = self._open(endpoint)
                if self._stamps_doubtful:
                    self._drain_errors()
                    self._sends_stamped = stamps.wants_send_stamps(self._sock)
                    self._restart_stamps()
                if self._sends_stamped:
                    self._stamped[self._stamp_base] = flight
                self._sock.sendto(data, endpoint.address)
            except OSError as error:
                self._stamped.pop(self._stamp_base, None)
                self._stamps_doubtful = True  # this kernel may or may not have counted the packet
                self.last_error = error
                if error.errno in _REOPEN:
                    self._close()
                # an ICMP error of an earlier probe is reported by the next send, which was then not tried
                if attempt == 1 and (error.errno in _REOPEN or self._drain_errors()):
                    continue
                return False
            self._stamp_base += 1
            return True
        return False

    def _restart_stamps(self) -> None:
        self._stamp_base = 0
        self._stamped.clear()
        self._stamps_doubtful = False

    def _drain_errors(self) -> bool:
        """Take send stamps and ICMP errors; True if there was an ICMP error."""
        if self._sock is None:
            return False
        found_error = False
        for entry in stamps.read_error_queue(self._sock):
            if isinstance(entry, stamps.PathError):
                found_error = True
                self.counters.refused += entry.number == errno.ECONNREFUSED
                self.last_error = OSError(entry.number, _reason(entry.number))
                continue
            flight = self._stamped.pop(entry.key, None)
            # a stamp outside this span is not this packet's: the count is off, or the clock was stepped
            if flight is not None and -stamps.STEP_NS < entry.wall_ns - flight.wall_ns < self._deadline_ns:
                flight.stamp_ns = entry.wall_ns
        while len(self._stamped) > 4096:
            self._stamped.pop(next(iter(self._stamped)))
        return found_error

    def _read(self) -> None:
        self._drain_errors()
        for _ in range(_READ_AT_ONCE):
            if self._sock is None:
                return
            try:
                data, ancillary, _, source = self._sock.recvmsg(self.packet_bytes + 256, 512)
            except BlockingIOError:
                break
            except OSError as error:
                self.last_error = error
                self._drain_errors()
                break
            self._take(data, ancillary, source)
        self._settle()

    def _take(self, data: bytes, ancillary: stamps.Ancillary, source: tuple[str, int, int, int]) -> None:
        now = stamps.pair()
        counters = self.counters
        if self._endpoint is None or not self._endpoint.is_from(source):
            counters.unexpected += 1
            return
        try:
            reply = packet.decode_reflector(data, key=self._key)
        except ParseError:
            if len(data) < (packet.TWAMP_LIGHT_BYTES if self._key is None else packet.AUTHENTICATED_BYTES):
                counters.malformed += 1
            else:
                counters.unauthenticated += 1
            return
        flight = self._ledger.find(reply.sender_sequence)
        # the echoed timestamp is what a stranger who does not see our packets cannot know
        if flight is None or reply.sender_timestamp_ns != flight.wall_ns or reply.ssid not in (0, self.session):
            counters.unexpected += 1
            return
        counters.answers += 1
        counters.duplicates += flight.answer is not None
        self._ledger.answered(flight, self._times(flight, reply, stamps.stamp_of(ancillary), now))

    def _times(self, flight: Flight, reply: packet.ReflectorPacket, kernel_ns: int | None, now: stamps.Pair) -> Answer:
        """The four timestamps; by the monotonic clock where the wall clock was stepped in between."""
        sent_ns, received_ns = flight.stamp_ns, kernel_ns
        stepped = abs(now.distance_ns - (flight.wall_ns - flight.mono_ns)) > stamps.STEP_NS
        if stepped:
            self.counters.clock_steps += 1
            sent_ns = received_ns = None
        elif received_ns is not None and not flight.wall_ns - stamps.STEP_NS < received_ns <= now.wall_ns:
            received_ns = None
        self.counters.user_stamped_sends += sent_ns is None
        self.counters.user_stamped_receipts += received_ns is None
        t1_ns = flight.wall_ns if sent_ns is None else sent_ns
        t4_ns = flight.wall_ns + now.mono_ns - flight.mono_ns if received_ns is None else received_ns
        return Answer(
            reflector_sequence=reply.sequence,
            t1_ns=t1_ns,
            t2_ns=reply.receive_timestamp_ns,
            t3_ns=reply.timestamp_ns,
            t4_ns=t4_ns,
            arrived_mono_ns=flight.mono_ns + t4_ns - flight.wall_ns,
            send_clock=ClockSource.USER if sent_ns is None else ClockSource.KERNEL,
            receive_clock=ClockSource.USER if received_ns is None else ClockSource.KERNEL,
        )

    def _settle(self) -> None:
        self._ledger.due(time.monotonic_ns())
        deadline_ns = self._ledger.next_deadline_ns()
        if deadline_ns is not None and not self._armed and self._sock is not None:
            self._armed = True
            self._loop.at(deadline_ns, self._at_deadline)

    def _at_deadline(self) -> None:
        self._armed = False
        if self._sock is not None:
            self._drain_errors()
            self._settle()


def _name(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _reason(number: int) -> str:
    if number == errno.ECONNREFUSED:
        return "nothing listens on the peer's port"
    return errno.errorcode.get(number, str(number))

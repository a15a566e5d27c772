"""The asking end: idle, up, down and both ways, with probes throughout."""

from __future__ import annotations

import secrets
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import msgspec

from linkrover import __version__
from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Loop
from linkrover.probe.address import Endpoint, resolve
from linkrover.probe.sender import StampSender
from linkrover.probe.summary import ProbeSummary, summarise
from linkrover.records import ProbeResult

from . import load
from .protocol import (
    DEFAULT_PORT,
    PROTOCOL,
    Ask,
    Attach,
    Consent,
    Finish,
    Hello,
    Line,
    Load,
    Outcome,
    Ready,
    Refusal,
    StressError,
    proof,
    proves,
)

SETTLE_S = 0.5
PAUSE_S = 1.0
CONNECT_S = 5.0
PHASES = ("idle", "up", "down", "both")
HEADERS_BYTES = 28
"""IPv4 and UDP headers of a probe."""

_M = TypeVar("_M", Hello, Consent, Ready, Outcome)


class Phase(msgspec.Struct, frozen=True, kw_only=True):
    """One phase. Throughputs are payload octets received per second of the phase, None where the way was idle.

    buffer_delay: (mean RTT loaded - idle median RTT) / idle median RTT (RFC 6349, 3.3.5), None in the idle phase.
    *_lost: share of UDP load datagrams lost. frames_dropped: camera or lidar frames given up for newer ones.
    """

    name: str
    seconds: float
    probes: ProbeSummary
    up_bps: float | None = None
    down_bps: float | None = None
    up_lost: float | None = None
    down_lost: float | None = None
    frames_sent: int | None = None
    frames_dropped: int | None = None
    buffer_delay: float | None = None
    errors: tuple[str, ...] = ()


class StressReport(msgspec.Struct, frozen=True, kw_only=True):
    """A whole run. probe_overhead_bps: what the probes themselves put on the link in each direction."""

    peer: str
    peer_version: str
    profile: str
    rate_bps: float | None
    probe_rate_hz: float
    probe_overhead_bps: float
    phases: tuple[Phase, ...]


class StressClient:
    """Asks a peer for its consent and loads the link to it; never to any other address.

    Args:
        host: the peer.
        token: its consent token.
        port: TCP port of its consent server.
        key: of authenticated probes, where its reflector has one.
        probe_port: UDP port of its reflector; by default what the consent server says.
        probe_rate_hz: probes a second while measuring.
        deadline_s: an answer after this is late.

    Raises:
        StressError: from connect(): no consent server there, a wrong token, a refusal, a peer that cannot prove the
            token itself.
    """

    def __init__(
        self,
        host: str,
        token: bytes,
        port: int = DEFAULT_PORT,
        *,
        key: bytes | None = None,
        probe_port: int | None = None,
        probe_rate_hz: float = 50.0,
        deadline_s: float = 2.0,
    ) -> None:
        self._host, self._port, self._token = host, port, token
        self._key = key
        self._probe_port = probe_port
        self._probe_rate_hz = probe_rate_hz
        self._deadline_s = deadline_s
        self._line: Line | None = None
        self._consent: Consent | None = None
        self.hello: Hello | None = None
        self.address = ""

    def connect(self) -> None:
        """Shake hands; after it the peer has consented and has proved that it holds the token."""
        line = self._dial()
        self._line = line
        self.address = Endpoint(int(line.sock.family), line.sock.getpeername()).host
        hello = self._expect(line, Hello)
        if hello.protocol != PROTOCOL:
            raise StressError(
                f"{self._host} speaks stress protocol {hello.protocol} (linkrover {hello.version}), we {PROTOCOL}: "
                "install the same version at both ends"
            )
        nonce = secrets.token_hex(16)
        mac = proof(self._token, "client", nonce, hello.nonce)
        line.send(Ask(protocol=PROTOCOL, version=__version__, nonce=nonce, mac=mac))
        consent = self._expect(line, Consent)
        if not proves(consent.mac, self._token, "server", hello.nonce, nonce):
            raise StressError(f"{self._host} does not hold the consent token itself: nothing is sent to it")
        self.hello, self._consent = hello, consent

    def close(self) -> None:
        """End the session."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def probe_port(self) -> int:
        """UDP port of the peer's reflector.

        Raises:
            ConfigError: neither given nor told by the peer.
        """
        port = self._probe_port or (self.hello.reflector_port if self.hello is not None else None)
        if port is None:
            raise ConfigError("the peer has no reflector beside its consent server: start it with --reflect")
        return port

    def run(
        self,
        kind: load.Profile,
        *,
        seconds: float,
        phases: tuple[str, ...] = PHASES,
        on_phase: Callable[[str], None] = lambda _name: None,
        on_done: Callable[[Phase], None] = lambda _phase: None,
    ) -> StressReport:
        """Measure the phases one after the other, `seconds` each.

        Raises:
            StressError: the peer refused a phase or went away.
        """
        assert self.hello is not None, "connect() first"
        done: list[Phase] = []
        base_ns: float | None = None
        packet_bytes = 44 if self._key is None else 112
        for number, name in enumerate(phases):
            if number:
                time.sleep(PAUSE_S)
            on_phase(name)
            if name == "idle":
                phase = Phase(name=name, seconds=seconds, probes=self._probe(seconds))
                base_ns = phase.probes.rtt.median_ns if phase.probes.rtt is not None else None
            else:
                phase = self._loaded(kind, name, seconds, base_ns)
            done.append(phase)
            on_done(phase)
        return StressReport(
            peer=f"{self._host}:{self._port}",
            peer_version=self.hello.version,
            profile=kind.name,
            rate_bps=kind.rate_bps,
            probe_rate_hz=self._probe_rate_hz,
            probe_overhead_bps=self._probe_rate_hz * (packet_bytes + HEADERS_BYTES) * 8,
            phases=tuple(done),
        )

    def _loaded(self, kind: load.Profile, name: str, seconds: float, base_ns: float | None) -> Phase:
        line, up, down = self._line, name in ("up", "both"), name in ("down", "both")
        assert line is not None
        line.send(Load(profile=kind.name, up=up, down=down, seconds=seconds, rate_bps=kind.rate_bps))
        line.timeout_s = seconds + 30
        ready = self._expect(line, Ready)
        with self._flow(kind, ready, seconds, up=up, down=down) as (senders, receivers):
            # the first half second is TCP's start, not its steady state
            time.sleep(min(SETTLE_S, seconds / 4))
            probes = self._probe(seconds - min(SETTLE_S, seconds / 4))
            for worker in (*senders, *receivers):
                worker.join(seconds + load.FIRST_BYTE_S)
        line.send(Finish())
        outcome = self._expect(line, Outcome)
        sent = sum(w.tally.datagrams for w in senders)
        got = sum(w.tally.datagrams for w in receivers)
        framed = kind.frame_hz is not None
        mean_ns = probes.rtt.mean_ns if probes.rtt is not None else None
        return Phase(
            name=name,
            seconds=seconds,
            probes=probes,
            up_bps=outcome.received_bps if up else None,
            down_bps=sum(w.tally.bps for w in receivers) if down else None,
            up_lost=_lost(sent, outcome.received_datagrams) if up else None,
            down_lost=_lost(outcome.sent_datagrams, got) if down else None,
            frames_sent=sum(w.tally.frames for w in senders) + outcome.frames_sent if framed else None,
            frames_dropped=sum(w.tally.dropped for w in senders) + outcome.frames_dropped if framed else None,
            buffer_delay=None if base_ns is None or mean_ns is None else (mean_ns - base_ns) / base_ns,
            errors=tuple(w.tally.error for w in (*senders, *receivers) if w.tally.error is not None),
        )

    @contextmanager
    def _flow(
        self, kind: load.Profile, ready: Ready, seconds: float, *, up: bool, down: bool
    ) -> Iterator[tuple[list[load.Worker], list[load.Worker]]]:
        senders: list[load.Worker] = []
        receivers: list[load.Worker] = []
        udp: socket.socket | None = None
        try:
            if kind.transport == "udp":
                udp = self._start_udp(kind, ready.phase, seconds, senders, receivers, up=up, down=down)
            else:
                for _ in range(ready.streams):
                    if up:
                        senders.append(load.tcp_sender(self._attach(up=True), kind, seconds))
                    if down:
                        receivers.append(load.tcp_receiver(self._attach(up=False), seconds))
            yield senders, receivers
        finally:
            for worker in (*senders, *receivers):
                worker.stop()
            for worker in (*senders, *receivers):
                worker.join(2)
            if udp is not None:
                udp.close()

    def _start_udp(
        self,
        kind: load.Profile,
        phase: int,
        seconds: float,
        senders: list[load.Worker],
        receivers: list[load.Worker],
        *,
        up: bool,
        down: bool,
    ) -> socket.socket:
        assert self._consent is not None
        mark = load.phase_mark(bytes.fromhex(self._consent.session), phase)
        to = resolve(self.address, self._consent.udp_port).address
        udp = socket.socket(socket.AF_INET6 if ":" in self.address else socket.AF_INET, socket.SOCK_DGRAM)
        if down:
            receivers.append(load.udp_receiver(udp, self.address.partition("%")[0], mark, seconds))
            for _ in range(3):  # tells the peer's UDP port where to send; one may be lost
                udp.sendto(mark, to)
        if up:
            senders.append(load.udp_sender(udp, to, mark, kind, seconds))
        return udp

    def _attach(self, *, up: bool) -> socket.socket:
        assert self._consent is not None
        line = Line(socket.create_connection((self.address, self._port), timeout=CONNECT_S), CONNECT_S)
        try:
            self._expect(line, Hello)
            line.send(Attach(session=self._consent.session, up=up))
        except BaseException:
            line.close()
            raise
        return line.sock

    def _probe(self, seconds: float) -> ProbeSummary:
        results: list[ProbeResult] = []
        loop = Loop()
        sender = StampSender(
            loop,
            self.address,
            self.probe_port(),
            on_result=results.append,
            period_ns=round(1e9 / self._probe_rate_hz),
            deadline_ns=round(self._deadline_s * 1e9),
            key=self._key,
        )
        try:
            begun = time.monotonic_ns()
            sender.start()
            loop.run(begun + round(seconds * 1e9))
            sender.stop_sending()
            ends = time.monotonic_ns() + round(self._deadline_s * 1e9) + 50_000_000
            while sender.in_flight and time.monotonic_ns() < ends:
                loop.run(time.monotonic_ns() + 20_000_000)
        finally:
            sender.stop()
            loop.close()
        return summarise(results)

    def _dial(self) -> Line:
        try:
            return Line(socket.create_connection((self._host, self._port), timeout=CONNECT_S), CONNECT_S)
        except OSError as error:
            raise StressError(
                f"no consent server at {self._host} TCP port {self._port} ({error.strerror or error}): start "
                "`linkrover reflect --allow-stress` or an agent with --stress-token-file there"
            ) from error

    def _expect(self, line: Line, kind: type[_M]) -> _M:
        try:
            message = line.receive()
        except (OSError, EOFError) as error:
            raise StressError(f"{self._host} went away in the middle ({error})") from error
        except ParseError as error:
            raise StressError(f"{self._host} TCP port {self._port} is no consent server: {error}") from error
        if isinstance(message, Refusal):
            raise StressError(f"{self._host} refused: {message.reason}")
        if not isinstance(message, kind):
            raise StressError(f"{self._host} answered with {type(message).__name__} instead of {kind.__name__}")
        return message


def _lost(sent: int, received: int) -> float | None:
    return max(0, sent - received) / sent if sent else None

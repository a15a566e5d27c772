"""The consenting end: lets one client at a time, which holds the token, put bounded load on the link to here."""

from __future__ import annotations

import contextlib
import errno
import secrets
import socket
import threading
import time
from collections.abc import Callable

import msgspec

from linkrover import __version__
from linkrover.errors import ConfigError, ParseError

from . import load
from .protocol import (
    DEFAULT_PORT,
    PROTOCOL,
    SESSION_BYTES,
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
    check_token,
    proof,
    proves,
)

CONNECTIONS_MOST = 16
HANDSHAKE_S = 5.0
IDLE_S = 120.0
WRONG_TOKEN_S = 1.0


class ServerCounters(msgspec.Struct):
    """What came to the consent server."""

    connections: int = 0
    refused: int = 0
    wrong_token: int = 0
    malformed: int = 0
    phases: int = 0


class StressServer:
    """Listens on TCP for stress clients, in threads of its own; nothing of it runs in the caller's thread.

    Args:
        token: the consent; only who proves it may load the link.
        host: address to listen on, "" for all.
        port: TCP port; 0 takes any free one (see `port`).
        seconds_most: longest phase.
        rate_bps_most: greatest rate of a paced profile (camera, lidar, udp).
        reflector_port: UDP port of the STAMP reflector beside it, told to clients.
        on_event: gets a sentence for the log; called from other threads.

    Raises:
        ConfigError: from start(): the port cannot be had; at once: the token is too short.
    """

    def __init__(
        self,
        token: bytes,
        host: str = "",
        port: int = DEFAULT_PORT,
        *,
        seconds_most: float = 60.0,
        rate_bps_most: float = 1e9,
        reflector_port: int | None = None,
        on_event: Callable[[str], None] | None = None,
    ) -> None:
        self.port = port
        self.counters = ServerCounters()
        self._token = check_token(token)
        self._host = host
        self._seconds_most = seconds_most
        self._rate_bps_most = rate_bps_most
        self._reflector_port = reflector_port
        self._tell = on_event or (lambda _text: None)
        self._listener: socket.socket | None = None
        self._slots = threading.BoundedSemaphore(CONNECTIONS_MOST)
        self._lock = threading.Lock()
        self._session: _Session | None = None
        self._open: set[socket.socket] = set()

    def start(self) -> None:
        """Bind and begin to accept."""
        try:
            if self._host:
                family = socket.getaddrinfo(self._host, self.port, type=socket.SOCK_STREAM)[0][0]
                listener = socket.create_server((self._host, self.port), family=family, backlog=16)
            else:
                listener = _dual_stack(self.port)
        except OSError as error:
            hint = "is taken; give another port" if error.errno == errno.EADDRINUSE else error.strerror
            raise ConfigError(f"stress: TCP port {self.port} {hint}") from error
        self._listener = listener
        self.port = listener.getsockname()[1]
        threading.Thread(target=self._accept, args=(listener,), name="linkrover-stress", daemon=True).start()

    def stop(self) -> None:
        """Stop listening and end the session under way."""
        listener, self._listener = self._listener, None
        if listener is not None:
            # shutdown wakes the thread that waits in accept(); close alone does not
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        with self._lock:
            for sock in tuple(self._open):
                load.abort(sock)
            session = self._session
        if session is not None:
            session.end()

    def _accept(self, listener: socket.socket) -> None:
        while self._listener is listener:
            try:
                sock, address = listener.accept()
            except OSError as error:
                if self._listener is not listener:
                    return
                self._tell(f"stress: cannot accept: {error.strerror}")
                time.sleep(0.1)
                continue
            self.counters.connections += 1
            if not self._slots.acquire(blocking=False):
                self.counters.refused += 1
                sock.close()
                continue
            threading.Thread(
                target=self._serve, args=(sock, str(address[0])), name="linkrover-stress", daemon=True
            ).start()

    def _serve(self, sock: socket.socket, source: str) -> None:
        kept = False
        with self._lock:
            self._open.add(sock)
        try:
            kept = self._converse(Line(sock, HANDSHAKE_S), source)
        except ParseError:
            self.counters.malformed += 1
        except (OSError, EOFError) as error:
            self._tell(f"stress: {_plain(source)} went away ({error})")
        finally:
            with self._lock:
                self._open.discard(sock)
            if not kept:
                sock.close()
            self._slots.release()

    def _converse(self, line: Line, source: str) -> bool:
        """One connection; True if its socket now belongs to a load thread."""
        nonce = secrets.token_hex(16)
        line.send(
            Hello(
                protocol=PROTOCOL,
                version=__version__,
                nonce=nonce,
                seconds_most=self._seconds_most,
                rate_bps_most=self._rate_bps_most,
                reflector_port=self._reflector_port,
            )
        )
        first = line.receive()
        if isinstance(first, Attach):
            return self._attach(line, first, source)
        if not isinstance(first, Ask):
            self.counters.malformed += 1
            return False
        refusal = self._refusal(first, nonce)
        if refusal is not None:
            self.counters.refused += 1
            self._tell(f"stress: refused {_plain(source)}: {refusal}")
            line.send(Refusal(reason=refusal))
            return False
        try:
            session = _Session(line.sock, source)
        except OSError as error:
            line.send(Refusal(reason=f"no UDP socket: {error.strerror}"))
            return False
        with self._lock:
            taken = self._session is not None
            if not taken:
                self._session = session
        if taken:
            session.end()
            line.send(Refusal(reason="another stress run is under way here; try again when it is over"))
            return False
        try:
            mac = proof(self._token, "server", nonce, first.nonce)
            line.send(Consent(mac=mac, session=session.secret.hex(), udp_port=session.udp.getsockname()[1]))
            self._tell(f"stress: {_plain(source)} may load this link")
            line.timeout_s = IDLE_S
            self._phases(line, session)
        finally:
            with self._lock:
                self._session = None
            session.end()
            self._tell(f"stress: {_plain(source)} is through")
        return False

    def _refusal(self, ask: Ask, nonce: str) -> str | None:
        if ask.protocol != PROTOCOL:
            return (
                f"stress protocol {ask.protocol} is not {PROTOCOL}: install the same version of linkrover at both ends"
            )
        if not proves(ask.mac, self._token, "client", ask.nonce, nonce):
            self.counters.wrong_token += 1
            time.sleep(WRONG_TOKEN_S)
            return "wrong consent token"
        return None

    def _phases(self, line: Line, session: _Session) -> None:
        while True:
            try:
                request = line.receive()
            except EOFError:
                return
            if not isinstance(request, Load):
                self.counters.malformed += 1
                return
            try:
                kind = load.profile(request.profile, request.rate_bps)
            except ConfigError as error:
                line.send(Refusal(reason=str(error)))
                return
            reason = self._too_much(request, kind)
            if reason is not None:
                line.send(Refusal(reason=reason))
                return
            self.counters.phases += 1
            session.begin(request, kind)
            line.send(Ready(streams=kind.streams, phase=session.phase))
            if not isinstance(line.receive(), Finish):
                self.counters.malformed += 1
                return
            line.send(session.finish())

    def _too_much(self, request: Load, kind: load.Profile) -> str | None:
        if not 0 < request.seconds <= self._seconds_most:
            return f"a phase of {request.seconds:g} s: at most {self._seconds_most:g} s are allowed here"
        if (kind.rate_bps or 0) > self._rate_bps_most:
            return f"{(kind.rate_bps or 0) / 1e6:g} Mbit/s: at most {self._rate_bps_most / 1e6:g} are allowed here"
        return None

    def _attach(self, line: Line, attach: Attach, source: str) -> bool:
        with self._lock:
            session = self._session
            if session is None or session.source != source or not session.is_for(attach.session):
                self.counters.refused += 1
                return False
            self._open.discard(line.sock)
            return session.attach(line, attach)


class _Session:
    """One client's stay: its secret, its UDP socket, the load threads of the present phase."""

    def __init__(self, control: socket.socket, source: str) -> None:
        self.secret = secrets.token_bytes(SESSION_BYTES)
        self.source = source
        self.udp = socket.socket(control.family, socket.SOCK_DGRAM)
        try:
            host, _, *zone = control.getsockname()
            self.udp.bind((host, 0, *zone))
        except OSError:
            self.udp.close()
            raise
        self.phase = 0
        self._request: Load | None = None
        self._kind = load.PROFILES["bulk"]
        self._receivers: list[load.Worker] = []
        self._senders: list[load.Worker] = []
        self._awaited = {"up": 0, "down": 0}
        self._lock = threading.Lock()

    def _mark(self) -> bytes:
        return load.phase_mark(self.secret, self.phase)

    def is_for(self, secret: str) -> bool:
        """Whether a data connection shows this session's secret."""
        return secrets.compare_digest(secret.encode("utf-8", "replace"), self.secret.hex().encode())

    def begin(self, request: Load, kind: load.Profile) -> None:
        """Be ready for the data of a phase."""
        with self._lock:
            self.phase += 1
            self._request, self._kind = request, kind
            self._receivers, self._senders = [], []
            streams = kind.streams if kind.transport == "tcp" else 0
            self._awaited = {"up": streams * request.up, "down": streams * request.down}
            if kind.transport == "udp":
                self._begin_udp(request)

    def _begin_udp(self, request: Load) -> None:
        if request.down:
            self._senders.append(load.Worker(self._send_down))
        elif request.up:
            self._receivers.append(load.udp_receiver(self.udp, self.source, self._mark(), request.seconds))

    def _send_down(self, tally: load.Tally, stop: threading.Event) -> None:
        """Wait for the client's first datagram, so that nothing is sent to where nobody asked; then send and count."""
        request = self._request
        assert request is not None
        self.udp.settimeout(0.2)
        ends = time.monotonic() + load.FIRST_BYTE_S
        while time.monotonic() < ends and not stop.is_set():
            try:
                data, address = self.udp.recvfrom(2_048)
            except TimeoutError:
                continue
            if address[0] == self.source and data.startswith(self._mark()):
                break
        else:
            return
        if request.up:
            with self._lock:
                receiver = load.udp_receiver(self.udp, self.source, self._mark(), request.seconds)
                self._receivers.append(receiver)
        sender = load.udp_sender(self.udp, address, self._mark(), self._kind, request.seconds)
        while not sender.join(0.1):
            if stop.is_set():
                sender.stop()
        tally.bytes, tally.datagrams = sender.tally.bytes, sender.tally.datagrams
        tally.seconds = request.seconds

    def attach(self, line: Line, attach: Attach) -> bool:
        """Give a data connection to a load thread; False if none is awaited."""
        with self._lock:
            request = self._request
            way = "up" if attach.up else "down"
            if request is None or self._awaited[way] < 1:
                return False
            self._awaited[way] -= 1
            if attach.up:
                already = len(line.take_rest())
                self._receivers.append(load.tcp_receiver(line.sock, request.seconds, already))
            else:
                self._senders.append(load.tcp_sender(line.sock, self._kind, request.seconds))
        return True

    def finish(self) -> Outcome:
        """End the phase and say what was counted."""
        with self._lock:
            receivers, senders = self._receivers, self._senders
            request, self._request = self._request, None
        assert request is not None
        ends = time.monotonic() + request.seconds + load.UDP_GRACE_S + 1
        for worker in (*senders, *receivers):
            if not worker.join(max(0.0, ends - time.monotonic())):
                worker.stop()
                worker.join(2)
        return Outcome(
            received_bytes=sum(w.tally.bytes for w in receivers),
            received_bps=sum(w.tally.bps for w in receivers),
            received_datagrams=sum(w.tally.datagrams for w in receivers),
            sent_bytes=sum(w.tally.bytes for w in senders),
            sent_datagrams=sum(w.tally.datagrams for w in senders),
            frames_sent=sum(w.tally.frames for w in senders),
            frames_dropped=sum(w.tally.dropped for w in senders),
        )

    def end(self) -> None:
        """Stop whatever is still under way."""
        with self._lock:
            self._request = None
            workers = [*self._receivers, *self._senders]
        for worker in workers:
            worker.stop()
        for worker in workers:
            worker.join(2)
        self.udp.close()


def _dual_stack(port: int) -> socket.socket:
    if socket.has_dualstack_ipv6():
        with contextlib.suppress(OSError):
            return socket.create_server(("", port), family=socket.AF_INET6, backlog=16, dualstack_ipv6=True)
    return socket.create_server(("", port), backlog=16)


def _plain(source: str) -> str:
    return source.removeprefix("::ffff:")

"""The agent: everything one end measures, on one absolute schedule, in one process."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Protocol

from linkrover.errors import ConfigError, LinkRoverError
from linkrover.loop import Job, Loop, Slot
from linkrover.probe.address import load_key
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.probe.reflector import StampReflector
from linkrover.records import EventKind, LinkEvent, Manifest, Record, now
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch, interface_names, no_such_interface
from linkrover.sources.network_errors import NetworkErrorsSource
from linkrover.sources.radio import RadioSource
from linkrover.sources.utilization import UtilizationSource
from linkrover.sources.wireless import WirelessSource, open_wireless_source

from .account import Account
from .config import AgentConfig, check
from .feed import FeedReceiver
from .machine import collect_manifest
from .probing import Probing
from .radio import RadioPart
from .sink import Sink

# Jobs due together share one waking of the process, which costs more than most of them. This little between them
# keeps their order: the probes, which were started first, are never late because of the others.
_STAGGER_NS = 2_000
_COMPLAINT_PERIOD_NS = 60_000_000_000

Sample = Callable[[], Iterable[Record]]


class Part(Protocol):
    """Something further that measures: given the agent, it adds jobs (agent.every) and publishes records."""

    def start(self, agent: Agent) -> None:
        """Begin; agent.loop, agent.every and agent.publish are there."""
        ...

    def stop(self) -> None:
        """Give back what was opened."""
        ...


class Agent:
    """Measures one end of a link.

    agent = Agent(config, sinks=[...], parts=[...]); agent.add_sink(Recorder(directory, agent.manifest)); agent.run().
    request_stop() ends run() from a signal handler or another thread; stop() ends it from a job.

    Args:
        config: what to measure.
        loop: runs it; one of its own by default, closed at the end.
        sinks: take every record.
        parts: measure further things.
        middleware: the manifest's word on the middleware in use.

    Raises:
        ConfigError: nothing to do, an interface that is not there (unless config.wait), a value out of range.
    """

    def __init__(
        self,
        config: AgentConfig,
        loop: Loop | None = None,
        *,
        sinks: Iterable[Sink] = (),
        parts: Iterable[Part] = (),
        middleware: str | None = None,
    ) -> None:
        self.config = check(config)
        self.log = logging.getLogger("linkrover.agent")
        parts = list(parts)
        if not (config.interfaces or config.peers or config.reflect or config.feed or parts):
            raise ConfigError(
                f"nothing to measure: name an interface (here: {', '.join(interface_names())}), a peer, or --reflect"
            )
        self._sockets = InterfaceSocket()
        self.watches = tuple(
            InterfaceWatch(name, sockets=self._sockets, on_change=self._interface_changed) for name in config.interfaces
        )
        for watch in self.watches:
            if watch.presence.index is None and not config.wait:
                raise no_such_interface(watch.iface, interface_names())
        self.manifest: Manifest = collect_manifest(config, middleware=middleware)
        self._owns_loop = loop is None
        self.loop = loop or Loop()
        self.sinks: list[Sink] = list(sinks)
        self.parts: list[Part] = parts
        self.probings: tuple[Probing, ...] = ()
        self.reflector: StampReflector | None = None
        self.feed: FeedReceiver | None = None
        self._account = Account(self.sinks)
        self._jobs: list[Job] = []
        self._closers: list[Callable[[], None]] = []
        self._complained_ns: dict[str, int] = {}
        self._start_ns = 0
        self._stopping = False
        self._opened = False
        self._started = False
        self._closed = False

    def add_sink(self, sink: Sink) -> None:
        """Also give every record from now on to this sink."""
        self.sinks.append(sink)

    def publish(self, record: Record) -> None:
        """Give a record to every sink. A sink that fails is taken out, loudly; the others go on."""
        for sink in tuple(self.sinks):
            self._give(sink, record)

    def publish_from(self, source: Sink, record: Record) -> None:
        """Give a record to every sink but the one it came from."""
        for sink in tuple(self.sinks):
            if sink is not source:
                self._give(sink, record)

    def every(self, rate_hz: float, sample: Sample, *, name: str = "") -> Job | None:
        """Publish what `sample` gives, rate_hz times a second; a rate of 0 is off. Its lateness is accounted for."""
        if rate_hz <= 0:
            return None
        title = name or getattr(sample, "__qualname__", "job")

        def turn(slot: Slot) -> None:
            self._account.note(slot)
            try:
                for record in sample():
                    self.publish(record)
            except Exception:  # noqa: BLE001  # one source's fault must not end the measuring of the others
                self.complain(title, "failed", trace=True)

        start_ns = self._start_ns + _STAGGER_NS * (len(self._jobs) + 1)
        job = self.loop.every(round(1e9 / rate_hz), turn, start_ns=start_ns)
        self._jobs.append(job)
        return job

    def complain(self, title: str, text: str, *, trace: bool = False) -> None:
        """Log a warning about `title`, at most once a minute."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._complained_ns.get(title, 0):
            self._complained_ns[title] = now_ns + _COMPLAINT_PERIOD_NS
            self.log.warning("%s: %s", title, text, exc_info=trace)

    def open(self) -> None:
        """Take what this machine may refuse: ports, the feed's path, keys. Nothing is measured or recorded yet.

        Raises:
            ConfigError: a port, key or path that cannot be had. What was opened is closed again.
        """
        self._opened = True
        try:
            self._open_network()
        except BaseException:
            self.close()
            raise

    def start(self) -> None:
        """Put the jobs on the schedule; the loop need not run yet.

        Raises:
            ConfigError: as open().
        """
        if not self._opened:
            self.open()
        self._started = True
        self._start_ns = time.monotonic_ns()
        try:
            for probing in self.probings:
                probing.start(self._start_ns)
            self._start_sources()
            for part in self.parts:
                self._closers.append(part.stop)
                part.start(self)
        except BaseException:
            self.close()
            raise
        self.every(self.config.rates.account_hz, lambda: (self._account.settle(),), name="account")

    def run(self) -> None:
        """Start, run for config.duration_s or until stopped, and close everything."""
        if not self._started:
            self.start()
        if self.config.duration_s is not None:
            self.loop.at(self._start_ns + round(self.config.duration_s * 1e9), self.stop)
        try:
            self.loop.run()
        finally:
            self.close()

    def request_stop(self) -> None:
        """Stop soon; safe in a signal handler and from another thread."""
        self.loop.call_soon(self.stop)

    def stop(self) -> None:
        """Stop sampling and, once the probes in flight are settled (within their deadline), the loop.

        A second call does not wait for them.
        """
        if self._stopping:
            self.loop.stop()
            return
        self._stopping = True
        for job in self._jobs:
            job.cancel()
        for probing in self.probings:
            probing.stop_sending()
        longest_ns = max((probing.deadline_ns for probing in self.probings), default=0)
        self._await_flights(time.monotonic_ns() + longest_ns + 50_000_000)

    def _await_flights(self, until_ns: int) -> None:
        now_ns = time.monotonic_ns()
        if now_ns >= until_ns or not any(probing.in_flight for probing in self.probings):
            if self.config.rates.account_hz > 0:
                self.publish(self._account.settle())
            self.loop.stop()
            return
        self.loop.at(now_ns + 20_000_000, lambda: self._await_flights(until_ns))

    def _open_network(self) -> None:
        config = self.config
        if config.reflect:
            port = DEFAULT_PORT if config.reflector.port is None else config.reflector.port
            key_file = config.probe.key_file
            self.reflector = StampReflector(
                self.loop, config.reflector.host, port, key=None if key_file is None else load_key(key_file)
            )
            self.reflector.start()
            self._closers.append(self.reflector.stop)
        if config.stress.token_file is not None:
            self._consent_to_stress(config.stress.token_file)
        if config.feed is not None:
            self.feed = FeedReceiver(self.loop, config.feed, self.publish)
            self._closers.append(self.feed.close)
        if config.probe.rate_hz > 0:
            self.probings = tuple(Probing(self, peer) for peer in config.peers)
            self._closers += [probing.stop for probing in self.probings]

    def _start_sources(self) -> None:
        rates = self.config.rates
        if not self.watches:
            return
        radios: dict[str, RadioSource] = {}
        for watch in self.watches:
            wireless = open_wireless_source(watch, path=self.config.wireless_path, sockets=self._sockets)
            if isinstance(wireless, RadioSource):
                radios[watch.iface] = wireless
            self._closers.append(wireless.close)
            self.every(rates.wireless_hz, self._checked(wireless, f"wireless link of {watch.iface}"))
        radio = RadioPart(changed=lambda iface: radios[iface].refresh() if iface in radios else None)
        radio.start(self)
        self._closers.append(radio.stop)
        utilization = UtilizationSource(self.watches)
        errors = NetworkErrorsSource(self.watches, sockets=self._sockets)
        self._closers += [utilization.close, errors.close]
        self.every(rates.utilization_hz, self._checked(utilization, "link utilisation"))
        self.every(rates.errors_hz, self._checked(errors, "network errors"))

    def _checked(self, source: WirelessSource | UtilizationSource | NetworkErrorsSource, title: str) -> Sample:
        def sample() -> Iterable[Record]:
            records = source.sample()
            if source.last_error is not None:
                self.complain(title, str(source.last_error))
            return records

        return sample

    def _consent_to_stress(self, token_file: str) -> None:
        from linkrover.stress.protocol import DEFAULT_PORT as STRESS_PORT
        from linkrover.stress.protocol import load_token
        from linkrover.stress.server import StressServer

        given = self.config.stress.port
        server = StressServer(
            load_token(token_file),
            self.config.reflector.host,
            STRESS_PORT if given is None else given,
            reflector_port=self.reflector.port if self.reflector is not None else None,
            on_event=self.log.info,
        )
        server.start()
        self._closers.append(server.stop)

    def _interface_changed(self, iface: str, kind: EventKind, detail: str) -> None:
        stamp = now()
        self.publish(LinkEvent(wall_ns=stamp.wall_ns, mono_ns=stamp.mono_ns, iface=iface, kind=kind, detail=detail))

    def close(self) -> None:
        """Give back everything and close the sinks; run() does it at its end."""
        if self._closed:
            return
        self._closed = True
        for job in self._jobs:
            job.cancel()
        for closer in reversed(self._closers):
            self._call_closer(closer)
        self._closers.clear()
        for sink in tuple(self.sinks):
            self._close_sink(sink)
        self.sinks.clear()
        self._sockets.close()
        if self._owns_loop:
            self.loop.close()

    def _call_closer(self, closer: Callable[[], None]) -> None:
        try:
            closer()
        except (OSError, LinkRoverError) as error:
            self.log.warning("while closing: %s", error)

    def _give(self, sink: Sink, record: Record) -> None:
        try:
            sink.take(record)
        except Exception:  # one consumer's fault must not end the measuring
            self.log.exception("%s failed and gets no more records", type(sink).__name__)
            self.sinks.remove(sink)
            self._close_sink(sink)

    def _close_sink(self, sink: Sink) -> None:
        try:
            sink.close()
        except Exception:  # the other sinks must still be closed
            self.log.exception("%s could not be closed cleanly", type(sink).__name__)

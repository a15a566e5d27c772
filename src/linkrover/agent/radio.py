"""What the agent does about the radio beside sampling: events as they happen, TCP connections, scans if asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import EventKind, LinkEvent, Record, now
from linkrover.sources.genetlink import FamilyAbsentError
from linkrover.sources.netlink import NetlinkError
from linkrover.sources.nl80211 import Nl80211
from linkrover.sources.nl80211_events import RadioEvents
from linkrover.sources.nl80211_scan import Scanner
from linkrover.sources.sockdiag import TcpConnections

if TYPE_CHECKING:
    from .agent import Agent

_OPEN_AGAIN_HZ = 0.2  # a wireless driver may be loaded while the agent runs


class RadioPart:
    """Events and scans of the wireless interfaces, TCP connections of all interfaces, for one agent.

    changed(iface) is called with every event, so that what seldom changes is asked for again.
    """

    def __init__(self, changed: Callable[[str], None] | None = None) -> None:
        self._changed = changed
        self._listening: dict[str, RadioEvents] = {}
        self._closers: list[Callable[[], None]] = []

    def start(self, agent: Agent) -> None:
        """Begin listening and put the jobs on the agent's schedule."""
        names = [watch.iface for watch in agent.watches]
        if agent.config.wireless_path is None and names:
            agent.every(_OPEN_AGAIN_HZ, lambda: self._listen(agent, names), name="radio events")
            if agent.config.scan_period_s > 0:
                for name in names:
                    _Scans(agent, name, self._closers)
        if agent.config.rates.tcp_hz > 0:
            for name in names:
                self._connections(agent, name)

    def stop(self) -> None:
        """Give back what was opened."""
        for closer in reversed(self._closers):
            closer()
        self._closers.clear()
        self._listening.clear()

    def _listen(self, agent: Agent, names: list[str]) -> Iterable[Record]:
        for name in names:
            if name in self._listening:
                continue
            try:
                events = RadioEvents(name)
            except FamilyAbsentError:
                return ()
            except LinkRoverError as error:
                agent.complain(f"radio events of {name}", str(error))
                continue
            self._listening[name] = events
            remove = agent.loop.reader(events, lambda name=name, events=events: self._heard(agent, name, events))  # type: ignore[misc]
            self._closers += [events.close, remove]
        return ()

    def _heard(self, agent: Agent, name: str, events: RadioEvents) -> None:
        try:
            found = events.events()
        except LinkRoverError as error:
            agent.complain(f"radio events of {name}", str(error))
            return
        for event in found:
            agent.publish(event)
        if found and self._changed is not None:
            self._changed(name)

    def _connections(self, agent: Agent, name: str) -> None:
        try:
            connections = TcpConnections(name)
        except NetlinkError as error:
            agent.complain(f"TCP connections over {name}", str(error))
            return
        self._closers.append(connections.close)

        def sample() -> Iterable[Record]:
            try:
                return connections.read()
            except (NetlinkError, ParseError) as error:
                agent.complain(f"TCP connections over {name}", str(error))
                return ()

        agent.every(agent.config.rates.tcp_hz, sample, name=f"TCP connections over {name}")


class _Scans:
    """Scans of one interface at a fixed period; each is an event of its own, because it disturbs the link."""

    def __init__(self, agent: Agent, iface: str, closers: list[Callable[[], None]]) -> None:
        self._agent = agent
        self._iface = iface
        self._title = f"scan with {iface}"
        try:
            self._reader = Nl80211()
            self._scanner = Scanner()
        except LinkRoverError as error:
            agent.complain(self._title, str(error))
            return
        remove = agent.loop.reader(self._scanner, self._ended)
        closers += [self._reader.close, self._scanner.close, remove]
        agent.every(1 / agent.config.scan_period_s, self._begin, name=self._title)

    def _begin(self) -> Iterable[Record]:
        if self._scanner.busy:
            return ()
        try:
            index = self._reader.interface(self._iface).ifindex
            if index is not None:
                self._scanner.start(index, self._agent.config.scan_mhz)
        except LinkRoverError as error:
            self._agent.complain(self._title, str(error))
            return (self._event(f"not started: {error}"),)
        return (self._event("begun by this agent: the radio leaves its channel until it is done"),)

    def _ended(self) -> None:
        try:
            found = self._scanner.ready(self._iface, self._reader.interface(self._iface))
        except LinkRoverError as error:
            self._agent.complain(self._title, str(error))
            return
        if found is not None:
            self._agent.publish(found)

    def _event(self, detail: str) -> LinkEvent:
        at = now()
        return LinkEvent(wall_ns=at.wall_ns, mono_ns=at.mono_ns, iface=self._iface, kind=EventKind.SCAN, detail=detail)

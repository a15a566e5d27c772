"""Probes to one peer, and what follows from their results: delay records, outages, the clock offset."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from linkrover.probe.address import load_key, split_host_port
from linkrover.probe.clock import ClockTracker
from linkrover.probe.sender import StampSender
from linkrover.records import ClockOffset, EventKind, LinkEvent, NetworkDelay, ProbeResult, ProbeState, Unknown, now

from .machine import route_interface
from .outage import OutageWatch

if TYPE_CHECKING:
    from .agent import Agent

_REROUTE_NS = 10_000_000_000
_LOOK_HZ = 2.0  # an outage is dated from the last answer, however late it is noticed


class Probing:
    """A STAMP sender to one peer as a part of an agent.

    NetworkDelay (method "stamp") is given once a probe, when its fate is first known: no answer by the deadline is
    delay None. What is learnt later (a late answer, the direction of a loss) is in further ProbeResults alone.
    """

    def __init__(self, agent: Agent, peer: str) -> None:
        config = agent.config.probe
        self._agent = agent
        self.host, self.port = split_host_port(peer)
        self.deadline_ns = round(config.deadline_s * 1e9)
        self.sender = StampSender(
            agent.loop,
            self.host,
            self.port,
            on_result=self._take,
            period_ns=round(1e9 / config.rate_hz),
            deadline_ns=self.deadline_ns,
            key=None if config.key_file is None else load_key(config.key_file),
            size=config.packet_bytes if config.packet_bytes > 44 else 0,
        )
        self.peer = self.sender.peer
        self.iface = agent.config.interfaces[0] if agent.config.interfaces else ""
        self._route_due_ns = 0
        self._reported: set[int] = set()
        self._reported_order: deque[int] = deque()
        self._remember = round((config.deadline_s + 15) * config.rate_hz) + 64
        self._lookup_told = False
        self._steps_told = 0
        self._offset_told_ns = 0
        self.clock = ClockTracker(self.peer)
        self._outage = OutageWatch(self.iface, self.peer, round(agent.config.outage.threshold_s * 1e9), now())

    @property
    def in_flight(self) -> int:
        """Probes whose fate is not known yet."""
        return self.sender.in_flight

    def start(self, start_ns: int) -> None:
        """Begin to send."""
        self._reroute(start_ns)
        self.sender.start(start_ns=start_ns)
        self._agent.every(_LOOK_HZ, self._look)
        self._agent.every(self._agent.config.rates.clock_hz, self._offset)

    def stop_sending(self) -> None:
        """No further probes; answers to those in flight are still taken."""
        self.sender.stop_sending()

    def stop(self) -> None:
        """Close the socket."""
        self.sender.stop()

    def _take(self, result: ProbeResult) -> None:
        publish = self._agent.publish
        if self._route_due_ns == 0:
            self._reroute(result.mono_ns)
        publish(result)
        self.clock.add(result)
        if self._first_word(result.sequence):
            answered = result.state is ProbeState.ANSWERED
            reason = Unknown.NOT_CONNECTED if result.state is ProbeState.NOT_SENT else Unknown.TIMED_OUT
            publish(
                NetworkDelay(
                    wall_ns=result.wall_ns,
                    mono_ns=result.mono_ns,
                    unknown={} if answered else {"delay_ns": reason},
                    iface=self.iface,
                    peer=self.peer,
                    method="stamp",
                    sequence=result.sequence,
                    delay_ns=result.rtt_ns if answered else None,
                    alive=answered,
                    late=result.state is ProbeState.LATE,
                    deadline_ns=self.deadline_ns,
                    lateness_ns=result.lateness_ns,
                )
            )
        for event in self._outage.take(result):
            publish(event)

    def _first_word(self, sequence: int) -> bool:
        if sequence in self._reported:
            return False
        self._reported.add(sequence)
        self._reported_order.append(sequence)
        if len(self._reported_order) > self._remember:
            self._reported.discard(self._reported_order.popleft())
        return True

    def _look(self) -> tuple[()]:
        mono_ns = time.monotonic_ns()
        for event in self._outage.look(mono_ns):
            self._agent.publish(event)
        if mono_ns >= self._route_due_ns:
            self._reroute(mono_ns)
        error = self.sender.lookup_error
        if error is not None and not self._lookup_told:
            self._lookup_told = True
            self._agent.log.warning("%s; asking again until it is known", error)
        return ()

    def _offset(self) -> tuple[ClockOffset, ...]:
        """The clock offset, where there is a new one, and a step of either clock as an event."""
        offset = self.clock.offset()
        if self.clock.steps != self._steps_told:
            self._steps_told = self.clock.steps
            stamp = now()
            self._agent.publish(
                LinkEvent(
                    wall_ns=stamp.wall_ns,
                    mono_ns=stamp.mono_ns,
                    iface=self.iface,
                    kind=EventKind.CLOCK_STEP,
                    peer=self.peer,
                    detail=f"the clock here or at {self.peer} was stepped; offset tracking begins anew",
                )
            )
        if offset is None or offset.mono_ns == self._offset_told_ns:
            return ()
        self._offset_told_ns = offset.mono_ns
        return (offset,)

    def _reroute(self, mono_ns: int) -> None:
        """Which interface the records of this peer belong to."""
        endpoint = self.sender.endpoint
        if endpoint is None:
            return  # its name is not resolved yet: look again at the next turn
        self._route_due_ns = mono_ns + _REROUTE_NS
        names = self._agent.config.interfaces
        self.iface = self._outage.iface = route_interface(endpoint.family, endpoint.address, names) or self.iface

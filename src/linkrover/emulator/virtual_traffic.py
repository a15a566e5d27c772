"""Modelled programs of a virtual-time run: streams that drop the oldest message, a ROS-like action, STAMP probes."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any, Protocol

from linkrover.records import NetworkDelay, Now, ProbeResult, ProbeState, ProbeTruth, Record, Role

from .tcp_model import Network as TcpNetwork
from .tcp_model import TcpConnectionModel

UDP_HEADER_OCTETS = 28
SESSION = 1
GOAL_OCTETS = 180  # actionlib goal and result messages of the 2021 Ping action with their headers
RESULT_OCTETS = 220
MIDDLEWARE_S = (0.0016, 0.0006)  # both clients in Python over loopback take 3.0 ms for the round trip: half each way


class World(TcpNetwork, Protocol):
    """What the programs need of the simulation."""

    now_ns: int

    def every(self, period_ns: int, work: Callable[[int], None], offset_ns: int = 0) -> None:
        """Call back periodically."""
        ...

    def stamp(self, at_ns: int) -> Now:
        """Both clocks at a simulated time."""
        ...

    def record(self, end: str, record: Record) -> None:
        """Hand over a record to the recording of "robot", "station" or "truth"."""
        ...


class StreamSource:
    """A periodic message over its own connection; one waits, and is dropped when the next is made."""

    def __init__(
        self,
        world: World,
        source: str,
        destination: str,
        flow: int,
        octets: int,
        rate_hz: float,
        on_message: Callable[[object, int], None] | None = None,
        make: Callable[[int], object] | None = None,
        offset_ns: int = 0,
    ) -> None:
        self.world = world
        self.octets = octets
        self.made = self.sent = self.dropped_oldest = self.received = 0
        self._waiting: tuple[object, bool] = (None, False)
        self._make = make
        self._deliver = on_message
        self.connection = TcpConnectionModel(world, source, destination, flow, self._arrived, self._refill)
        world.every(round(1e9 / rate_hz), self._turn, offset_ns)

    def _turn(self, now_ns: int) -> None:
        self.made += 1
        if self._waiting[1]:
            self.dropped_oldest += 1
        self._waiting = (self._make(now_ns) if self._make is not None else None, True)
        if self.connection.unsent_octets <= 65_536:
            self._refill()

    def _refill(self) -> None:
        message, waits = self._waiting
        if waits:
            self._waiting = (None, False)
            self.sent += 1
            self.connection.write(self.octets, message, self.world.now_ns)

    def _arrived(self, message: object, now_ns: int) -> None:
        self.received += 1
        if self._deliver is not None:
            self._deliver(message, now_ns)


class ActionClient:
    """A goal each period from robot to station and its result back, each over a connection of its own (TCPROS)."""

    def __init__(
        self, world: World, iface: str, peer: str, flows: tuple[int, int], rate_hz: float, rng: random.Random
    ) -> None:
        self.world = world
        self.iface = iface
        self.peer = peer
        self.deadline_ns = 2_000_000_000
        self._rng = rng
        self._sequence = 0
        self._open: dict[int, int] = {}
        self.connections = (
            TcpConnectionModel(world, "robot", "station", flows[0], self._goal_arrived),
            TcpConnectionModel(world, "station", "robot", flows[1], self._result_arrived),
        )
        world.every(round(1e9 / rate_hz), self._turn, 250_000_000)

    def _turn(self, now_ns: int) -> None:
        sequence = self._sequence
        self._sequence += 1
        self._open[sequence] = now_ns
        self.world.at(now_ns + self._half(), lambda at: self.connections[0].write(GOAL_OCTETS, sequence, at))
        self.world.at(now_ns + self.deadline_ns, lambda at: self._close(sequence, None))  # noqa: ARG005

    def _half(self) -> int:
        return max(200_000, round(self._rng.gauss(*MIDDLEWARE_S) * 1e9))

    def _goal_arrived(self, sequence: object, now_ns: int) -> None:
        self.world.at(now_ns + self._half(), lambda at: self.connections[1].write(RESULT_OCTETS, sequence, at))

    def _result_arrived(self, sequence: object, now_ns: int) -> None:
        assert isinstance(sequence, int)
        self._close(sequence, now_ns)

    def _close(self, sequence: int, now_ns: int | None) -> None:
        sent_ns = self._open.pop(sequence, None)
        if sent_ns is None:
            return
        sent = self.world.stamp(sent_ns)
        self.world.record(
            "robot",
            NetworkDelay(
                wall_ns=sent.wall_ns,
                mono_ns=sent.mono_ns,
                iface=self.iface,
                peer=self.peer,
                method="ros1 action",
                sequence=sequence,
                delay_ns=None if now_ns is None else now_ns - sent_ns,
                alive=now_ns is not None,
                deadline_ns=self.deadline_ns,
            ),
        )


class Probe:
    """A STAMP packet on its way; `forward_ns`: its true delay there, once known."""

    __slots__ = ("back", "forward_ns", "reflected_ns", "sent_ns", "sequence")

    def __init__(self, sequence: int, sent_ns: int) -> None:
        self.sequence = sequence
        self.sent_ns = sent_ns
        self.back = False
        self.forward_ns = 0
        self.reflected_ns = 0


class Prober:
    """STAMP probes of the robot on their schedule; the true fate of each packet goes to the truth."""

    def __init__(self, world: World, peer: str, flow: int, rate_hz: float, octets: int, rng: random.Random) -> None:
        self.world = world
        self.peer = peer
        self.flow = flow
        self.octets = octets + UDP_HEADER_OCTETS
        self.deadline_ns = 2_000_000_000
        self.results: list[ProbeResult] = []
        self._rng = rng
        self._sequence = 0
        self.reflected = self.answered = 0
        self._open: dict[int, Probe] = {}
        self._lost_forward: set[int] = set()
        self.on_result: Callable[[ProbeResult], None] | None = None
        world.every(round(1e9 / rate_hz), self._turn, 50_000_000)

    @property
    def sent(self) -> int:
        """Probes sent so far."""
        return self._sequence

    def _turn(self, now_ns: int) -> None:
        probe = Probe(self._sequence, now_ns)
        self._sequence += 1
        self._open[probe.sequence] = probe
        self.world.offer("robot", "station", self.octets, probe, self.flow)
        self.world.at(now_ns + self.deadline_ns, lambda at: self._give_up(probe, at))

    def _truth(self, probe: Probe, sent_ns: int, delay_ns: int | None, dropped: str | None) -> None:
        at = self.world.stamp(sent_ns)
        self.world.record(
            "truth",
            ProbeTruth(
                wall_ns=at.wall_ns,
                mono_ns=at.mono_ns,
                session=SESSION,
                sequence=probe.sequence,
                direction="back" if probe.back else "forward",
                end=Role.ROBOT,
                delay_ns=delay_ns,
                dropped=dropped,
            ),
        )

    def dropped(self, probe: Probe, cause: str) -> None:
        """The link dropped it."""
        self._truth(probe, probe.reflected_ns if probe.back else probe.sent_ns, None, cause)
        if not probe.back:
            self._lost_forward.add(probe.sequence)

    def arrived(self, probe: Probe, now_ns: int) -> None:
        """It reached the other end: the reflector answers at once, the sender takes the time."""
        if not probe.back:
            self._truth(probe, probe.sent_ns, now_ns - probe.sent_ns, None)
            probe.forward_ns = now_ns
            probe.reflected_ns = now_ns + self._rng.randint(60_000, 140_000)
            probe.back = True
            self.reflected += 1
            self.world.at(probe.reflected_ns, lambda at: self._answer(probe, at))
            return
        self._truth(probe, probe.reflected_ns, now_ns - probe.reflected_ns, None)
        self.answered += 1
        if self._open.pop(probe.sequence, None) is None:
            return
        offset = self.world.stamp(0).wall_ns
        self._result(
            probe,
            ProbeState.ANSWERED,
            rtt_ns=now_ns - probe.sent_ns - (probe.reflected_ns - probe.forward_ns),
            t2_ns=offset + probe.forward_ns,
            t3_ns=offset + probe.reflected_ns,
            t4_ns=offset + now_ns,
        )

    def _answer(self, probe: Probe, now_ns: int) -> None:  # noqa: ARG002 - the reflector's own time is kept
        self.world.offer("station", "robot", self.octets, probe, self.flow)

    def _give_up(self, probe: Probe, now_ns: int) -> None:  # noqa: ARG002 - the result is of the time of sending
        if self._open.pop(probe.sequence, None) is not None:
            forward = probe.sequence in self._lost_forward
            self._result(
                probe, ProbeState.LOST_FORWARD if forward else ProbeState.LOST_BACK if probe.back else ProbeState.LOST
            )

    def _result(self, probe: Probe, state: ProbeState, **times: Any) -> None:
        at = self.world.stamp(probe.sent_ns)
        result = ProbeResult(
            wall_ns=at.wall_ns,
            mono_ns=at.mono_ns,
            peer=self.peer,
            session=SESSION,
            sequence=probe.sequence,
            state=state,
            t1_ns=at.wall_ns,
            packet_bytes=self.octets - UDP_HEADER_OCTETS,
            **times,
        )
        self.world.record("robot", result)
        if self.on_result is not None:
            self.on_result(result)

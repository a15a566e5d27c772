"""What became of every probe: answered, lost and in which direction, late, doubled, out of order.

The direction of a loss follows from the reflector's own sequence. Between two answered probes, each number of the
reflector's that never came belongs to a probe that did arrive there: its answer was lost on the way back. Where no
number is missing, the probes in between never arrived. Our sequence starts at 1, so that the reflector's, which
starts at 0, can never equal it: where it does, the reflector is a stateless one that copies ours (RFC 8762, 4.3),
and the direction stays unknown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import msgspec

from linkrover.records import ClockSource, ProbeResult, ProbeState

AMENDMENTS_MOST = 3
UNDIRECTED_MOST = 20_000
_REFLECTOR_NUMBERS_KEPT = 1 << 16
_RESTART_GAP = 1_000


class Flight:
    """One probe under way."""

    __slots__ = (
        "answer",
        "deadline_ns",
        "duplicates",
        "epoch",
        "lateness_ns",
        "mono_ns",
        "ordinal",
        "reflector_sequence",
        "sent",
        "sequence",
        "stamp_ns",
        "wall_ns",
    )

    def __init__(self, sequence: int, wall_ns: int, mono_ns: int, deadline_ns: int, lateness_ns: int) -> None:
        self.sequence = sequence
        self.wall_ns = wall_ns
        self.mono_ns = mono_ns
        self.deadline_ns = deadline_ns
        self.lateness_ns = lateness_ns
        self.sent = True
        self.ordinal = 0  # how many packets were really sent before this one
        self.stamp_ns: int | None = None  # the kernel's send time
        self.reflector_sequence: int | None = None
        self.epoch = 0  # how many restarts of the reflector were seen before its answer
        self.answer: ProbeResult | None = None
        self.duplicates = 0


class Answer(msgspec.Struct, frozen=True):
    """The times of an answer, CLOCK_REALTIME ns: t1, t4 ours, t2, t3 the reflector's; and where ours came from."""

    reflector_sequence: int
    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int
    arrived_mono_ns: int
    send_clock: ClockSource
    receive_clock: ClockSource


class Ledger:
    """Keeps flights until their fate is known, in memory bounded by rate * (deadline_ns + late_ns).

    report() gets one ProbeResult when a probe is answered or its deadline passes, and another for the same sequence
    if more is learnt afterwards: a late answer, a duplicate, the direction of a loss once the peer is back.
    """

    def __init__(
        self, peer: str, session: int, packet_bytes: int, late_ns: int, report: Callable[[ProbeResult], None]
    ) -> None:
        self._peer = peer
        self._session = session
        self._packet_bytes = packet_bytes
        self._late_ns = late_ns
        self._report = report
        self._flights: dict[int, Flight] = {}
        self._aging: deque[Flight] = deque()
        self._unsettled: deque[Flight] = deque()
        # lost since the anchor, direction not known; the oldest of a very long outage stay without one
        self._undirected: deque[Flight] = deque(maxlen=UNDIRECTED_MOST)
        self._anchor: Flight | None = None  # the last answered probe of the settled ones
        self._next_answered: Flight | None = None
        self._newest_answered = -1
        self._sent = 0
        self._epoch = 0
        self._highest_reflected = -1
        self._reflected: set[int] = set()
        self._reflected_order: deque[int] = deque()
        self.restarts = 0
        self.stateless = False
        self._answers = 0
        self._judged = (-2, -2, 0)  # the last gap in the reflector's numbers, and how many were missing there

    @property
    def in_flight(self) -> int:
        """Probes sent whose answer came neither nor is overdue."""
        return sum(1 for flight in self._unsettled if flight.sent and flight.answer is None)

    def next_deadline_ns(self) -> int | None:
        """When due() has something to say (CLOCK_MONOTONIC)."""
        return self._unsettled[0].deadline_ns if self._unsettled else None

    def find(self, sequence: int) -> Flight | None:
        """The probe with this number, also with only its lower 32 bits given."""
        flight = self._flights.get(sequence)
        if flight is None and self._unsettled and self._unsettled[-1].sequence > 0xFFFF_FFFF:
            newest = self._unsettled[-1].sequence
            flight = self._flights.get(newest - (newest - sequence) % 0x1_0000_0000)
        return flight

    def sent(self, flight: Flight) -> None:
        """A probe went out."""
        self._sent += 1
        flight.ordinal = self._sent
        self._flights[flight.sequence] = flight
        self._aging.append(flight)
        self._unsettled.append(flight)

    def not_sent(self, flight: Flight) -> None:
        """The local stack refused a probe."""
        flight.sent = False
        self._report(self._result(flight, ProbeState.NOT_SENT))

    def answered(self, flight: Flight, answer: Answer) -> None:
        """An answer came; the first counts, further ones are duplicates."""
        if flight.answer is not None:
            flight.duplicates += 1
            self._seen(answer.reflector_sequence)
            if flight.duplicates <= AMENDMENTS_MOST:
                flight.answer = msgspec.structs.replace(flight.answer, duplicates=flight.duplicates)
                self._report(flight.answer)
            return
        self._answers += 1
        number = self._number(flight, answer.reflector_sequence)
        flight.reflector_sequence, flight.epoch = number, self._epoch
        reordered = flight.sequence < self._newest_answered
        self._newest_answered = max(self._newest_answered, flight.sequence)
        late = answer.arrived_mono_ns > flight.deadline_ns
        flight.answer = ProbeResult(
            wall_ns=flight.wall_ns,
            mono_ns=flight.mono_ns,
            peer=self._peer,
            session=self._session,
            sequence=flight.sequence,
            state=ProbeState.LATE if late else ProbeState.ANSWERED,
            reflector_sequence=number,
            rtt_ns=(answer.t4_ns - answer.t1_ns) - (answer.t3_ns - answer.t2_ns),
            t1_ns=answer.t1_ns,
            t2_ns=answer.t2_ns,
            t3_ns=answer.t3_ns,
            t4_ns=answer.t4_ns,
            send_clock=answer.send_clock,
            receive_clock=answer.receive_clock,
            lateness_ns=flight.lateness_ns,
            reordered=reordered,
            packet_bytes=self._packet_bytes,
        )
        self._report(flight.answer)

    def due(self, now_ns: int) -> None:
        """Report what is overdue and forget what is too old even to be late."""
        while self._unsettled:
            flight = self._unsettled[0]
            if flight.answer is None:
                if now_ns < flight.deadline_ns:
                    break
                self._unsettled.popleft()
                state = self._direction(flight)
                self._report(self._result(flight, state))
                if state is ProbeState.LOST:
                    self._undirected.append(flight)
                continue
            self._unsettled.popleft()
            if self._undirected:
                self._amend(flight)
            self._anchor = flight
        expired_ns = now_ns - self._late_ns
        while self._aging and self._aging[0].deadline_ns <= expired_ns:
            del self._flights[self._aging.popleft().sequence]

    def _amend(self, upper: Flight) -> None:
        """An answer came after losses of unknown direction: say now where they were lost."""
        state = self._verdict(upper)
        for flight in self._undirected:
            if state is not ProbeState.LOST and flight.answer is None:
                self._report(self._result(flight, state))
        self._undirected.clear()

    def _direction(self, flight: Flight) -> ProbeState:
        if self._undirected or self._newest_answered < flight.sequence:
            return ProbeState.LOST
        upper = self._next_answered
        if upper is None or upper.sequence < flight.sequence:
            upper = next((f for f in self._unsettled if f.answer is not None), None)
            self._next_answered = upper
        return ProbeState.LOST if upper is None else self._verdict(upper)

    def _verdict(self, upper: Flight) -> ProbeState:
        """Where the probes between the anchor and `upper` were lost, if all in the same direction."""
        lower = self._anchor
        if self.stateless or upper.reflector_sequence is None:
            return ProbeState.LOST
        if lower is None:
            # nothing was answered before: the reflector's numbers of this session began at 0
            below, lost = -1, upper.ordinal - 1
            if upper.epoch:
                return ProbeState.LOST
        elif lower.epoch != upper.epoch or lower.reflector_sequence is None:
            return ProbeState.LOST
        else:
            below, lost = lower.reflector_sequence, upper.ordinal - lower.ordinal - 1
        above = upper.reflector_sequence
        if above <= below or above - below > _REFLECTOR_NUMBERS_KEPT:
            return ProbeState.LOST
        if self._judged[:2] != (below, above):
            missing = sum(1 for number in range(below + 1, above) if number not in self._reflected)
            self._judged = (below, above, missing)
        missing = self._judged[2]
        if missing == 0:
            return ProbeState.LOST_FORWARD
        return ProbeState.LOST_BACK if missing >= lost else ProbeState.LOST

    def _number(self, flight: Flight, wire: int) -> int:
        """The reflector's number beyond 32 bits; notices a reflector that began again and a stateless one."""
        highest = self._highest_reflected
        number = wire if highest < 0 else highest + (wire - highest + 0x8000_0000) % 0x1_0000_0000 - 0x8000_0000
        newest = flight.sequence > self._newest_answered
        if newest and highest >= 0 and (number < highest - _RESTART_GAP or number in self._reflected or number < 0):
            self._epoch += 1
            self.restarts += 1
            self._reflected.clear()
            self._reflected_order.clear()
            self._highest_reflected = -1
            number = wire
        self.stateless = number == flight.sequence and (self.stateless or self._answers == 1)
        self._seen(number)
        return number

    def _seen(self, number: int) -> None:
        self._highest_reflected = max(self._highest_reflected, number)
        if number in self._reflected:
            return
        self._reflected.add(number)
        self._reflected_order.append(number)
        if len(self._reflected_order) > _REFLECTOR_NUMBERS_KEPT:
            self._reflected.discard(self._reflected_order.popleft())

    def _result(self, flight: Flight, state: ProbeState) -> ProbeResult:
        return ProbeResult(
            wall_ns=flight.wall_ns,
            mono_ns=flight.mono_ns,
            peer=self._peer,
            session=self._session,
            sequence=flight.sequence,
            state=state,
            t1_ns=None if not flight.sent else flight.stamp_ns or flight.wall_ns,
            send_clock=ClockSource.USER if flight.stamp_ns is None else ClockSource.KERNEL,
            lateness_ns=flight.lateness_ns,
            packet_bytes=self._packet_bytes,
        )

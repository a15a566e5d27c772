"""A TCP connection in virtual time: CUBIC (RFC 9438), selective acknowledgement, retransmission time-out (RFC 6298).

What is modelled: window growth and reduction, loss found by later segments arriving, time-outs with exponential
back-off (which stretches an outage as applications see it), one acknowledgement for each batch of segments that
arrives together (as GRO makes it). Left out: pacing, tail loss probes, receive-window limits, connection set-up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

MSS = 1448
HEADER_OCTETS = 52  # IPv4 20, TCP 20, timestamps 12
INITIAL_WINDOW = 10
RTO_MIN_NS = 200_000_000
RTO_MAX_NS = 120_000_000_000
NOT_SENT_LOW_WATER = 65_536


class Segment:
    """One transmission of one segment."""

    __slots__ = ("again", "connection", "index", "octets", "sent_ns", "turn")

    def __init__(self, connection: TcpConnectionModel, index: int, octets: int) -> None:
        self.connection = connection
        self.index = index
        self.octets = octets
        self.turn = 0
        self.sent_ns = 0
        self.again = False


class Acknowledgement:
    """`count`: how many segments the receiver had got in all when it sent this."""

    __slots__ = ("connection", "count")

    def __init__(self, connection: TcpConnectionModel, count: int) -> None:
        self.connection = connection
        self.count = count


class Network(Protocol):
    """What a connection needs of the simulation."""

    def offer(self, sender: str, receiver: str, octets: int, tag: object, flow: int) -> bool:
        """Hand a packet to the link; False when it was dropped at once."""
        ...

    def at(self, due_ns: int, work: Callable[[int], None]) -> None:
        """Call back at a time."""
        ...


class TcpConnectionModel:
    """One direction of data, with messages in it. on_message(meta, now_ns): a message has arrived whole, in order.

    refill(): called when little is left to send; may write().
    """

    def __init__(
        self,
        network: Network,
        source: str,
        destination: str,
        flow: int,
        on_message: Callable[[object, int], None],
        refill: Callable[[], None] | None = None,
    ) -> None:
        self.network = network
        self.source = source
        self.destination = destination
        self.flow = flow
        self._on_message = on_message
        self._refill = refill
        self._unsent: deque[int] = deque()  # octets of segments not sent yet
        self.unsent_octets = 0
        self._lost: deque[Segment] = deque()
        self._order: deque[Segment] = deque()  # outstanding, in order of transmission
        self._next_index = 0
        self._turn = 0
        self._messages: deque[tuple[int, object]] = deque()
        self._written = 0
        # receiver
        self._log: deque[Segment] = deque()
        self._logged = 0
        self._expected = 0
        self._early: set[int] = set()
        self.acknowledge_due = False
        # sender's view
        self._seen = 0
        self._late: set[int] = set()
        self.window = float(INITIAL_WINDOW)
        self._threshold = 1e9
        self._max_window = 0.0
        self._epoch_ns = 0
        self._origin = self.window
        self._recovery_turn = -1
        self.srtt_ns: float | None = None
        self._rttvar_ns = 0.0
        self.min_rtt_ns: int | None = None
        self._rto_ns = 1_000_000_000
        self._backoff = 0
        self._deadline_ns: int | None = None
        self._timer_armed = False
        # counters
        self.segments_out = 0
        self.segments_in = 0
        self.acknowledgements_in = 0
        self.retransmits = 0
        self.timeouts = 0
        self.octets_acknowledged = 0

    def write(self, octets: int, meta: object, now_ns: int) -> None:
        """A message goes into the stream."""
        whole, rest = divmod(octets, MSS)
        self._unsent.extend([MSS] * whole)
        if rest:
            self._unsent.append(rest)
        self._written += whole + (1 if rest else 0)
        self.unsent_octets += octets
        self._messages.append((self._written, meta))
        self.send(now_ns)

    def send(self, now_ns: int) -> None:
        """Send what the window allows."""
        order = self._order
        room = int(self.window) - len(order)
        if room <= 0:
            return
        offer = self.network.offer
        source, destination, flow = self.source, self.destination, self.flow
        while room > 0:
            if self._lost:
                old = self._lost.popleft()
                if old.index in self._late:
                    self._late.discard(old.index)
                    continue
                segment = Segment(self, old.index, old.octets)
                segment.again = True
                self.retransmits += 1
            elif self._unsent:
                octets = self._unsent.popleft()
                self.unsent_octets -= octets
                segment = Segment(self, self._next_index, octets)
                self._next_index += 1
            else:
                break
            segment.turn = self._turn
            self._turn += 1
            segment.sent_ns = now_ns
            order.append(segment)
            self.segments_out += 1
            offer(source, destination, segment.octets + HEADER_OCTETS, segment, flow)
            room -= 1
            if self._refill is not None and self.unsent_octets <= NOT_SENT_LOW_WATER and not self._lost:
                refill, self._refill = self._refill, None  # write() comes back here
                refill()
                self._refill = refill
        if order and self._deadline_ns is None:
            self._arm(now_ns)

    # ---- receiving end

    def arrived(self, segment: Segment, now_ns: int) -> None:
        """A segment reached the destination."""
        self.segments_in += 1
        self._log.append(segment)
        self._logged += 1
        self.acknowledge_due = True
        index = segment.index
        if index != self._expected:
            if index > self._expected:
                self._early.add(index)
            return
        expected = index + 1
        early = self._early
        if early:
            while expected in early:
                early.discard(expected)
                expected += 1
        self._expected = expected
        messages = self._messages
        while messages and messages[0][0] <= expected:
            self._on_message(messages.popleft()[1], now_ns)

    def acknowledge(self) -> None:
        """Send one acknowledgement for all that arrived."""
        self.acknowledge_due = False
        self.network.offer(self.destination, self.source, HEADER_OCTETS, Acknowledgement(self, self._logged), self.flow)

    # ---- sending end

    def acknowledged(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
        """An acknowledgement reached the source."""
        self.acknowledgements_in += 1
        fresh = acknowledgement.count - self._seen
        if fresh <= 0:
            return
        self._seen = acknowledgement.count
        order, log = self._order, self._log
        was_limited = len(order) + 1 >= int(self.window)
        done = 0
        newest: Segment | None = None
        lost_turn = -1
        for _ in range(fresh):
            segment = log.popleft()
            turn = segment.turn
            while order and order[0].turn < turn:
                gone = order.popleft()
                self._lost.append(gone)
                lost_turn = gone.turn
            if order and order[0] is segment:
                order.popleft()
                done += 1
                self.octets_acknowledged += segment.octets
                newest = segment
            else:
                self._late.add(segment.index)  # had been given up: it need not be sent again
        if newest is not None and not newest.again:
            self._round_trip(now_ns - newest.sent_ns)
        if lost_turn >= 0 and lost_turn > self._recovery_turn:
            self._reduce(now_ns)
        elif done and was_limited:
            self._grow(done, now_ns)
        self._backoff = 0
        if order or self._lost:
            self._arm(now_ns)
        else:
            self._deadline_ns = None
        self.send(now_ns)

    def _round_trip(self, rtt_ns: int) -> None:
        if self.min_rtt_ns is None or rtt_ns < self.min_rtt_ns:
            self.min_rtt_ns = rtt_ns
        if self.srtt_ns is None:
            self.srtt_ns, self._rttvar_ns = float(rtt_ns), rtt_ns / 2
        else:
            self._rttvar_ns += 0.25 * (abs(rtt_ns - self.srtt_ns) - self._rttvar_ns)
            self.srtt_ns += 0.125 * (rtt_ns - self.srtt_ns)
        self._rto_ns = int(max(self.srtt_ns + max(RTO_MIN_NS, 4 * self._rttvar_ns), RTO_MIN_NS))
        # HyStart: leave slow start when the round trip has grown
        if self.window < self._threshold and rtt_ns > self.min_rtt_ns + max(4_000_000, self.min_rtt_ns // 8):
            self._threshold = self.window
            self._epoch_ns = 0

    def _grow(self, done: int, now_ns: int) -> None:
        if self.window < self._threshold:
            self.window += done
            return
        if not self._epoch_ns:
            self._epoch_ns = now_ns
            self._max_window = max(self._max_window, self.window)
            self._origin = self.window
        seconds = (now_ns - self._epoch_ns) / 1e9
        k = (max(0.0, self._max_window - self._origin) / 0.4) ** (1 / 3)
        target = 0.4 * (seconds - k) ** 3 + self._max_window
        reno = self._origin + 0.53 * seconds / max(1e-3, (self.srtt_ns or 1e8) / 1e9)
        target = min(max(target, reno), 1.5 * self.window)
        if target > self.window:
            self.window += (target - self.window) / self.window * done
        else:
            self.window += 0.01 * done / self.window

    def _reduce(self, now_ns: int) -> None:
        self._recovery_turn = self._turn - 1
        self._max_window = self.window if self.window >= self._max_window else self.window * 0.85
        self.window = max(2.0, 0.7 * self.window)
        self._threshold = self.window
        self._origin = self.window
        self._epoch_ns = now_ns

    def _arm(self, now_ns: int) -> None:
        self._deadline_ns = now_ns + min(RTO_MAX_NS, self._rto_ns << self._backoff)
        if not self._timer_armed:
            self._timer_armed = True
            self.network.at(self._deadline_ns, self._timer)

    def _timer(self, now_ns: int) -> None:
        self._timer_armed = False
        if self._deadline_ns is None:
            return
        if now_ns < self._deadline_ns:
            self._timer_armed = True
            self.network.at(self._deadline_ns, self._timer)
            return
        self.timeouts += 1
        self._backoff = min(self._backoff + 1, 16)
        self._lost = deque(sorted([*self._order, *self._lost], key=lambda segment: segment.index))
        self._order.clear()
        self._recovery_turn = self._turn - 1
        self._threshold = max(2.0, 0.7 * self.window)
        self._max_window = self.window
        self.window = 1.0
        self._epoch_ns = 0
        self._arm(now_ns)
        self.send(now_ns)

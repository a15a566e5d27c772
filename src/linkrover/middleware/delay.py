"""Application-level round trips on an absolute schedule, many in flight, judged by the monotonic clock."""

from __future__ import annotations

import collections
import time
from collections.abc import Callable

import msgspec

from linkrover.loop import Job, Loop, Slot
from linkrover.records import NetworkDelay, Now, ProbeResult, Unknown, now

from .protocol import Answer, Pinger

GRACE_NS = 20_000_000
"""An answer that came before the deadline may still be on its way from the receiving thread; it is judged by its
own time stamp, so the verdict waits this much."""
REMEMBER_NS = 120_000_000_000
"""How long a lost ping is remembered, so that its late answer can be counted."""


class NearestRtt:
    """The STAMP round trip nearest in time to an application round trip over the same path."""

    def __init__(self, within_ns: int = 1_000_000_000) -> None:
        self._within_ns = within_ns
        self._results: collections.deque[tuple[int, int]] = collections.deque(maxlen=512)

    def take(self, result: ProbeResult) -> None:
        """Remember an answered probe."""
        if result.rtt_ns is not None:
            self._results.append((result.mono_ns, result.rtt_ns))

    def near(self, mono_ns: int) -> int | None:
        """Its rtt_ns, None when no probe was answered within the window around mono_ns."""
        best = min(self._results, key=lambda r: abs(r[0] - mono_ns), default=None)
        return best[1] if best is not None and abs(best[0] - mono_ns) <= self._within_ns else None


class _Sent(msgspec.Struct, frozen=True):
    when: Now
    lateness_ns: int


class DelayProber:
    """Sends a ping every period_ns, never waiting for the last one, and takes one NetworkDelay for each.

    No answer within deadline_ns: delay_ns None, alive False (-1 on the wire of 2021). An answer that comes after
    that is counted in `late` and taken as a further record of the same sequence under the method "<method> late", so
    that every ping has exactly one record under its own method.
    """

    def __init__(
        self,
        loop: Loop,
        connect: Callable[[Callable[[Answer], None]], Pinger],
        take: Callable[[NetworkDelay], None],
        *,
        iface: str,
        peer: str,
        method: str,
        period_ns: int = 1_000_000_000,
        deadline_ns: int = 2_000_000_000,
        rtt: NearestRtt | None = None,
    ) -> None:
        self._loop = loop
        self._take = take
        self.iface = iface
        self.peer = peer
        self._method = method
        self._period_ns = period_ns
        self._deadline_ns = deadline_ns
        self._rtt = rtt
        self._sequence = 0
        self._waiting: dict[int, _Sent] = {}
        self._lost: dict[int, _Sent] = {}
        self._job: Job | None = None
        self.answered = 0
        self.lost = 0
        self.late = 0
        self.duplicates = 0
        self._seen: collections.deque[int] = collections.deque(maxlen=256)
        self._pinger = connect(self._from_thread)

    @property
    def in_flight(self) -> int:
        """Pings without a verdict yet."""
        return len(self._waiting)

    def start(self, start_ns: int | None = None) -> Job:
        """Begin at start_ns (CLOCK_MONOTONIC), now by default."""
        self._job = self._loop.every(self._period_ns, self._turn, start_ns=start_ns)
        return self._job

    def close(self) -> None:
        """Send no more; what is in flight stays without a verdict."""
        if self._job is not None:
            self._job.cancel()
        self._pinger.close()

    def _turn(self, slot: Slot) -> None:
        self._sequence += 1
        sequence = self._sequence
        sent = _Sent(now(), slot.late_ns)
        self._waiting[sequence] = sent
        if self._pinger.send(sequence):
            self._loop.at(sent.when.mono_ns + self._deadline_ns + GRACE_NS, lambda: self._expire(sequence))
        else:
            del self._waiting[sequence]
            self.lost += 1
            self._record(sequence, sent, None, reason=Unknown.NOT_CONNECTED)

    def _from_thread(self, answer: Answer) -> None:
        self._loop.call_soon(lambda: self._answered(answer))

    def _answered(self, answer: Answer) -> None:
        sent = self._waiting.pop(answer.sequence, None)
        if sent is None:
            self._answered_late(answer)
            return
        delay_ns = answer.received_mono_ns - sent.when.mono_ns
        if delay_ns > self._deadline_ns:
            self._lose(answer.sequence, sent)
            self._answered_late(answer)
            return
        self.answered += 1
        self._seen.append(answer.sequence)
        self._record(answer.sequence, sent, delay_ns)

    def _answered_late(self, answer: Answer) -> None:
        sent = self._lost.pop(answer.sequence, None)
        if sent is not None:
            self.late += 1
            self._seen.append(answer.sequence)
            self._record(answer.sequence, sent, answer.received_mono_ns - sent.when.mono_ns, late=True)
        elif answer.sequence in self._seen:
            self.duplicates += 1  # two servers under one name

    def _expire(self, sequence: int) -> None:
        sent = self._waiting.pop(sequence, None)
        if sent is not None:
            self._lose(sequence, sent)

    def _lose(self, sequence: int, sent: _Sent) -> None:
        self.lost += 1
        self._lost[sequence] = sent
        self._pinger.cancel(sequence)
        self._record(sequence, sent, None, reason=Unknown.TIMED_OUT)
        forget_before = time.monotonic_ns() - REMEMBER_NS
        for old in [s for s, kept in self._lost.items() if kept.when.mono_ns < forget_before]:
            del self._lost[old]

    def _record(
        self, sequence: int, sent: _Sent, delay_ns: int | None, *, late: bool = False, reason: Unknown | None = None
    ) -> None:
        rtt_ns = self._rtt.near(sent.when.mono_ns) if self._rtt is not None and delay_ns is not None else None
        self._take(
            NetworkDelay(
                wall_ns=sent.when.wall_ns,
                mono_ns=sent.when.mono_ns,
                unknown={} if reason is None else {"delay_ns": reason},
                iface=self.iface,
                peer=self.peer,
                method=f"{self._method} late" if late else self._method,
                sequence=sequence,
                delay_ns=delay_ns,
                alive=delay_ns is not None and not late,
                late=late,
                deadline_ns=self._deadline_ns,
                lateness_ns=sent.lateness_ns,
                middleware_ns=None if rtt_ns is None or delay_ns is None or late else delay_ns - rtt_ns,
            )
        )

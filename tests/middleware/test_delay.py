from __future__ import annotations

import time
from collections.abc import Callable

from linkrover.loop import Loop
from linkrover.middleware import Answer, DelayProber, NearestRtt
from linkrover.records import NetworkDelay, ProbeResult, ProbeState, Unknown

MS = 1_000_000


class ScriptedPinger:
    """Answers as the script says: for each sequence the delays (ns) of its answers; None = not connected."""

    def __init__(self, loop: Loop, script: Callable[[int], tuple[int, ...] | None]) -> None:
        self.loop = loop
        self.script = script
        self.on_answer: Callable[[Answer], None] = lambda _: None
        self.sent: list[int] = []
        self.cancelled: list[int] = []

    def connect(self, on_answer: Callable[[Answer], None]) -> ScriptedPinger:
        self.on_answer = on_answer
        return self

    def send(self, sequence: int) -> bool:
        answers = self.script(sequence)
        if answers is None:
            return False
        self.sent.append(time.monotonic_ns())
        for delay_ns in answers:
            due_ns = time.monotonic_ns() + delay_ns
            self.loop.at(due_ns, lambda: self.on_answer(Answer(sequence, time.monotonic_ns())))
        return True

    def cancel(self, sequence: int) -> None:
        self.cancelled.append(sequence)

    def close(self) -> None:
        pass


def run(
    script: Callable[[int], tuple[int, ...] | None], *, seconds: float, rtt: NearestRtt | None = None
) -> tuple[DelayProber, ScriptedPinger, list[NetworkDelay]]:
    loop = Loop()
    pinger = ScriptedPinger(loop, script)
    taken: list[NetworkDelay] = []
    prober = DelayProber(
        loop,
        pinger.connect,
        taken.append,
        iface="wlan0",
        peer="station",
        method="test",
        period_ns=20 * MS,
        deadline_ns=100 * MS,
        rtt=rtt,
    )
    prober.start()
    loop.run(time.monotonic_ns() + int(seconds * 1e9))
    prober.close()
    loop.close()
    return prober, pinger, taken


def test_pings_are_sent_on_schedule_though_none_is_answered() -> None:
    prober, pinger, taken = run(lambda _: (), seconds=1.0)
    assert len(pinger.sent) >= 30  # 50 slots; a busy machine may miss some, waiting for answers would leave 10
    assert prober.in_flight > 1
    assert all(r.delay_ns is None and not r.alive and r.unknown == {"delay_ns": Unknown.TIMED_OUT} for r in taken)


def test_a_lost_ping_is_cancelled_and_said_once() -> None:
    _, pinger, taken = run(lambda _: (), seconds=0.5)
    assert pinger.cancelled == [r.sequence for r in taken]
    assert len(set(pinger.cancelled)) == len(pinger.cancelled)


def test_a_late_answer_is_counted_and_recorded_under_a_method_of_its_own() -> None:
    prober, _, taken = run(lambda s: (250 * MS,) if s == 1 else (MS,), seconds=0.6)
    first = [r for r in taken if r.sequence == 1]
    assert [(r.method, r.late, r.alive) for r in first] == [("test", False, False), ("test late", True, False)]
    assert first[0].delay_ns is None
    assert first[1].delay_ns is not None
    assert first[1].delay_ns >= 250 * MS
    assert prober.late == 1


def test_an_answer_given_twice_counts_once_and_is_noticed() -> None:
    prober, _, taken = run(lambda _: (MS, 2 * MS), seconds=0.4)
    assert prober.duplicates > 0
    sequences = [r.sequence for r in taken]
    assert len(sequences) == len(set(sequences))


def test_without_a_connection_nothing_is_waited_for() -> None:
    prober, _, taken = run(lambda _: None, seconds=0.2)
    assert prober.in_flight == 0
    assert all(r.unknown == {"delay_ns": Unknown.NOT_CONNECTED} for r in taken)


def test_stamped_with_the_time_of_sending() -> None:
    _, pinger, taken = run(lambda _: (50 * MS,), seconds=0.3)
    for record, sent_ns in zip(taken, pinger.sent, strict=False):
        assert 0 <= sent_ns - record.mono_ns < 20 * MS


def test_the_middlewares_share_is_the_delay_less_the_nearest_probe() -> None:
    rtt = NearestRtt()
    now_ns = time.monotonic_ns()
    for offset_s, value in ((-0.4, 7), (0.0, 3 * MS), (5.0, 9)):
        rtt.take(
            ProbeResult(
                wall_ns=0,
                mono_ns=now_ns + int(offset_s * 1e9),
                peer="p",
                session=1,
                sequence=1,
                state=ProbeState.ANSWERED,
                rtt_ns=value,
            )
        )
    _, _, taken = run(lambda _: (10 * MS,), seconds=0.15, rtt=rtt)
    assert taken
    for record in taken:
        assert record.delay_ns is not None
        assert record.middleware_ns == record.delay_ns - 3 * MS


def test_a_probe_of_long_ago_says_nothing_about_now() -> None:
    rtt = NearestRtt(within_ns=10)
    assert rtt.near(time.monotonic_ns()) is None

from __future__ import annotations

from linkrover.agent.outage import OutageWatch
from linkrover.records import EventKind, Now, ProbeResult, ProbeState

S = 1_000_000_000


def result(sequence, state=ProbeState.ANSWERED, step_ns=S // 10):
    at = sequence * step_ns
    return ProbeResult(
        wall_ns=at + 10 * S, mono_ns=at, peer="p", session=1, sequence=sequence, state=state, rtt_ns=1000
    )


def watch(threshold_s=1.0):
    return OutageWatch("wlan0", "p", round(threshold_s * S), Now(10 * S, 0))


def test_answers_without_a_gap_are_no_outage():
    outage = watch()
    events = [event for n in range(1, 50) for event in (*outage.take(result(n)), *outage.look(n * S // 10))]
    assert events == []


def test_an_outage_spans_from_the_last_answered_probe_to_the_next():
    outage = watch()
    outage.take(result(5))
    assert outage.look(S // 2 + S) == []
    (began,) = outage.look(S // 2 + S + 1)
    assert (began.kind, began.mono_ns, began.wall_ns) == (EventKind.OUTAGE_BEGAN, S // 2, 10 * S + S // 2)
    assert outage.look(9 * S) == []
    assert outage.take(result(20, ProbeState.LOST)) == []
    (ended,) = outage.take(result(35))
    assert (ended.kind, ended.mono_ns, ended.gap_ns) == (EventKind.OUTAGE_ENDED, 35 * S // 10, 3 * S)


def test_an_outage_that_nobody_looked_at_is_told_whole_afterwards():
    outage = watch(0.5)
    outage.take(result(1))
    began, ended = outage.take(result(11))
    assert (began.kind, ended.kind, ended.gap_ns) == (EventKind.OUTAGE_BEGAN, EventKind.OUTAGE_ENDED, S)


def test_a_late_answer_to_an_old_probe_does_not_end_an_outage_in_the_past():
    outage = watch()
    outage.take(result(50))
    assert outage.take(result(3)) == []


def test_a_peer_that_never_answered_is_out_since_the_start():
    outage = watch()
    (began,) = outage.look(2 * S)
    assert began.mono_ns == 0
    (ended,) = outage.take(result(40))
    assert ended.gap_ns == 4 * S

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.probe import summary
from linkrover.probe.summary import summarise
from linkrover.records import ClockOffset, ClockSource, ProbeResult, ProbeState

MS = 1_000_000
WALL = 1_795_000_000 * 10**9
AHEAD = 5_000 * MS


def answered(sequence, there_ms, back_ms, **changes):
    t1 = WALL + sequence * 100 * MS
    t2 = t1 + round(there_ms * MS) + AHEAD
    t3 = t2 + MS
    t4 = t3 - AHEAD + round(back_ms * MS)
    fields = {
        "wall_ns": t1, "mono_ns": sequence * 100 * MS, "peer": "p:1", "session": 1, "sequence": sequence,
        "state": ProbeState.ANSWERED, "reflector_sequence": sequence - 1, "rtt_ns": t4 - t1 - (t3 - t2),
        "t1_ns": t1, "t2_ns": t2, "t3_ns": t3, "t4_ns": t4, "send_clock": ClockSource.KERNEL,
    }  # fmt: skip
    return ProbeResult(**{**fields, **changes})


def unanswered(sequence, state):
    return ProbeResult(
        wall_ns=WALL + sequence * 100 * MS, mono_ns=sequence * 100 * MS, peer="p:1", session=1, sequence=sequence,
        state=state,
    )  # fmt: skip


OFFSET = ClockOffset(wall_ns=WALL, mono_ns=0, peer="p:1", offset_ns=AHEAD, error_bound_ns=7)


def test_every_figure_of_a_small_series_by_hand():
    there, back = [10, 12, 11, 30], [5, 5, 9, 5]
    s = summarise([answered(n + 1, there[n], back[n]) for n in range(4)], offset=OFFSET)
    rtt = [15, 17, 20, 35]
    assert s.rtt.min_ns == 15 * MS
    assert s.rtt.mean_ns == pytest.approx(sum(rtt) / 4 * MS)
    assert s.rtt.median_ns == pytest.approx(18.5 * MS)
    assert s.rtt.p95_ns == pytest.approx((20 + 0.85 * 15) * MS)
    mean = sum(rtt) / 4
    assert s.rtt.std_ns == pytest.approx(math.sqrt(sum((x - mean) ** 2 for x in rtt) / 3) * MS)
    assert s.forward.delay.median_ns == pytest.approx(11.5 * MS)
    assert s.forward.delay_bound_ns == 7
    assert s.back.delay.max_ns == pytest.approx(9 * MS)
    assert s.forward.pdv.max_ns == 20 * MS, "delay minus the least"
    assert s.forward.ipdv.mean_ns == pytest.approx((2 + 1 + 19) / 3 * MS)
    jitter = 0.0
    for step in (2, 1, 19):
        jitter += (step - jitter) / 16
    assert s.forward.jitter_ns == pytest.approx(jitter * MS)
    assert s.send_clocks == {"kernel": 4}
    assert s.receive_clocks == {"user": 4}
    assert s.duration_ns == 300 * MS


def test_ipdv_skips_over_a_lost_probe():
    s = summarise(
        [answered(1, 10, 5), unanswered(2, ProbeState.LOST_FORWARD), answered(3, 50, 5, reflector_sequence=1)],
        offset=OFFSET,
    )
    assert s.forward.ipdv is None
    assert s.forward.loss == pytest.approx(1 / 3)
    assert (s.back.sent, s.back.lost) == (2, 0)


def test_the_last_record_of_a_probe_counts_and_refused_probes_are_unanswered_but_not_lost():
    late = answered(2, 1, 2100, state=ProbeState.LATE)
    s = summarise([answered(1, 1, 1), unanswered(2, ProbeState.LOST), late, unanswered(3, ProbeState.NOT_SENT)])
    assert (s.sent, s.answered, s.late, s.lost, s.not_sent) == (2, 1, 1, 0, 1)
    assert s.loss == pytest.approx(2 / 3), "of three probes due one was answered in time"


def test_nothing_at_all_gives_a_summary_of_nothing():
    s = summarise([])
    assert (s.sent, s.loss, s.rtt, s.offset, s.forward.delay) == (0, None, None, None, None)


def test_without_a_given_offset_the_series_finds_its_own():
    s = summarise([answered(n, 10, 10) for n in range(1, 20)])
    assert s.offset.offset_ns == pytest.approx(AHEAD, abs=s.offset.error_bound_ns)
    assert s.forward.delay.median_ns == pytest.approx(10 * MS, abs=s.forward.delay_bound_ns)


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=50))
def test_quantiles_are_ordered_and_within_the_values(values):
    d = summary.distribution(values)
    assert d.min_ns <= d.median_ns <= d.p95_ns <= d.p99_ns <= d.max_ns
    assert d.min_ns - 1 <= d.mean_ns <= d.max_ns + 1


def test_rfc_3550_jitter_of_a_steady_delay_is_zero_and_of_none_unknown():
    assert summary.jitter_ns([5.0] * 10) == 0
    assert summary.jitter_ns([]) is None

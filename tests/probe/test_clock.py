import random

import pytest

from linkrover.probe.clock import ClockTracker, fit_offset
from linkrover.records import ProbeResult, ProbeState

US, MS, S = 1_000, 1_000_000, 1_000_000_000
START = 1_795_000_000 * S


def exchange(at_ns, *, ahead_ns, there_ns, back_ns, held_ns=50 * US, sequence=1):
    """An answered probe whose peer's clock is ahead by ahead_ns(mono) at the time."""
    t1 = START + at_ns
    t2 = t1 + there_ns
    t3 = t2 + held_ns
    t4 = t3 + back_ns
    return ProbeResult(
        wall_ns=t1, mono_ns=at_ns, peer="peer:1", session=1, sequence=sequence, state=ProbeState.ANSWERED,
        rtt_ns=there_ns + back_ns, t1_ns=t1, t2_ns=t2 + ahead_ns(t2 - START), t3_ns=t3 + ahead_ns(t3 - START),
        t4_ns=t4,
    )  # fmt: skip


def busy_link(seconds, ahead_ns, *, seed=1, floor_ns=400 * US, queue_ns=30 * MS, rate_hz=10):
    """Probes over a link whose queue delays the way there far more than the way back."""
    chance = random.Random(seed)
    for k in range(seconds * rate_hz):
        there = floor_ns + round(chance.expovariate(1 / queue_ns))
        back = floor_ns + round(chance.expovariate(10 / queue_ns))
        yield exchange(k * S // rate_hz, ahead_ns=ahead_ns, there_ns=there, back_ns=back, sequence=k + 1)


def offset_at(offset, wall_ns):
    return offset.offset_ns + (offset.drift_ppb or 0) * 1e-9 * (wall_ns - offset.wall_ns)


@pytest.mark.parametrize("drift_ppm", [0.0, 40.0, -150.0])
def test_the_true_offset_lies_within_the_bound_at_every_moment(drift_ppm):
    def ahead(mono_ns):
        return round(-3.2 * S + drift_ppm * 1e-6 * mono_ns)

    tracker = ClockTracker()
    for result in busy_link(180, ahead):
        tracker.add(result)
        offset = tracker.offset()
        assert abs(offset.offset_ns - ahead(result.mono_ns)) <= offset.error_bound_ns + 1_000
    assert tracker.steps == 0
    assert offset.error_bound_ns < 3 * MS, "far tighter than the 30 ms of queue"
    assert offset.drift_ppb == pytest.approx(drift_ppm * 1e3, abs=60_000)
    assert offset.peer == "peer:1"


def test_on_a_quiet_link_the_bound_is_half_the_round_trip_and_the_drift_is_found():
    tracker = ClockTracker()
    for result in busy_link(120, lambda t: round(20e-6 * t), floor_ns=20 * US, queue_ns=5 * US):
        tracker.add(result)
    offset = tracker.offset()
    assert offset.error_bound_ns <= 25 * US
    assert offset.drift_ppb == pytest.approx(20_000, abs=1_000)
    assert offset.samples == 1200
    assert offset.window_ns == pytest.approx(119.9 * S)


def test_without_an_answered_probe_there_is_no_offset():
    tracker = ClockTracker()
    tracker.add(ProbeResult(wall_ns=1, mono_ns=1, peer="p", session=1, sequence=1, state=ProbeState.LOST))
    assert tracker.offset() is None
    assert fit_offset([]) is None


def test_a_stepped_peer_clock_is_noticed_and_tracking_begins_anew():
    tracker = ClockTracker()
    for result in busy_link(60, lambda t: 5 * S if t > 30 * S else 0, floor_ns=100 * US, queue_ns=100 * US):
        tracker.add(result)
    assert tracker.steps == 1
    assert abs(tracker.offset().offset_ns - 5 * S) <= tracker.offset().error_bound_ns


def test_one_impossible_sample_changes_nothing():
    tracker = ClockTracker()
    results = list(busy_link(30, lambda t: 0, floor_ns=100 * US, queue_ns=100 * US))
    for k, result in enumerate(results):
        tracker.add(result)
        if k == 100:
            wrong = exchange(result.mono_ns + 1, ahead_ns=lambda t: 7 * S, there_ns=US, back_ns=US)
            tracker.add(wrong)
    assert tracker.steps == 0
    assert abs(tracker.offset().offset_ns) <= tracker.offset().error_bound_ns


def test_a_negative_round_trip_is_not_believed():
    tracker = ClockTracker()
    tracker.add(exchange(0, ahead_ns=lambda t: 0, there_ns=-5 * US, back_ns=US))
    assert tracker.offset() is None


@pytest.mark.parametrize("seconds", [5, 90])
def test_one_offset_for_a_whole_series_is_within_its_bound_at_every_probe(seconds):
    def ahead(mono_ns):
        return round(250 * MS - 60e-6 * mono_ns)

    results = list(busy_link(seconds, ahead, floor_ns=50 * US, queue_ns=2 * MS))
    offset = fit_offset(results)
    assert all(abs(offset_at(offset, r.wall_ns) - ahead(r.mono_ns)) <= offset.error_bound_ns for r in results)
    assert offset.error_bound_ns < 1 * MS
    assert (offset.drift_ppb is None) == (seconds < 20)


def test_a_series_across_a_step_has_no_single_offset():
    results = list(busy_link(20, lambda t: 5 * S if t > 10 * S else 0))
    assert fit_offset(results) is None

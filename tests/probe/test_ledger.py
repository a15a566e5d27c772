import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.probe.ledger import Answer, Flight, Ledger
from linkrover.probe.summary import settled, summarise
from linkrover.records import ClockSource, ProbeState

MS = 1_000_000
PERIOD = 100 * MS
DEADLINE = 2_000 * MS


class Network:
    """A ledger with a clock, and a stateful reflector that may be made stateless or be restarted."""

    def __init__(self, *, stateless=False):
        self.reports = []
        self.ledger = Ledger("peer:1", 5, 44, 10_000 * MS, self.reports.append)
        self.now = 0
        self.next = 1
        self.counter = 0
        self.stateless = stateless

    def send(self):
        flight = Flight(self.next, 10**18 + self.now, self.now, self.now + DEADLINE, 0)
        self.next += 1
        self.ledger.sent(flight)
        return flight

    def reflect(self, flight):
        number = flight.sequence if self.stateless else self.counter
        self.counter += 1
        return number

    def answer(self, flight, number):
        wall = flight.wall_ns
        rtt = self.now - flight.mono_ns
        self.ledger.answered(
            flight,
            Answer(number, wall, wall + rtt // 2, wall + rtt // 2, wall + rtt, self.now,
                   ClockSource.USER, ClockSource.USER),
        )  # fmt: skip

    def step(self, ns=PERIOD):
        self.now += ns
        self.ledger.due(self.now)

    def round_trip(self, *, forward=True, back=True):
        flight = self.send()
        if forward:
            number = self.reflect(flight)
            if back:
                self.answer(flight, number)
        self.step()
        return flight

    def finish(self):
        for _ in range(25):
            self.step()

    def states(self):
        return {r.sequence: r.state for r in settled(self.reports)}


def test_each_single_loss_gets_its_direction_without_a_second_record():
    net = Network()
    for k in range(40):
        net.round_trip(forward=k != 10, back=k != 20)
    net.finish()
    assert net.states()[11] is ProbeState.LOST_FORWARD
    assert net.states()[21] is ProbeState.LOST_BACK
    assert len(net.reports) == 40, "one record a probe"


@pytest.mark.parametrize(("forward", "expected"), [(False, ProbeState.LOST_FORWARD), (True, ProbeState.LOST_BACK)])
def test_a_long_outage_is_reported_at_once_and_gets_its_direction_when_the_peer_is_back(forward, expected):
    net = Network()
    for _ in range(5):
        net.round_trip()
    for _ in range(50):
        net.round_trip(forward=forward, back=False)
    early = net.states()
    assert early[6] is ProbeState.LOST, "past its deadline, though the direction cannot be known yet"
    for _ in range(5):
        net.round_trip()
    net.finish()
    assert {net.states()[n] for n in range(6, 56)} == {expected}


def test_a_mixed_gap_keeps_single_probes_undirected_and_the_summary_counts_each_way():
    net = Network()
    net.round_trip()
    net.round_trip(forward=False)
    net.round_trip(back=False)
    net.round_trip(forward=False)
    net.round_trip()
    net.finish()
    assert {net.states()[n] for n in (2, 3, 4)} == {ProbeState.LOST}
    summary = summarise(net.reports)
    assert (summary.lost, summary.lost_forward, summary.lost_back, summary.lost_unknown) == (3, 2, 1, 0)
    assert (summary.forward.sent, summary.back.sent) == (5, 3)


def test_a_stateless_reflector_leaves_the_direction_unknown():
    net = Network(stateless=True)
    for k in range(30):
        net.round_trip(forward=k not in (5, 6))
    net.finish()
    assert net.ledger.stateless
    assert net.states()[6] is ProbeState.LOST
    assert summarise(net.reports).lost_unknown == 2


def test_losses_before_the_first_answer_are_directed_by_the_reflectors_zero():
    net = Network()
    net.round_trip(forward=False)
    net.round_trip(forward=False)
    for _ in range(5):
        net.round_trip()
    net.finish()
    assert {net.states()[n] for n in (1, 2)} == {ProbeState.LOST_FORWARD}


def test_a_late_answer_supersedes_the_loss():
    net = Network()
    flight = net.send()
    number = net.reflect(flight)
    net.now += 3_000 * MS
    net.ledger.due(net.now)
    assert net.reports[-1].state is ProbeState.LOST
    net.answer(flight, number)
    assert net.reports[-1].state is ProbeState.LATE
    assert net.reports[-1].rtt_ns == 3_000 * MS
    summary = summarise(net.reports)
    assert (summary.sent, summary.lost, summary.late, summary.loss) == (1, 0, 1, 1.0)


def test_an_answer_after_the_late_window_is_no_longer_known():
    net = Network()
    flight = net.send()
    net.step(13_000 * MS)
    assert net.ledger.find(flight.sequence) is None


def test_duplicates_are_counted_on_the_probe_and_a_flood_of_them_makes_few_records():
    net = Network()
    flight = net.send()
    number = net.reflect(flight)
    for _ in range(1000):
        net.answer(flight, number)
    assert len(net.reports) == 4
    assert summarise(net.reports).duplicates == 3
    assert flight.duplicates == 999


def test_an_answer_overtaken_by_a_later_probes_is_out_of_order():
    net = Network()
    first, second = net.send(), net.send()
    numbers = net.reflect(first), net.reflect(second)
    net.answer(second, numbers[1])
    net.answer(first, numbers[0])
    assert [r.reordered for r in settled(net.reports)] == [True, False]
    assert net.ledger.restarts == 0


def test_a_restarted_reflector_is_noticed_and_measuring_goes_on():
    net = Network()
    for _ in range(30):
        net.round_trip()
    net.round_trip(forward=False)
    net.counter = 0
    for _ in range(10):
        net.round_trip()
    net.round_trip(back=False)
    for _ in range(10):
        net.round_trip()
    net.finish()
    assert net.ledger.restarts == 1
    assert net.states()[31] is ProbeState.LOST, "across a restart the numbers do not say where"
    assert net.states()[42] is ProbeState.LOST_BACK


def test_both_sequences_go_on_beyond_32_bits():
    net = Network()
    net.next, net.counter = 0xFFFF_FFF0, 0xFFFF_FFE0
    for k in range(64):
        flight = net.send()
        assert net.ledger.find(flight.sequence & 0xFFFF_FFFF) is flight
        if k != 30:
            net.answer(flight, net.reflect(flight) & 0xFFFF_FFFF)
        net.step()
    net.finish()
    assert net.ledger.restarts == 0
    assert [n for n, s in net.states().items() if s is not ProbeState.ANSWERED] == [0xFFFF_FFF0 + 30]


@given(st.lists(st.sampled_from("...fb"), min_size=1, max_size=80), st.integers(0, 2**32))
@settings(max_examples=150)
def test_directions_are_never_wrong_and_the_sum_of_all_is_complete(fates, seed):
    """Whatever is lost and however answers are delayed, no state claims what did not happen."""
    shuffle = random.Random(seed)
    net = Network()
    truth, under_way = {}, []
    for fate in fates:
        flight = net.send()
        truth[flight.sequence] = fate
        if fate != "f":
            number = net.reflect(flight)
            if fate != "b":
                under_way.append((net.now + shuffle.choice([1, 1, 1, 250]) * MS, flight, number))
        net.now += PERIOD
        for arrival in [a for a in under_way if a[0] <= net.now]:
            under_way.remove(arrival)
            net.answer(arrival[1], arrival[2])
        net.ledger.due(net.now)
    for _, flight, number in under_way:
        net.answer(flight, number)
    net.finish()
    allowed = {
        ".": {ProbeState.ANSWERED},
        "f": {ProbeState.LOST_FORWARD, ProbeState.LOST},
        "b": {ProbeState.LOST_BACK, ProbeState.LOST},
    }
    states = net.states()
    assert set(states) == set(truth)
    assert all(states[n] in allowed[fate] for n, fate in truth.items())
    summary = summarise(net.reports)
    assert summary.answered == fates.count(".")
    assert summary.lost == fates.count("f") + fates.count("b")
    assert summary.lost_forward <= fates.count("f")
    assert summary.lost_back <= fates.count("b")

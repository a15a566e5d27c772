from __future__ import annotations

import pytest

from linkrover.live.lines import account_line, duration, event_line, interface_line, peer_line, rate, summary_lines
from linkrover.live.spark import spark
from linkrover.live.state import LiveState
from linkrover.records import (
    Continuity,
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkErrors,
    ProbeResult,
    ProbeState,
    SelfAccount,
    WirelessLink,
)

S = 1_000_000_000


def probe(sequence, state=ProbeState.ANSWERED, rtt_ns=1_000_000):
    return ProbeResult(
        wall_ns=sequence * S // 10,
        mono_ns=sequence * S // 10,
        peer="p",
        session=1,
        sequence=sequence,
        state=state,
        rtt_ns=rtt_ns if state is ProbeState.ANSWERED else None,
    )


def errors(second, continuity=Continuity.STEADY, **counters):
    return NetworkErrors(wall_ns=second * S, mono_ns=second * S, iface="w", continuity=continuity, **counters)


def link(peer, rssi, second=1):
    return WirelessLink(
        wall_ns=second * S, mono_ns=second * S, iface="w", source="nl80211", peer=peer, rssi_dbm=rssi, connected=True
    )


def test_errors_are_added_up_and_a_reset_adds_nothing():
    state = LiveState()
    state.take(errors(0, Continuity.FIRST, tcp_retransmits=100, nic_rx_errors=5))
    state.take(errors(1, tcp_retransmits=107, nic_rx_errors=5))
    state.take(errors(2, Continuity.RESET, tcp_retransmits=0, nic_rx_errors=5))
    state.take(errors(3, tcp_retransmits=2, nic_rx_errors=6))
    assert state.interfaces["w"].error_totals == {"tcp_retransmits": 9, "nic_rx_errors": 1}


def test_counters_of_a_returned_interface_begin_anew():
    state = LiveState()
    state.take(errors(0, nic_rx_errors=5))
    state.take(errors(1, Continuity.BACK, nic_rx_errors=50))
    assert state.interfaces["w"].error_totals == {}


def test_loss_and_median_are_of_the_last_minute_only():
    state = LiveState()
    for n in range(100):
        state.take(probe(n, ProbeState.LOST))
    for n in range(100, 800):
        state.take(probe(n, rtt_ns=n))
    peer = state.peers["p"]
    assert (peer.sent, peer.lost) == (800, 100)
    assert peer.loss() == 0.0
    assert 199 <= 799 - 600 <= peer.median_rtt_ns() <= 799
    assert len(peer.rtt_history) <= 60


def test_a_result_that_supersedes_an_earlier_one_is_not_counted_twice():
    state = LiveState()
    state.take(probe(1))
    state.take(probe(2, ProbeState.LOST))
    state.take(probe(2, ProbeState.LOST_BACK))
    state.take(probe(2, ProbeState.LATE))
    assert (state.peers["p"].sent, state.peers["p"].lost) == (2, 1)


def test_outages_are_shown_while_they_last_and_added_up_afterwards():
    state = LiveState()
    event = {"wall_ns": 1, "mono_ns": 1, "iface": "w", "peer": "p"}
    state.take(LinkEvent(kind=EventKind.OUTAGE_BEGAN, **event))
    assert "NO ANSWER" in peer_line(state.peers["p"])
    state.take(LinkEvent(kind=EventKind.OUTAGE_ENDED, gap_ns=3 * S, **event))
    assert "outages 1 (3.0 s)" in peer_line(state.peers["p"])


def test_of_an_access_points_peers_the_weakest_is_shown_and_one_that_left_is_forgotten():
    state = LiveState()
    state.take(link("a", -50.0))
    state.take(link("b", -80.0))
    state.take(link("a", -51.0))
    shown = state.interfaces["w"]
    assert (shown.wireless.rssi_dbm, len(shown.peers)) == (-80.0, 2)
    state.take(link("a", -52.0, second=10))
    assert (shown.wireless.rssi_dbm, len(shown.peers)) == (-52.0, 1)


def test_memory_is_bounded():
    state = LiveState()
    for n in range(5000):
        state.take(probe(n, ProbeState.LOST if n % 2 else ProbeState.ANSWERED))
        state.take(LinkEvent(wall_ns=n, mono_ns=n, iface="w", kind=EventKind.SCAN))
    assert len(state.events) == 8
    assert len(state.peers["p"]._window) <= 601


@pytest.mark.parametrize(
    ("bits", "text"),
    [(None, "?"), (0.0, "0 bit/s"), (999.0, "999 bit/s"), (1_234_567.0, "1.23 Mbit/s"), (999_700.0, "1 Mbit/s"),
     (43_300_000.0, "43.3 Mbit/s"), (999_900_000.0, "1 Gbit/s"), (650.4e6, "650 Mbit/s")],
)  # fmt: skip
def test_rates_read_well(bits, text):
    assert rate(bits) == text


@pytest.mark.parametrize(
    ("nanoseconds", "text"),
    [(None, "?"), (5, "5 ns"), (22_700, "22.7 us"), (1_234_567, "1.23 ms"), (2_000_000_000, "2 s")],
)
def test_times_read_well(nanoseconds, text):
    assert duration(nanoseconds) == text


def test_lines_say_gone_not_connected_and_what_measuring_costs():
    state = LiveState()
    base = {"wall_ns": S, "mono_ns": S}
    state.take(LinkUtilization(iface="w", continuity=Continuity.GONE, **base))
    state.take(WirelessLink(iface="w", source="wext", connected=False, **base))
    state.take(
        SelfAccount(interval_ns=S, cpu_ns=S // 200, rss_bytes=28_000_000, records_lost=3, missed_slots=2, **base)
    )
    assert interface_line(state.interfaces["w"]) == "w  GONE  not connected"
    assert account_line(state.account) == "self: 0.50 % CPU, 28 MB, 2 slots missed, 3 records LOST"
    assert len(summary_lines(state)) == 2
    assert event_line(LinkEvent(iface="w", kind=EventKind.ROAMED, detail="to b", **base)) == "w: roamed: to b"
    assert event_line(state.account) is None


def test_a_history_line_has_gaps_where_nothing_is_known():
    assert spark([0, 7, None, 3.5], 10, least=0) == "▁█ ▅"
    assert spark([5, 5], 10) == "▁▁"
    assert spark([None], 10) == " "
    assert len(spark(range(100), 30)) == 30

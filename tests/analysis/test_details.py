"""Stations, channels, neighbours, connections, topics and the account, from recordings whose figures are known."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from linkrover.analysis import RunSummary, load_run, summarise
from linkrover.analysis.channel import busy_shares, channel_number
from linkrover.analysis.group import rise, steps

from .detailed import CAMERA, INSIDE, OTHER_MAC, ROBOT_MAC, record_detailed
from .made import record_run


@pytest.fixture(scope="module")
def summary(tmp_path_factory: pytest.TempPathFactory) -> RunSummary:
    return summarise(load_run(record_detailed(tmp_path_factory.mktemp("detailed") / "run")))


def test_two_robots_on_one_access_point_are_kept_apart(summary: RunSummary) -> None:
    robot, other = (next(s for s in summary.stations if s.peer == peer) for peer in (ROBOT_MAC, OTHER_MAC))
    assert (robot.peer_is, other.peer_is) == ("robot wlan0", None)
    assert (robot.rssi_mean, other.rssi_mean) == (pytest.approx(-50.0), pytest.approx(-70.0))
    assert (robot.tx_mcs_median, other.tx_mcs_median) == (7, 1)
    assert robot.tx_rate_median_mbps == pytest.approx(52.0)
    assert robot.retries_percent == pytest.approx(10.0)
    assert other.retries_percent == pytest.approx(50.0)


def test_counters_that_began_anew_with_an_association_are_added_up(summary: RunSummary) -> None:
    other = next(s for s in summary.stations if s.peer == OTHER_MAC)
    assert other.associations == 2
    assert other.frames_sent == 20 * 100 + 20 * 99


def test_a_restart_is_seen_by_its_time_also_where_the_counter_has_overtaken() -> None:
    counter, since = np.array([10.0, 20.0, np.nan, 25.0]), np.array([False, False, True, False])
    assert rise(counter, since) == 10 + 25
    assert rise(np.array([10.0, 20.0, 5.0])) == 15
    assert rise(np.array([10.0, 20.0]), from_zero=True) == 20
    assert rise(np.array([np.nan])) is None
    assert steps(np.zeros(0)).tolist() == []


def test_channel_utilisation_comes_from_the_raw_counters(summary: RunSummary) -> None:
    (channel,) = summary.channels
    assert (channel.channel, channel.in_use) == (6, True)
    assert channel.listened_s == pytest.approx(18.0)
    assert channel.busy_percent == pytest.approx(33.3, abs=0.1)
    assert channel.receiving_percent == pytest.approx(11.1, abs=0.1)
    assert channel.sending_percent == pytest.approx(5.6, abs=0.1)
    assert (channel.noise_dbm, channel.noise_max_dbm) == (-92.0, -91.0)


def test_an_interval_over_a_survey_reset_does_not_count() -> None:
    table = {
        "t_s": np.arange(4.0),
        "active_ms": np.array([500.0, 1000, 100, 200]),
        "busy_ms": np.array([5.0, 255, 9, 59]),
    }
    share, listened = busy_shares(table)
    assert np.isnan(share[[0, 2]]).all()
    assert share[[1, 3]].tolist() == [0.5, 0.5]
    assert listened.tolist() == [0, 500, 0, 100]


def test_channel_numbers_of_all_bands() -> None:
    assert [channel_number(mhz) for mhz in (2412, 2484, 5180, 5885, 5955, 900)] == [1, 14, 36, 177, 1, None]


def test_neighbours_are_counted_by_how_they_disturb_and_our_own_is_none_of_them(summary: RunSummary) -> None:
    (hood,) = summary.neighbourhoods
    assert (hood.scans, hood.scans_triggered, hood.scan_median_s) == (2, 2, 0.5)
    assert (hood.networks, hood.co_channel, hood.co_channel_heard, hood.adjacent) == (4, 2, 1, 1)
    assert (hood.strongest_co_channel_dbm, hood.strongest_adjacent_dbm) == (-60.0, -75.0)
    assert [n.ssid for n in hood.neighbours if n.own] == ["ours"]
    near = next(n for n in hood.neighbours if n.ssid == "net1")
    assert (near.load_percent, near.load_stations) == (50.0, 7.0)


def test_the_connection_that_retransmits_is_named_with_what_limits_it(summary: RunSummary) -> None:
    camera = summary.connections[0]
    assert (camera.local, camera.remote) == CAMERA
    assert (camera.process, camera.on_host) == ("camera[77]", False)
    assert camera.retransmits == 60  # it began while it was watched: its first sample counts
    assert camera.sent_mb == pytest.approx(20.0)
    assert camera.retransmitted_percent == pytest.approx(100 * 60 * 1448 / 20e6)
    assert camera.rtt_median_ms == pytest.approx(30.5)
    assert camera.receiver_limited_percent == pytest.approx(10.0)
    assert camera.congestion_window_median == 30
    inside = next(c for c in summary.connections if c.local == INSIDE[0])
    assert inside.on_host is True


def test_a_topic_is_joined_with_its_connection_by_addresses(summary: RunSummary) -> None:
    camera = summary.topics[0]
    assert camera.topic == "/camera"  # what stays inside the machine comes last, though it is busier
    assert camera.rate_mbps == pytest.approx(8.0)
    assert camera.messages_per_s == pytest.approx(10.0)
    assert camera.share_percent == pytest.approx(80.0)
    assert camera.retransmits == 60
    inside = summary.topics[-1]
    assert (inside.topic, inside.on_host, inside.share_percent) == ("/inside", True, None)
    assert "not on the air" in (inside.reason or "")


def test_received_against_sent_is_known_for_both_ends_and_where_the_roscore_ran(summary: RunSummary) -> None:
    robot, station = summary.balance["robot"], summary.balance["station"]
    assert (robot.runs_roscore, station.runs_roscore) == (True, False)
    assert robot.received_to_sent == pytest.approx(0.01)
    assert station.received_to_sent == pytest.approx(99.2)
    assert robot.topics_out_mbps == pytest.approx(8.0)
    assert station.topics_in_mbps is None


def test_the_instrument_accounts_for_itself(summary: RunSummary) -> None:
    account = summary.account["robot"]
    assert account.cpu_percent == pytest.approx(2.0)
    assert (account.missed_slots, account.missed_percent) == (21, pytest.approx(5.0))
    assert (account.lateness_median_ms, account.lateness_max_ms) == (pytest.approx(0.2), pytest.approx(4.0))
    assert (account.records_written, account.records_lost) == (2000, 2)
    assert "station" not in summary.account


def test_every_unknown_figure_has_its_reason(summary: RunSummary) -> None:
    groups = [*summary.stations, *summary.channels, *summary.connections, *summary.topics, *summary.balance.values()]
    for group in groups:
        unknown = [n for n in group.__struct_fields__ if n != "reason" and getattr(group, n) is None]
        assert all(name in (group.reason or "") for name in unknown), (unknown, group.reason)
    assert msgspec.json.decode(msgspec.json.encode(summary), type=RunSummary) == summary


def test_a_recording_without_any_of_it_has_empty_lists(tmp_path: Path) -> None:
    plain = summarise(load_run(record_run(tmp_path / "run", seconds=12)))
    assert plain.stations == []
    assert plain.channels == []
    assert plain.neighbourhoods == []
    assert plain.connections == []
    assert plain.topics == []
    assert plain.account == {}

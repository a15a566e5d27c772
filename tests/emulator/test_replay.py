from __future__ import annotations

import msgspec
import pytest

from linkrover.emulator.medium import Medium
from linkrover.emulator.replay import BLACKOUT_DBM, CASE, LEAST_BPS, ReplayLink, Timeline, build
from linkrover.errors import LinkRoverError
from linkrover.records import LinkUtilization, NetworkDelay, Now, Pose, ProbeResult, ProbeState, WirelessLink

S = 1_000_000_000


def drive(with_station_rssi=True):
    robot = [
        WirelessLink(wall_ns=t * S, mono_ns=t, iface="wlan0", source="wext", rssi_dbm=-50.0 - t) for t in range(21)
    ]
    robot += [
        LinkUtilization(wall_ns=t * S, mono_ns=t, iface="wlan0", rx_rate_bps=0.0, tx_rate_bps=t * 1e6)
        for t in range(1, 21)
    ]
    robot += [Pose(wall_ns=t * S, mono_ns=t, x_m=t / 2, y_m=0.0, heading_rad=0.0) for t in range(21)]
    robot += [
        ProbeResult(wall_ns=t * S // 10, mono_ns=t, peer="s", session=1, sequence=t,
                    state=ProbeState.LOST if 100 <= t < 130 else ProbeState.ANSWERED)
        for t in range(200)
    ]  # fmt: skip
    level = -40.0 if with_station_rssi else None
    station = [WirelessLink(wall_ns=t * S, mono_ns=t, iface="wlan0", source="wext", rssi_dbm=level) for t in range(21)]
    return {"robot": robot, "station": station}


def test_rssi_throughput_outage_and_place_come_from_the_recording():
    line = build("run", drive())
    assert line.duration_s == pytest.approx(20, abs=0.2)
    assert line.robot_dbm[5] == -50
    assert line.robot_dbm[105] == -60
    assert line.station_dbm[105] == -40
    # a sample's rate is of the interval that ends with it
    assert line.rate_bps[105] == 11e6
    assert line.rate_bps[0] == 1e6
    assert [line.outage[i] for i in (90, 105, 125, 135)] == [False, True, True, False]
    assert line.place_m[105] == (5.0, 0.0)


def test_an_end_without_rssi_takes_the_other_ends():
    line = build("run", drive(with_station_rssi=False))
    assert line.station_dbm == line.robot_dbm


def test_application_delays_tell_the_outages_where_there_are_no_probes():
    records = [r for r in drive()["robot"] if not isinstance(r, ProbeResult)]
    records += [
        NetworkDelay(wall_ns=t * S, mono_ns=t, iface="wlan0", peer="s", method="ros1 action",
                     delay_ns=None if 10 <= t < 14 else 5, alive=not 10 <= t < 14)
        for t in range(20)
    ]  # fmt: skip
    line = build("run", {"robot": records})
    assert line.outage[120]
    assert not line.outage[160]
    assert min(line.rate_bps) >= LEAST_BPS


def test_a_slow_sampler_whose_every_question_is_answered_saw_no_outage():
    records = [r for r in drive()["robot"] if not isinstance(r, ProbeResult)]
    records += [
        NetworkDelay(wall_ns=t * S, mono_ns=t, iface="wlan0", peer="s", method="ros1 action", delay_ns=5, alive=True)
        for t in range(0, 20, 3)
    ]
    assert not any(build("run", {"robot": records}).outage)


def test_nothing_to_play_back_is_an_error_that_says_so():
    with pytest.raises(LinkRoverError, match="no RSSI and no throughput"):
        build("run", {"robot": []})


class Faces:
    def write(self, medium):
        pass


def test_the_medium_follows_the_timeline_and_stays_at_its_end():
    line = build("run", drive())
    medium: Medium = CASE.make_medium(1)
    link = ReplayLink(line, Faces())
    for step, expected in ((5, -50.0), (105, BLACKOUT_DBM), (150, -65.0), (100_000, -69.0)):
        at = link._start_ns + int(step * 0.1 * S) + 1
        link.tick(medium, Now(at, at))
        assert medium.hop("station", "robot").rssi_dbm == expected
    assert medium.hop("robot", "station").rssi_dbm == -40.0


def test_a_timeline_goes_through_json_unchanged():
    line = build("run", drive())
    assert msgspec.json.decode(msgspec.json.encode(line), type=Timeline) == line

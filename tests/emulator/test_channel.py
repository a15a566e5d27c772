import numpy as np
import pytest

from linkrover.emulator.channel import Channel, ChannelConfig
from linkrover.emulator.presets import CASES, find
from linkrover.errors import ConfigError
from linkrover.radio.path_loss import LogDistance
from linkrover.radio.walls import FloorPlan, Wall

LINE = LogDistance(rss_1m_dbm=-40.0, exponent=3.0)


def test_without_randomness_rssi_is_the_line_and_each_wall_costs_its_loss():
    plan = FloorPlan((Wall(5, -5, 5, 5, 7.0),))
    channel = Channel(ChannelConfig(path_loss=LINE, sigma_db=0.0, nakagami_m=None, plan=plan), seed=1)
    there, back = channel.between(0.0, "a", (0.0, 0.0), "b", (10.0, 0.0))
    assert there.rssi_dbm == back.rssi_dbm == pytest.approx(-70.0 - 7.0)
    assert (there.walls, there.distance_m) == (1, 10.0)
    assert channel.between(0.0, "a", (0.0, 0.0), "b", (4.0, 0.0))[0].walls == 0


def test_the_two_directions_correlate_at_0_99():
    config = ChannelConfig(path_loss=LINE, sigma_db=6.0, nakagami_m=None)
    both = []
    for seed in range(500):
        there, back = Channel(config, seed).between(0.0, "a", (3.0, 4.0), "b", (0.0, 0.0))
        both.append((there.rssi_dbm, back.rssi_dbm))
    assert np.corrcoef(np.array(both).T)[0, 1] == pytest.approx(0.99, abs=0.005)
    assert np.std(both) == pytest.approx(6.0, rel=0.1)


def test_the_signal_is_a_pure_function_of_time_place_and_seed_whatever_was_asked_before():
    config = ChannelConfig(path_loss=LINE)
    one, two = Channel(config, 5), Channel(config, 5)
    for step in range(50):
        one.between(step * 0.1, "a", (step * 0.3, 0.0), "b", (0.0, 0.0))
    asked = (7.0, "a", (2.0, 1.0), "b", (0.0, 0.0))
    assert one.between(*asked) == two.between(*asked)
    assert Channel(config, 6).between(*asked) != two.between(*asked)


def test_asking_from_the_other_end_swaps_the_directions():
    channel = Channel(ChannelConfig(path_loss=LINE), 5)
    there, back = channel.between(1.0, "a", (2.0, 1.0), "b", (0.0, 0.0))
    assert channel.between(1.0, "b", (0.0, 0.0), "a", (2.0, 1.0)) == (back, there)


def test_one_site_keeps_its_shadows_while_trials_differ_in_multipath():
    config = ChannelConfig(path_loss=LINE, site=3)
    one, two = (Channel(config, seed).between(1.0, "a", (2.0, 1.0), "b", (0.0, 0.0))[0] for seed in (1, 2))
    assert one.local_dbm == two.local_dbm
    assert one.rssi_dbm != two.rssi_dbm


def test_apply_sets_every_link_of_a_medium():
    case = find("1")
    medium = case.make_medium(1)
    signals = case.make_channel(1).apply(medium, 0.0, {**case.places, "robot": (0.0, 0.0)})
    assert set(signals) == {("robot", "router"), ("router", "robot"), ("station", "router"), ("router", "station")}
    for (sender, receiver), signal in signals.items():
        assert medium.hop(sender, receiver).rssi_dbm == signal.rssi_dbm
    assert medium.hop("robot", "router").distance_m == pytest.approx(9.18, abs=0.01)


def test_bad_values_are_named():
    with pytest.raises(ConfigError, match=r"channel\.sigma_db"):
        ChannelConfig(sigma_db=-1.0)
    with pytest.raises(ConfigError, match="direction_correlation"):
        ChannelConfig(direction_correlation=2.0)
    with pytest.raises(ConfigError, match="nakagami_m"):
        ChannelConfig(nakagami_m=0.0)


def test_there_are_the_ten_cases_of_table_i_and_an_unknown_one_lists_them():
    assert [case.number for case in CASES] == list(range(1, 11))
    assert find("robot-ap-internal-5") is find("4")
    with pytest.raises(ConfigError, match=r"case 'eleven'.*1 \(router-2\.4\)"):
        find("eleven")


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_every_case_takes_up_to_ten_robots(case):
    robots = ("robot", *(f"robot{i}" for i in range(2, 11)))
    medium = case.make_medium(1, robots)
    assert len(medium.stations) >= 10
    first = next(name for name in robots if name != case.access_point)
    medium.offer(0, first, "station", 100, "x")
    assert [fate.tag for fate in medium.advance(2_000_000_000)] == ["x"]

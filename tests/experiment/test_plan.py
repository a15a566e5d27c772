from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.emulator import presets
from linkrover.errors import ConfigError
from linkrover.experiment.plan import emulated_case, load_plan, parse_plan, trials, world_settings

EXAMPLE = Path(__file__).parents[2] / "examples" / "pandey2022.toml"
HEAD = 'name = "x"\n'
CASE = '[[cases]]\nname = "router-5"\n'


def made(text):
    plan = parse_plan(text, "p.toml")
    return [world_settings(plan, run, None, "p.toml") for run in trials(plan)]


def test_the_example_holds_the_ten_cases_of_table_1_with_two_trials_each():
    plan = load_plan(EXAMPLE)
    runs = trials(plan)
    assert len(runs) == 20
    assert len({run.folder for run in runs}) == len({run.seed for run in runs}) == 20
    assert [emulated_case(case) for case in plan.cases] == list(presets.CASES)
    assert {(c.access_point, c.band_ghz, c.adapter) for c in plan.cases} == {
        (c.access_point, c.band_ghz, c.adapter) for c in presets.CASES
    }


def test_first_trials_of_all_cases_come_before_second_ones():
    runs = trials(load_plan(EXAMPLE))
    assert [run.trial for run in runs] == [1] * 10 + [2] * 10


def test_what_a_plan_says_reaches_the_emulator():
    text = (
        HEAD
        + "seed = 5\n[trajectory]\nwaypoints = [{x_m = 0.0, y_m = 0.0}, {x_m = 9.0, y_m = 0.0, stop_s = 2.0}]\n"
        + "[trajectory.drive]\ncruise_m_per_s = 0.3\n[traffic.camera]\noctets = 50000\nrate_hz = 15\n"
        + "[rates]\nwireless_hz = 5\n[probe]\nrate_hz = 50\n"
        + '[[cases]]\nname = "mine"\npreset = "8"\nchannel = {sigma_db = 1.5}\nmedium = {others_share = 0.3}\n'
        + "nodes = {robot = {queue_packets = 10}}\nplaces = {station = [1.0, 2.0]}\ntrials = 3\n"
    )
    runs = made(text)
    first = runs[0]
    assert len(runs) == 3
    assert (first.case.name, first.case.channel.sigma_db, first.case.medium.others_share) == ("mine", 1.5, 0.3)
    assert first.case.channel.path_loss == presets.find("8").channel.path_loss
    assert first.case.nodes["robot"].queue_packets == 10
    assert first.case.places["station"] == (1.0, 2.0)
    assert first.route.length_m == 9
    assert first.drive.cruise_m_per_s == 0.3
    assert first.traffic.camera.octets == 50000
    assert first.rates["wireless_hz"] == 5
    assert first.probe["rate_hz"] == 50
    assert len({run.seed for run in runs}) == 3


def test_a_case_is_found_by_what_it_is_where_it_has_a_name_of_its_own():
    (run,) = made(HEAD + '[[cases]]\nname = "a"\naccess_point = "robot"\nadapter = "internal"\nband_ghz = 5.0\n')
    assert run.case.channel == presets.find("4").channel


WALL = "channel = {plan = {x_min_m = 0.0, x_max_m = 5.0, y_min_m = 0.0, y_max_m = 5.0, walls = [{x1_m = 1.0, "


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = ", "is not TOML"),
        (HEAD, "`cases`"),
        (HEAD + "cases = []", "at least one case"),
        (HEAD + "trails = 2\n" + CASE, "unknown key 'trails'; did you mean 'trials'?"),
        (HEAD + "trials = 0\n" + CASE, "trials = 0: must be 1 to 1000"),
        (HEAD + "duration_s = -5.0\n" + CASE, "duration_s = -5.0: must be 1 to 86400"),
        ('name = "../up"\n' + CASE, "it names the folder"),
        (HEAD + CASE + CASE, "cases[1].name = 'router-5': must be unlike"),
        (HEAD + '[[cases]]\nname = "../../etc"\n', "it names a folder"),
        (HEAD + '[[cases]]\nname = "unknown"\n', "give preset, one of router-2.4, router-5"),
        (HEAD + '[[cases]]\nname = "a"\npreset = "11"\n', "no such case; there are 1 (router-2.4)"),
        (HEAD + '[[cases]]\nname = "a"\nacces_point = "robot"\n', "unknown key 'cases[0].acces_point'; did you mean"),
        (HEAD + '[[cases]]\nname = "a"\naccess_point = "moon"\n', "cases[0].access_point"),
        (HEAD + CASE + "band_ghz = 3.5\n", "must be 2.4, 5 or 6"),
        (HEAD + CASE + "robot_interfaces = []\n", "at least one interface"),
        (HEAD + CASE + "channel = {sigma = 3.0}\n", "'cases[router-5].channel.sigma'; did you mean 'sigma_db'?"),
        (HEAD + CASE + "channel = {sigma_db = -3.0}\n", "channel.sigma_db = -3.0: must be 0 or more"),
        (HEAD + CASE + "medium = {band_ghz = 7.0}\n", "must be 2.4, 5.0 or 6.0"),
        (HEAD + CASE + "nodes = {moon = {queue_packets = 3}}\n", "must be one of router, robot, station"),
        (HEAD + CASE + "nodes = {robot = {queue_packets = 0}}\n", "must be 1 or more"),
        (HEAD + CASE + "places = {robot = [0.0, 0.0]}\n", "must be one of router, station"),
        (HEAD + CASE + WALL + "y1_m = 1.0, x2_m = 9.0, y2_m = 1.0, loss_db = 3.0}]}}\n", "lies outside the plan"),
        (HEAD + '[trajectory]\nroute = "moon"\n' + CASE, "must be one of lab-2021, out-and-back"),
        (HEAD + "[trajectory.drive]\ncruise_m_per_s = 0.0\n" + CASE, "drive.cruise_m_per_s must be above 0"),
        (HEAD + "[trajectory]\nwaypoints = [{x_m = 0.0, y_m = 0.0}]\n" + CASE, "at least 2 points"),
        (HEAD + "[traffic]\ncommand_hz = 0.0\n" + CASE, "traffic.command_hz"),
        (HEAD + "[traffic.camera]\noctet = 5\nrate_hz = 1\n" + CASE, "'traffic.camera.octet'; did you mean 'octets'?"),
        (HEAD + "[rates]\nwireless_hz = -1.0\n" + CASE, "rates.wireless_hz"),
        (HEAD + "robots = 11\n" + CASE, "robots = 11: must be 1 to 10"),
        (HEAD + 'robots = 2\n[[cases]]\nname = "robot-ap-external-5"\n', "access point is the router or the station"),
        (HEAD + "[probe]\nrate_hz = 0.0\n" + CASE, "probe.rate_hz = 0.0: must be 1 to 1000"),
    ],
)  # fmt: skip
def test_a_bad_plan_is_refused_with_the_key_and_what_is_allowed(text, words):
    with pytest.raises(ConfigError) as error:
        made(text)
    assert words in str(error.value)
    assert str(error.value).startswith(("p.toml", "robots"))


def test_a_plan_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot read the plan .*nowhere\.toml"):
        load_plan(tmp_path / "nowhere.toml")


def test_a_case_that_is_not_in_the_plan_cannot_be_chosen():
    with pytest.raises(ConfigError, match=r"no such case in the plan; there are router-2\.4, router-5"):
        trials(load_plan(EXAMPLE), ("router-6",))


@settings(max_examples=60)
@given(st.text() | st.binary().map(lambda b: HEAD + CASE + b.decode("latin1")))
def test_any_text_is_a_plan_or_a_config_error(text):
    with contextlib.suppress(ConfigError):
        made(text)

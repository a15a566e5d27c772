from __future__ import annotations

import pytest

from linkrover.importer.naming import factors_of_case, guess_setup


@pytest.mark.parametrize(
    ("name", "case", "trial"),
    [
        ("router_2G_trial2.csv", "1", 2),
        ("internal_client_2G_trial2.csv", "3", 2),
        ("internal_server_5G_trial2short.csv", "6", 2),
        ("external_robot_5G.csv", "8", 1),
        ("external/server/2G/trial3.csv", "9", 3),
        ("anything.csv", None, None),
    ],
)
def test_case_and_trial_are_guessed_from_the_name(name: str, case: str | None, trial: int | None) -> None:
    setup = guess_setup(name)
    assert (setup.case, setup.trial) == (case, trial)


def test_what_the_user_says_overrides_the_name() -> None:
    setup = guess_setup("external_robot_5G.csv", case="5", trial=7)
    assert (setup.case, setup.trial, setup.ap, setup.band) == ("5", 7, "station", "2.4 GHz")


def test_folders_above_that_mean_nothing_are_ignored() -> None:
    assert guess_setup("/home/robotics/external2Gdisk/router_5G.csv").case == "2"


@pytest.mark.parametrize(
    ("case", "factors"),
    [
        ("4", {"ap": "robot", "band": "5 GHz", "adapter": "internal"}),
        ("robot-ap-internal-2.4", {"ap": "robot", "band": "2.4 GHz", "adapter": "internal"}),
        ("station-ap-external-5", {"ap": "station", "band": "5 GHz", "adapter": "external"}),
        ("warehouse", {}),
    ],
)
def test_a_case_name_tells_its_factors(case: str, factors: dict[str, str]) -> None:
    assert factors_of_case(case) == factors

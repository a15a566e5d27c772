from __future__ import annotations

import math

import pytest

from linkrover.emulator.robot import LAB_2021, OUT_AND_BACK, ROUTES, Drive, Operator, Robot, Route, Waypoint
from linkrover.errors import ConfigError
from linkrover.records import Now

STEP_NS = 20_000_000
COMMAND_NS = 100_000_000


def drive(route, *, delay_ns=60_000_000, outage=lambda _t: False, limit_s=900):
    operator, robot = Operator(route), Robot(route)
    now, waiting, track = 0, [], []
    while not operator.done and now < limit_s * 1e9:
        if now % COMMAND_NS == 0 and not outage(now):
            waiting.append((now + delay_ns, operator.command(now, robot.x_m, robot.y_m, robot.heading_rad)))
        while waiting and waiting[0][0] <= now:
            robot.command(now, *waiting.pop(0)[1])
        robot.step(now)
        track.append((now, robot.x_m, robot.y_m, robot.forward_m_per_s, robot.turn_rad_per_s))
        now += STEP_NS
    return operator, robot, track


@pytest.mark.parametrize("name", sorted(ROUTES))
def test_the_robot_passes_every_waypoint_and_takes_about_the_nominal_time(name):
    route = ROUTES[name]
    operator, _, track = drive(route)
    assert operator.done
    for point in route.waypoints:
        assert min(math.dist((point.x_m, point.y_m), (x, y)) for _, x, y, _, _ in track) < 0.4
    assert track[-1][0] / 1e9 == pytest.approx(route.nominal_s(), rel=0.1)


def test_the_lab_drive_looks_like_those_of_2021():
    _, robot, track = drive(LAB_2021)
    still = sum(abs(f) < 0.02 and abs(t) < 0.02 for *_, f, t in track) / len(track)
    assert 70 < robot.travelled_m < 93
    assert 0.11 < still < 0.35
    assert 16 < LAB_2021.farthest_m < 19
    assert 197 < track[-1][0] / 1e9 < 357
    assert max(f for *_, f, _ in track) == pytest.approx(0.5)


def test_without_commands_the_robot_stops_by_the_stated_rule_then_drives_back_on_its_trail():
    began, ended = 12_000_000_000, 37_000_000_000
    settings = Drive()
    _, _, track = drive(OUT_AND_BACK, outage=lambda t: began <= t < ended)
    by_time = {t: (x, y, f) for t, x, y, f, _ in track}
    assert by_time[began + 400_000_000][2] > 0.4
    stopped_ns = began + int((settings.command_timeout_s + 0.7) * 1e9)
    assert by_time[stopped_ns // STEP_NS * STEP_NS][2] == 0
    at_stop = by_time[began + 5_000_000_000]
    at_end = by_time[ended]
    assert math.hypot(*at_end[:2]) < math.hypot(*at_stop[:2]) - 2
    assert min(f for *_, f, _ in track) == pytest.approx(-settings.backtrack_m_per_s)


def test_a_fitted_drive_is_over_in_the_given_time():
    for seconds in (10, 30, 60, 200):
        for route in ROUTES.values():
            fitted = route.fitted(seconds)
            if fitted.nominal_s() <= seconds:
                _, _, track = drive(fitted)
                assert track[-1][0] / 1e9 < seconds * 1.1 + 2


def test_odometry_is_near_the_truth_and_a_seed_gives_the_same_odometry_again():
    first, again = Robot(OUT_AND_BACK, seed=5), Robot(OUT_AND_BACK, seed=5)
    for robot in (first, again):
        for now in range(0, 10_000_000_000, STEP_NS):
            robot.command(now, 0.5, 0.1)
            robot.step(now)
    at = Now(1, 1)
    assert first.odometry(at) == again.odometry(at)
    assert math.dist((first.x_m, first.y_m), (first.odometry(at).x_m, first.odometry(at).y_m)) < 0.3
    assert first.true_pose(at).frame == "map"


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Drive(cruise_m_per_s=0), "drive.cruise_m_per_s"),
        (lambda: Drive(odometry_error=-1), "drive.odometry_error"),
        (lambda: Route(waypoints=(Waypoint(0, 0),)), "trajectory.waypoints"),
        (lambda: Route(waypoints=(Waypoint(0, 0), Waypoint(math.nan, 0))), r"trajectory.waypoints\[1\]"),
        (lambda: Route(waypoints=(Waypoint(0, 0, -1), Waypoint(1, 0))), r"stop_s"),
        (lambda: OUT_AND_BACK.fitted(0), "duration"),
        (lambda: OUT_AND_BACK.scaled(-1), "above 0"),
    ],
)
def test_impossible_values_are_refused_by_name(make, key):
    with pytest.raises(ConfigError, match=key):
        make()

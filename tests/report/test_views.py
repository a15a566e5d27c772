from __future__ import annotations

from dataclasses import replace

from linkrover.analysis.batch import load_all
from linkrover.analysis.summary import summarise
from linkrover.report.views import views_of
from tests.datasets import dataset


def test_runs_of_one_name_are_told_apart_by_case_and_then_by_number():
    (run,), _ = load_all([dataset("router_2G_trial2.csv")])
    summary = summarise(run)
    runs = [replace(run, name="trial-1", case=case) for case in ("one", "two", "two")]
    views = views_of(runs, [summary] * 3)
    assert [view.name for view in views] == ["one/trial-1", "two/trial-1", "two/trial-1 (2)"]


def test_a_second_publisher_of_the_2021_package_is_a_problem_with_its_share():
    (run,), _ = load_all([dataset("external_robot_5G.csv")])
    (problem,) = run.problems
    assert problem.startswith("station/iface2: 22 messages came from a second publisher")
    (other,), _ = load_all([dataset("router_2G_trial2.csv")])
    assert other.problems == ()


def test_a_dead_zone_without_any_probe_says_nothing_of_outage(monkeypatch):
    from linkrover.analysis.space import DeadZone
    from linkrover.report import place_words

    (run,), _ = load_all([dataset("router_2G_trial2.csv")])
    zones = [
        DeadZone(x_m=1.0, y_m=2.0, area_m2=3.0, seconds=4.0, worst_rssi_dbm=-85.0),
        DeadZone(x_m=1.0, y_m=2.0, area_m2=3.0, seconds=4.0, outage_percent=60.0),
    ]
    monkeypatch.setattr(place_words, "dead_zones", lambda _: zones)
    silent, out = place_words.place_words(run)[:2]
    assert "4 s, RSSI down to -85 dBm)" in silent
    assert "4 s, out 60 % of that time)" in out

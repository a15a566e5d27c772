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

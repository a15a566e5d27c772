from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from linkrover.analysis import load_run
from linkrover.analysis.needs import area_share, parse_needs
from linkrover.analysis.run import Run
from linkrover.analysis.space import cell_figures, dead_zones, link_budget, locate_anchor, outage_places, surface
from tests.analysis.made import record_run
from tests.datasets import dataset


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return load_run(record_run(tmp_path_factory.mktemp("runs") / "run", seconds=60))


def test_cells_hold_what_was_measured_in_them(run: Run) -> None:
    cells = cell_figures(run, 2.0)
    assert sum(c.seconds for c in cells) == pytest.approx(60, abs=0.5)
    first, last = cells[0], cells[-1]
    assert first.rssi_dbm == pytest.approx(-40, abs=1)
    assert last.rssi_dbm == pytest.approx(-64, abs=1.5)
    out = next(c for c in cells if c.x_m == 7.0)
    assert out.outage == pytest.approx(100, abs=1)
    assert out.loss == pytest.approx(100)
    assert outage_places(run)[0] == pytest.approx((5.0, 0.0), abs=0.1)


def test_a_dead_zone_is_where_the_link_was_out(run: Run) -> None:
    zones = dead_zones(run)
    assert len(zones) == 1
    assert 5.5 < zones[0].x_m < 7.5
    assert zones[0].outage_percent is not None
    assert zones[0].outage_percent > 80


def test_the_map_follows_the_signal_and_its_error_grows_away_from_the_way(run: Run) -> None:
    found = surface(run, "rssi", resolution_m=1.0, margin_m=6.0)
    assert found is not None
    mean, error = np.array(found.mean), np.array(found.standard_error)
    x = np.array(found.x_m)
    row = int(np.argmin(np.abs(found.y_m)))
    inside = (x >= 1) & (x <= 24)
    assert mean[row, inside] == pytest.approx(-40 - x[inside], abs=1.5)
    assert error[0].mean() > 2 * error[row, inside].mean()


def test_the_access_point_of_the_published_drive_is_found_where_the_model_puts_it() -> None:
    found = locate_anchor(load_run(dataset("router_2G_trial2.csv")))
    assert found is not None
    start = load_run(dataset("router_2G_trial2.csv")).pose
    assert start is not None
    away = np.hypot(found.x_m - start["x_m"][0], found.y_m - start["y_m"][0])
    assert 7 < away < 11
    assert 2.0 < found.exponent < 3.5


def test_without_odometry_nothing_is_placed(tmp_path: Path) -> None:
    blind = load_run(record_run(tmp_path / "run", pose=False, seconds=20))
    assert cell_figures(blind) == []
    assert surface(blind) is None
    assert locate_anchor(blind) is None
    assert dead_zones(blind) == []


def test_the_worst_ten_seconds_bound_what_the_topics_may_send(run: Run) -> None:
    budget = link_budget(run)
    assert budget.worst is not None
    assert budget.worst < 8.4 * 0.6
    assert budget.fits is None
    assert "no topic statistics" in (budget.reason or "")


def test_the_share_of_the_floor_that_meets_a_need(run: Run) -> None:
    share = area_share(run, parse_needs(["x: loss below 1 %"])[0])
    assert share is not None
    assert 60 < share < 90

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from linkrover.analysis import load_run, summarise
from linkrover.analysis.batch import find_runs, load_all
from linkrover.analysis.recorded import read_ends
from linkrover.errors import ConfigError, LinkRoverError
from linkrover.records import Role
from tests.analysis.made import record_run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(tmp_path_factory.mktemp("runs") / "run", station_offset_ns=30_000_000_000)


def test_both_ends_come_onto_one_clock_by_the_probes_offset(run_folder: Path) -> None:
    run = load_run(run_folder)
    assert run.clock.method == "probe"
    assert run.clock.offset_ns == 30_000_000_000
    assert run.clock.error_bound_ns == 150_000
    assert run.station is not None
    assert run.station.utilization["wlan0"]["t_s"].tolist() == pytest.approx(list(range(61)), abs=1e-3)
    assert run.problems == ()


def test_figures_are_those_that_were_put_in(run_folder: Path) -> None:
    summary = summarise(load_run(run_folder))
    robot = summary.ends["robot"].interfaces["wlan0"]
    assert summary.duration_s == pytest.approx(60, abs=0.01)
    assert robot.throughput_mbps.mean == pytest.approx(8.4 * 54 / 60, rel=1e-3)
    assert robot.throughput_mbps.tx_mean == pytest.approx(8.0 * 54 / 60, rel=1e-3)
    assert robot.throughput_mbps.connected_mean == pytest.approx(8.4, rel=0.01)
    assert robot.retransmits == 60
    delay = summary.delay_ms
    assert delay.median == pytest.approx(11)
    assert delay.lost == 60
    assert delay.loss_percent == pytest.approx(100 * 60 / 601)
    assert delay.loss_forward_percent == delay.loss_percent
    assert delay.time_out_percent == pytest.approx(10, abs=0.2)
    assert delay.censored_mean == pytest.approx(0.9 * 11 + 0.1 * 2000, rel=0.02)
    assert delay.forward is not None
    assert delay.forward.median == pytest.approx(11 / 4, abs=0.01)
    assert delay.forward.error_bound_ms == pytest.approx(0.15)
    assert delay.back is not None
    assert delay.back.median == pytest.approx(11 * 3 / 4, abs=0.01)


def test_an_outage_has_its_length_and_its_place(run_folder: Path) -> None:
    summary = summarise(load_run(run_folder))
    assert len(summary.outages) == 1
    outage = summary.outages[0]
    assert outage.start_s == pytest.approx(20, abs=0.05)
    assert outage.duration_s == pytest.approx(6, abs=0.05)
    assert outage.x_m == pytest.approx(5, abs=0.1)
    assert outage.rssi_dbm == pytest.approx(-45, abs=1)
    assert outage.ended
    assert summarise(load_run(run_folder), outage_threshold_s=10).outages == []


def test_moving_and_still_are_told_apart_by_the_stated_rule(run_folder: Path) -> None:
    summary = summarise(load_run(run_folder))
    assert summary.motion.rule is not None
    assert "0.05 m/s" in summary.motion.rule
    assert summary.motion.static_percent == pytest.approx(100 / 6, abs=0.5)
    assert summary.motion.driven_m == pytest.approx(25, abs=0.1)
    still = summary.static.ends["robot"].interfaces["wlan0"]
    assert still.rssi_dbm.mean == pytest.approx(-40)
    assert summary.moving.delay_ms.lost == 60
    assert summary.static.delay_ms.lost == 0


def test_the_papers_method_works_on_our_own_recordings(run_folder: Path) -> None:
    summary = summarise(load_run(run_folder), "pandey2022")
    robot = summary.ends["robot"].interfaces["wlan0"]
    assert robot.throughput_mbps.mean == pytest.approx(8.4, rel=0.05)
    assert summary.delay_ms.mean == pytest.approx(11, rel=0.01)


def test_an_unknown_method_says_which_there_are(run_folder: Path) -> None:
    with pytest.raises(ConfigError, match="linkrover, pandey2022"):
        summarise(load_run(run_folder), "median")


def test_one_end_alone_is_reported_and_the_other_named_as_missing(tmp_path: Path) -> None:
    run = load_run(record_run(tmp_path / "run", ends=(Role.ROBOT,), seconds=30))
    summary = summarise(run)
    assert any("station: no recording" in problem for problem in summary.problems)
    assert set(summary.ends) == {"robot"}
    assert summary.delay_ms.median is not None
    station_only = load_run(record_run(tmp_path / "other", ends=(Role.STATION,), seconds=30))
    summary = summarise(station_only)
    assert summary.ends["station"].interfaces["wlan0"].throughput_mbps.mean is not None
    assert summary.delay_ms.reason is not None


def test_recordings_that_do_not_overlap_keep_their_own_figures(tmp_path: Path) -> None:
    run = load_run(record_run(tmp_path / "run", station_late_s=500, offset=False, seconds=30))
    summary = summarise(run)
    assert any("do not overlap" in problem for problem in summary.problems)
    assert any("no clock offset" in problem for problem in summary.problems)
    assert summary.ends["robot"].interfaces["wlan0"].throughput_mbps.mean is not None
    assert summary.ends["station"].interfaces["wlan0"].throughput_mbps.mean is not None


def test_ends_of_different_cases_are_said_to_disagree(tmp_path: Path) -> None:
    record_run(tmp_path / "run", ends=(Role.ROBOT,), seconds=10, case="1")
    record_run(tmp_path / "run", ends=(Role.STATION,), seconds=10, case="2")
    run = load_run(tmp_path / "run")
    assert any("disagree on the case" in problem for problem in run.problems)


def test_without_probe_or_odometry_the_rest_is_reported(tmp_path: Path) -> None:
    summary = summarise(load_run(record_run(tmp_path / "run", probe=False, pose=False, seconds=30)))
    words = " ".join(summary.problems)
    assert "no probe" in words
    assert "no odometry" in words
    assert summary.delay_ms.median is None
    assert summary.delay_ms.reason
    assert "no odometry" in (summary.static.reason or "")
    assert summary.ends["robot"].interfaces["wlan0"].throughput_mbps.mean is not None
    assert summarise(load_run(tmp_path / "run"), "pandey2022").problems


def test_a_truncated_recording_gives_what_is_left_of_it(tmp_path: Path) -> None:
    folder = record_run(tmp_path / "run", seconds=60)
    file = folder / "robot" / "robot.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    run = load_run(folder)
    assert any(problem.startswith("robot:") for problem in run.problems)
    assert summarise(run).ends["station"].interfaces["wlan0"].throughput_mbps.mean is not None


def test_an_empty_end_does_not_cost_the_other(tmp_path: Path) -> None:
    folder = record_run(tmp_path / "run", seconds=30)
    (folder / "station" / "station.mcap").write_bytes(b"")
    run = load_run(folder)
    assert run.robot is not None
    assert any("station" in problem for problem in run.problems)


@pytest.mark.parametrize("make", ["nothing", "folder", "text"])
def test_what_is_no_run_is_a_clear_error(tmp_path: Path, make: str) -> None:
    path = tmp_path / "thing"
    if make == "folder":
        path.mkdir()
    elif make == "text":
        path.write_text("hello")
    with pytest.raises(LinkRoverError, match="thing"):
        load_run(path)


def test_a_folder_of_runs_stands_for_the_runs_in_it(tmp_path: Path) -> None:
    for trial in (1, 2):
        record_run(tmp_path / "campaign" / "case1" / f"trial{trial}", seconds=5, trial=trial)
    (tmp_path / "campaign" / "notes").mkdir()
    found = find_runs([tmp_path / "campaign", tmp_path / "absent"])
    assert [p.name for p in found] == ["trial1", "trial2", "absent"]
    runs, failed = load_all(found)
    assert [r.trial for r in runs] == [1, 2]
    assert len(failed) == 1


def test_reading_a_recording_is_picklable_work(run_folder: Path) -> None:
    found = pickle.loads(pickle.dumps(read_ends))(run_folder / "robot")
    assert set(found[0]) == {"robot"}
    assert pickle.loads(pickle.dumps(load_run(run_folder))).name

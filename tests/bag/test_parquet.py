from __future__ import annotations

import pickle
from pathlib import Path

import polars as pl
import pytest

from linkrover.bag.parquet import convert_recording, plan
from linkrover.errors import LinkRoverError
from linkrover.records import LinkUtilization, Role, WirelessLink

from .ros1_bags import bag_of_2021
from .samples import record_all


@pytest.fixture
def run(tmp_path) -> Path:
    record_all(tmp_path / "run" / "robot", 50)
    record_all(tmp_path / "run" / "station", 50, Role.STATION)
    return tmp_path / "run"


def test_a_lazy_query_over_the_dataset_sees_both_ends_and_the_partition(run, tmp_path):
    out = tmp_path / "dataset"
    for job in plan([run], out, fleet="north"):
        convert_recording(job)
    links = pl.scan_parquet(out / "wireless_link", hive_partitioning=True)
    found = links.group_by("fleet", "robot", "run", "end").agg(pl.len(), pl.mean("rssi_dbm")).sort("end").collect()
    assert found["end"].to_list() == ["robot", "station"]
    assert found["len"].to_list() == [50, 50]
    assert set(found.select("fleet", "robot", "run").iter_rows()) == {("north", "rover", "r1")}
    one = links.filter((pl.col("run") == "r1") & (pl.col("end") == "robot")).select(pl.col("rssi_dbm").null_count())
    assert one.collect().item() == 7
    assert (out / "probe_result" / "fleet=north" / "robot=rover" / "run=r1" / "robot-0000.parquet").is_file()


def test_a_job_is_a_pure_function_that_can_be_pickled(run, tmp_path):
    jobs = plan([run], tmp_path / "a")
    function, job = pickle.loads(pickle.dumps((convert_recording, jobs[0])))
    done = function(job)
    assert pickle.loads(pickle.dumps(done)) == done
    assert done.rows["WirelessLink"] == 50
    assert all(file.is_file() for file in done.files)


def test_what_the_dataset_has_is_not_overwritten_unless_asked(run, tmp_path):
    (job, *_) = plan([run], tmp_path / "a")
    convert_recording(job)
    with pytest.raises(LinkRoverError, match="--replace"):
        convert_recording(job)
    (job, *_) = plan([run], tmp_path / "a", replace=True)
    assert convert_recording(job).rows["WirelessLink"] == 50
    assert len(pl.read_parquet(tmp_path / "a" / "wireless_link")) == 50


def test_two_runs_of_one_name_are_refused_before_anything_is_written(run, tmp_path):
    record_all(tmp_path / "other" / "robot", 5)
    with pytest.raises(LinkRoverError, match="would both be"):
        plan([run, tmp_path / "other"], tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_a_ros_1_bag_of_2021_becomes_a_run_named_by_its_file(tmp_path):
    path = bag_of_2021(tmp_path / "external robot=5G.bag")
    (job,) = plan([path], tmp_path / "a", robot="turtlebot")
    done = convert_recording(job)
    assert done.rows["LinkUtilization"] == 40
    found = pl.scan_parquet(tmp_path / "a" / "link_utilization", hive_partitioning=True).collect()
    assert set(found["run"]) == {"external robot=5G"}
    assert set(found["end"]) == {"robot", "station"}


def test_frames_of_kinds_keep_their_types_in_parquet(run, tmp_path):
    from linkrover.bag.columns import schema_of

    for job in plan([run], tmp_path / "a"):
        convert_recording(job)
    for kind, folder in ((WirelessLink, "wireless_link"), (LinkUtilization, "link_utilization")):
        schema = dict(pl.read_parquet_schema(next((tmp_path / "a" / folder).rglob("*.parquet"))))
        assert schema == schema_of(kind)

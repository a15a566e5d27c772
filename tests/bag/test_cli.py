"""`linkrover info` and `linkrover convert` as a user calls them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import polars as pl
import pytest

from linkrover.bag import Recorder
from linkrover.records import Role

from .ros1_bags import bag_of_2021
from .samples import manifest, record_all, record_number


def linkrover(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "linkrover", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.fixture
def run(tmp_path):
    record_all(tmp_path / "run" / "robot", 20)
    record_all(tmp_path / "run" / "station", 20, Role.STATION)
    return tmp_path / "run"


def test_info_tells_of_both_ends(run):
    done = linkrover("info", run)
    assert done.returncode == 0, done.stderr
    for word in ("robot", "station", "rover", "ath9k", "router 2.4", "/robot/odom", "1.9 s"):
        assert word in done.stdout


def test_info_as_json_is_one_object_a_recording(run):
    found = json.loads(linkrover("info", run, "--json").stdout)
    assert [one["end"] for one in found] == ["robot", "station"]
    assert found[0]["manifest"]["case"] == "router 2.4"
    assert found[0]["duration_s"] == pytest.approx(1.9)
    assert found[0]["problems"] == []
    topics = {topic["name"]: topic for topic in found[0]["topics"]}
    assert topics["/robot/linkrover/probe_result"]["count"] == 20


def test_info_lists_what_is_damaged_and_recovers_a_journal(tmp_path):
    recorder = Recorder(tmp_path / "torn", manifest())
    for record in record_number(0):
        recorder.take(record)
    recorder._flush()
    journal = tmp_path / "torn" / "torn.mcap.journal"
    data = journal.read_bytes()
    recorder.close()
    shutil.rmtree(journal.parent)
    journal.parent.mkdir()
    journal.write_bytes(data[:-20])
    done = linkrover("info", journal.parent)
    assert done.returncode == 0
    assert "not finished" in done.stdout
    assert "--recover" in done.stdout
    done = linkrover("info", journal.parent, "--recover")
    assert done.returncode == 0
    assert "recovered" in done.stderr
    assert sorted(p.name for p in journal.parent.iterdir()) == ["metadata.yaml", "torn.mcap"]


def test_info_of_what_is_no_recording_fails_in_one_line(tmp_path):
    (tmp_path / "x.mcap").write_text("no")
    for path in (tmp_path / "x.mcap", tmp_path / "absent"):
        done = linkrover("info", path)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert done.stderr.count(str(path)) == 1
    assert linkrover("info").returncode == 2


def test_info_of_a_ros_1_bag_says_what_each_topic_is_read_as(tmp_path):
    done = linkrover("info", bag_of_2021(tmp_path / "a.bag"))
    assert "LinkUtilization (station)" in done.stdout
    assert "not read" in done.stdout


def test_convert_makes_a_dataset_once(run, tmp_path):
    out = tmp_path / "dataset"
    done = linkrover("convert", run, "--to", "parquet", out, "--fleet", "north")
    assert done.returncode == 0, done.stderr
    assert len(pl.read_parquet(out / "wireless_link")) == 40
    again = linkrover("convert", run, "--to", "parquet", out, "--fleet", "north")
    assert again.returncode == 1
    assert "--replace" in again.stderr
    renewed = linkrover(
        "convert", run, "--to", "parquet", out, "--fleet", "north", "--replace", "--json", "--jobs", "1"
    )
    assert renewed.returncode == 0, renewed.stderr
    rows = [json.loads(line)["rows"]["WirelessLink"] for line in renewed.stdout.splitlines()]
    assert rows == [20, 20]


def test_convert_of_an_unknown_form_is_wrong_usage(run, tmp_path):
    assert linkrover("convert", run, "--to", "csv", tmp_path / "x").returncode != 0
    assert linkrover("convert", "--to", "parquet", tmp_path / "x").returncode == 2

from __future__ import annotations

import math
import tempfile
from collections import defaultdict
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.bag import Recorder, read_recording
from linkrover.bag.columns import from_records, schema_of
from linkrover.bag.frames import iter_frames, read_frames
from linkrover.records import LinkUtilization, Manifest, Pose, ProbeResult, Record, WirelessLink
from tests.messages.strategies import any_record

from .ros1_bags import bag_of_2021
from .samples import manifest, record_all, record_number


def rows(frames: dict) -> dict[str, list[dict]]:
    """Rows in the order of wall_ns, with NaN as a word since it does not equal itself."""
    found = {}
    for kind, frame in frames.items():
        assert dict(frame.schema) == schema_of(kind)
        dicts = frame.sort("wall_ns", maintain_order=True).to_dicts()
        found[kind.__name__] = [
            {k: "nan" if isinstance(v, float) and math.isnan(v) else v for k, v in d.items()} for d in dicts
        ]
    return found


def expected(path: Path) -> dict[str, list[dict]]:
    by_kind: dict[type[Record], dict[str, list[Record]]] = defaultdict(lambda: defaultdict(list))
    for end, record in read_recording(path).entries():
        by_kind[type(record)][end].append(record)
    parts = {
        kind: [from_records(kind, records, end) for end, records in ends.items()] for kind, ends in by_kind.items()
    }
    return rows({kind: pl.concat(frames) for kind, frames in parts.items()})


def unordered(found: dict[str, list[dict]]) -> dict[str, list[str]]:
    return {kind: sorted(map(repr, one)) for kind, one in found.items()}


@given(st.lists(any_record.filter(lambda r: not isinstance(r, Manifest)), max_size=12))
@settings(max_examples=40, deadline=None)
def test_frames_hold_what_the_records_hold(records):
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "robot"
        with Recorder(path, manifest()) as recorder:
            for record in records:
                recorder.take(record)
        assert recorder.records_lost == 0
        assert unordered(rows(read_frames(path))) == unordered(expected(path))


def test_a_real_sequence_reads_alike_in_batches_of_any_size(tmp_path):
    record_all(tmp_path / "robot", 300)
    whole = unordered(rows(read_frames(tmp_path / "robot")))
    assert whole == unordered(expected(tmp_path / "robot"))
    parts: dict[str, list[str]] = defaultdict(list)
    for frames in iter_frames(tmp_path / "robot", batch_bytes=1):
        for kind, one in rows(frames).items():
            parts[kind] += map(repr, one)
    assert {kind: sorted(one) for kind, one in parts.items()} == whole
    assert len(whole["WirelessLink"]) == 300


def test_unknown_is_null_and_enums_are_their_values(tmp_path):
    record_all(tmp_path / "robot", 10)
    frame = read_frames(tmp_path / "robot")[WirelessLink]
    assert frame["rssi_dbm"].null_count() == 1
    assert frame["tx_bitrate"].null_count() == 1
    assert frame["tx_bitrate"].struct.field("mcs").to_list()[0] == 7
    assert frame["unknown"].to_list()[3] == ["rssi_dbm=not connected", "ssid=not connected"]
    probes = read_frames(tmp_path / "robot", kinds=[ProbeResult])
    assert list(probes) == [ProbeResult]
    assert set(probes[ProbeResult]["state"]) == {"answered", "lost"}


def test_a_journal_reads_as_a_finished_recording_does(tmp_path):
    recorder = Recorder(tmp_path / "robot", manifest(), flush_s=0.01)
    for n in range(50):
        for record in record_number(n):
            recorder.take(record)
    while recorder.records_written < 171:
        pass
    problems: list[str] = []
    live = rows(read_frames(tmp_path / "robot", problems=problems))
    recorder.close()
    assert live == rows(read_frames(tmp_path / "robot"))
    assert any("not finished" in line for line in problems)


def test_damaged_messages_are_left_out_and_counted(tmp_path):
    recorder = Recorder(tmp_path / "robot", manifest())
    for n in range(20):
        for record in record_number(n):
            recorder.take(record)
    recorder._flush()
    journal = tmp_path / "robot" / "robot.mcap.journal"
    data = bytearray(journal.read_bytes())
    recorder.close()
    at = data.index(b"answered\0")
    data[at : at + 8] = b"Xnswered"  # no such state
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "robot.mcap.journal").write_bytes(data)
    problems: list[str] = []
    frames = read_frames(tmp_path / "bad", problems=problems)
    recording = read_recording(tmp_path / "bad")
    assert len(frames[ProbeResult]) == 19 == len(list(recording.records(ProbeResult)))
    assert any("1 messages on /robot/linkrover/probe_result cannot be decoded" in line for line in problems)
    assert set(problems) == set(recording.problems)


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_ros_1_bag_of_2021_reads_alike_as_frames_and_as_records(tmp_path, compression):
    path = bag_of_2021(tmp_path / "a.bag", compression)
    assert unordered(rows(read_frames(path))) == unordered(expected(path))
    parts: dict[str, list[str]] = defaultdict(list)
    for frames in iter_frames(path, batch_bytes=1):
        for kind, one in rows(frames).items():
            parts[kind] += map(repr, one)
    assert {kind: sorted(one) for kind, one in parts.items()} == unordered(expected(path))


def test_rates_of_2021_come_from_the_counters(tmp_path):
    path = bag_of_2021(tmp_path / "a.bag")
    frame = read_frames(path)[LinkUtilization]
    robot = frame.filter((frame["end"] == "robot") & (frame["iface"] == "wlan0"))
    assert robot["continuity"].to_list()[:3] == ["first", "steady", "steady"]
    # 125,000 bytes in 1.05 s, published as "1.0 Mbit"
    assert robot["tx_rate_bps"].to_list()[1] == pytest.approx(125_000 * 8 / 1.05)


def test_a_pose_of_odometry_keeps_its_heading(tmp_path):
    frame = read_frames(bag_of_2021(tmp_path / "a.bag"))[Pose]
    assert frame["heading_rad"].to_list()[2] == pytest.approx(0.02)
    assert set(frame["end"]) == {"robot"}

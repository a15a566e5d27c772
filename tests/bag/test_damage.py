"""Truncation at every kind of place, and flipped bits: every whole message, never another exception, and it is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from linkrover.bag import Recorder, container, read_recording, recover
from linkrover.bag.frames import read_frames
from linkrover.errors import LinkRoverError
from linkrover.records import Manifest, ProbeResult

from .ros1_bags import bag_of_2021
from .samples import manifest, record_number

TENTHS = 40


class Files(dict[str, bytes]):
    """Files by form, with a repr a failure report can hold."""

    def __repr__(self) -> str:
        return f"Files({', '.join(self)})"


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Files:
    """The same recording as a journal and finished, with small chunks so that there are many."""
    place = tmp_path_factory.mktemp("whole")
    recorder = Recorder(place / "robot", manifest())
    for n in range(TENTHS):
        for record in record_number(n):
            recorder.take(record)
    recorder._flush()
    journal = (place / "robot" / "robot.mcap.journal").read_bytes()
    before = container.CHUNK_BYTES
    container.CHUNK_BYTES = 8192
    try:
        recorder.close()
    finally:
        container.CHUNK_BYTES = before
    finished = (place / "robot" / "robot.mcap").read_bytes()
    return Files(journal=journal, finished=finished, ros1=bag_of_2021(place / "a.bag", "lz4").read_bytes())


def written() -> list:
    return [manifest(), *(record for n in range(TENTHS) for record in record_number(n))]


def read(place: Path, data: bytes, suffix: str = ".mcap") -> tuple[list, tuple[str, ...]]:
    path = place / f"x{suffix}"
    path.write_bytes(data)
    recording = read_recording(path)
    records = list(recording.records())
    frames = read_frames(path)
    assert sum(len(frame) for frame in frames.values()) == len(records)
    return records, recording.problems


def record_ends(data: bytes) -> list[int]:
    return [end for _, _, end in container.whole_records(memoryview(data), len(container.MAGIC))]


def test_a_journal_cut_anywhere_gives_every_whole_message(files, tmp_path):
    data = files["journal"]
    ends = [len(container.MAGIC), *record_ends(data)]
    messages = [(end, op) for op, _, end in container.whole_records(memoryview(data), len(container.MAGIC))]
    for number in (0, 1, 2, 3, 10, 60, len(ends) - 2):
        start, following = ends[number], ends[number + 1]
        for cut in (start, start + 1, start + 8, start + 9, (start + following) // 2, following - 1):
            path = tmp_path / "x.mcap.journal"
            path.write_bytes(data[:cut])
            recording = read_recording(path)
            whole = sum(1 for end, op in messages if end <= cut and op == Opcode.MESSAGE)
            assert recording.messages == whole
            assert recording.problems
            assert sum(1 for _ in recording.records()) <= whole


def test_what_is_read_of_a_cut_recording_is_its_beginning(files, tmp_path):
    everything = written()
    for form in ("journal", "finished"):
        size = len(files[form])
        lengths = []
        for share in range(1, 20):
            records, problems = read(tmp_path, files[form][: size * share // 20])
            assert records == everything[: len(records)]
            assert any("not finished" in line for line in problems)
            lengths.append(len(records))
        assert lengths == sorted(lengths)
        assert lengths[-1] > len(everything) // 2


def test_a_chunk_that_is_cut_gives_what_can_be_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "CHUNK_BYTES", 1 << 19)  # as other recorders write them
    recorder = Recorder(tmp_path / "robot", manifest())
    for n in range(1500):
        for record in record_number(n):
            recorder.take(record)
    recorder.close()
    data = (tmp_path / "robot" / "robot.mcap").read_bytes()
    chunks = [(at, end) for op, at, end in container.whole_records(memoryview(data), 8) if op == Opcode.CHUNK]
    at, end = chunks[-2]
    before, _ = read(tmp_path, data[:at])
    within, problems = read(tmp_path, data[: at + (end - at) * 9 // 10])
    assert len(within) > len(before) + 100
    assert any("not finished" in line for line in problems)


def test_a_flipped_bit_in_a_chunk_costs_that_chunk_and_is_said(files, tmp_path):
    data = bytearray(files["finished"])
    chunks = [(at, end) for op, at, end in container.whole_records(memoryview(data), 8) if op == Opcode.CHUNK]
    assert len(chunks) > 5
    at, end = chunks[3]
    data[(at + end) // 2] ^= 1
    records, problems = read(tmp_path, bytes(data))
    assert 0 < len(written()) - len(records) < 40
    (line,) = [line for line in problems if "a chunk of" in line]
    assert "messages over" in line
    missing = sum(int(line.partition(": ")[2].partition(" of ")[0]) for line in problems if "are missing" in line)
    assert f"a chunk of {missing} messages" in line


@pytest.mark.parametrize("form", ["journal", "finished"])
def test_a_flipped_bit_in_the_first_bytes_costs_nothing(files, tmp_path, form):
    for place in range(len(container.MAGIC)):
        data = bytearray(files[form])
        data[place] ^= 0x10
        records, problems = read(tmp_path, bytes(data))
        assert records == read(tmp_path, files[form])[0]
        assert any("first bytes" in problem for problem in problems)


def test_a_flipped_length_in_a_journal_costs_few_messages(files, tmp_path):
    data = files["journal"]
    spans = [(at, end) for op, at, end in container.whole_records(memoryview(data), 8) if op == Opcode.MESSAGE]
    for number in (5, 50, 100):
        for byte in (1, 2, 3, 5):
            damaged = bytearray(data)
            damaged[spans[number][0] + byte] ^= 0x10
            records, problems = read(tmp_path, bytes(damaged), ".mcap.journal")
            assert len(written()) - len(records) <= 3
            assert any("damaged" in line or "decoded" in line for line in problems)


def test_a_damaged_journal_is_recovered_past_the_damage(files, tmp_path):
    data = bytearray(files["journal"])
    spans = [at for op, at, _ in container.whole_records(memoryview(data), 8) if op == Opcode.MESSAGE]
    data[spans[20] + 3] ^= 0x40
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "robot.mcap.journal").write_bytes(data[:-7])
    before = read_recording(tmp_path / "robot")
    records = list(before.records())
    assert recover(tmp_path / "robot").messages == before.messages
    after = read_recording(tmp_path / "robot")
    assert list(after.records()) == records
    assert len(written()) - len(records) < 4
    assert any("recovered" in line and "damaged" in line for line in after.problems)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_flipped_bits_anywhere_never_raise_anything_else(files, tmp_path_factory, data):
    form = data.draw(st.sampled_from(["journal", "finished", "ros1"]))
    damaged = bytearray(files[form])
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), min_size=1, max_size=6)):
        damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    cut = data.draw(st.integers(0, len(damaged)) | st.just(len(damaged)))
    place = tmp_path_factory.mktemp("flip")
    path = place / ("x.bag" if form == "ros1" else "x.mcap")
    path.write_bytes(damaged[:cut])
    try:
        recording = read_recording(path)
        sum(1 for _ in recording.records())
        read_frames(path)
    except LinkRoverError:
        return


@given(st.binary(max_size=300))
@settings(max_examples=150, deadline=None)
def test_any_bytes_at_all_never_raise_anything_else(tmp_path_factory, data):
    place = tmp_path_factory.mktemp("any")
    for head in (b"", container.MAGIC, b"#ROSBAG V2.0\n"):
        path = place / "x.mcap"
        path.write_bytes(head + data)
        try:
            list(read_recording(path).records())
        except LinkRoverError:
            continue


@given(st.data())
@settings(max_examples=80, deadline=None)
def test_what_survives_in_a_finished_recording_is_what_was_written(files, tmp_path_factory, data):
    """Every chunk has a checksum: no flipped bit may show as a wrong number."""
    damaged = bytearray(files["finished"])
    footer = len(damaged)
    for at in data.draw(st.lists(st.integers(8, footer - 1), min_size=1, max_size=4)):
        damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    path = tmp_path_factory.mktemp("flip") / "x.mcap"
    path.write_bytes(damaged)
    everything = {repr(record) for record in written() if not isinstance(record, Manifest)}
    try:
        recording = read_recording(path)
    except LinkRoverError:
        return
    for record in recording.records():
        # where the full topic's definition is lost its 2021 twin is read, which has no monotonic clock
        twin = record.mono_ns == record.wall_ns
        assert twin or isinstance(record, Manifest) or repr(record) in everything


def test_a_chunk_that_claims_to_be_huge_is_refused(files, tmp_path):
    data = bytearray(files["finished"])
    at = next(at for op, at, _ in container.whole_records(memoryview(data), 8) if op == Opcode.CHUNK)
    data[at + 9 + 16 : at + 9 + 24] = (2**62).to_bytes(8, "little")
    records, problems = read(tmp_path, bytes(data))
    assert records
    assert any("at most" in line for line in problems)


def test_a_cut_ros_1_bag_gives_every_whole_chunk(files, tmp_path):
    whole, _ = read(tmp_path, files["ros1"], ".bag")
    path = bag_of_2021(tmp_path / "long.bag", "lz4", 600)
    data = path.read_bytes()
    everything = list(read_recording(path).records())
    records, problems = read(tmp_path, data[: len(data) // 2], ".bag")
    assert len(whole) < len(records)
    assert records == everything[: len(records)]
    assert any("cut off" in line for line in problems)


def test_a_probe_that_was_read_is_a_probe_that_was_sent(files, tmp_path):
    records, _ = read(tmp_path, files["finished"])
    assert [r.sequence for r in records if isinstance(r, ProbeResult)] == list(range(TENTHS))

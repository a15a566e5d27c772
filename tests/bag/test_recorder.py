from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from linkrover.bag import Recorder, is_live, read_recording, recover
from linkrover.bag.container import MAGIC
from linkrover.errors import LinkRoverError
from linkrover.records import EventKind, LinkEvent, Manifest, ProbeResult, Role, WirelessLink

from .samples import T0, manifest, record_all, record_number


def test_what_was_taken_is_what_is_read(tmp_path):
    written = record_all(tmp_path / "robot")
    recording = read_recording(tmp_path / "robot")
    assert list(recording.records()) == written
    assert recording.problems == ()
    assert recording.manifest == manifest()
    assert recording.end == "robot"
    assert recording.format == "mcap"
    assert recording.span == (T0, T0 + 99 * 100_000_000)


def test_only_the_kinds_asked_for_are_read(tmp_path):
    written = record_all(tmp_path / "robot")
    recording = read_recording(tmp_path / "robot")
    assert list(recording.records(ProbeResult)) == [r for r in written if isinstance(r, ProbeResult)]
    assert list(recording.records(end="station")) == []


def test_a_finished_recording_has_no_journal_left(tmp_path):
    record_all(tmp_path / "robot")
    assert sorted(p.name for p in (tmp_path / "robot").iterdir()) == ["metadata.yaml", "robot.mcap"]


def test_a_recording_is_never_overwritten(tmp_path):
    record_all(tmp_path / "robot")
    before = (tmp_path / "robot" / "robot.mcap").read_bytes()
    with pytest.raises(LinkRoverError, match="holds a recording already"):
        Recorder(tmp_path / "robot", manifest())
    assert (tmp_path / "robot" / "robot.mcap").read_bytes() == before


def test_a_directory_in_use_is_refused_and_left_alone(tmp_path):
    recorder = Recorder(tmp_path / "robot", manifest())
    with pytest.raises(LinkRoverError, match="being written"):
        Recorder(tmp_path / "robot", manifest())
    with pytest.raises(LinkRoverError, match="being written"):
        recover(tmp_path / "robot")
    recorder.take(record_number(0)[0])
    assert recorder.close() is not None
    assert len(list(read_recording(tmp_path / "robot").records())) == 2


def test_a_directory_that_cannot_be_written_is_an_error_that_names_it(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(LinkRoverError, match="cannot record into"):
        Recorder(tmp_path / "file" / "robot", manifest())


def test_the_manifest_is_on_disk_before_anything_else(tmp_path):
    recorder = Recorder(tmp_path / "robot", manifest())
    assert list(read_recording(tmp_path / "robot").records()) == [manifest()]
    recorder.close()


def test_the_other_end_has_its_own_topics(tmp_path):
    record_all(tmp_path / "station", 2, Role.STATION)
    recording = read_recording(tmp_path / "station")
    assert recording.end == "station"
    assert all(topic.name.startswith("/station/") for topic in recording.topics)


def test_the_truth_is_an_end_of_its_own(tmp_path):
    with Recorder(tmp_path / "truth", manifest(), end="truth") as recorder:
        recorder.take(record_number(0)[2])
    assert [end for end, _ in read_recording(tmp_path / "truth").entries()] == ["truth", "truth"]


def test_without_the_2021_types_only_full_ones_are_written(tmp_path):
    with Recorder(tmp_path / "robot", manifest(), compatible=False) as recorder:
        for record in record_number(0):
            recorder.take(record)
    assert all("/linkrover/" in topic.name for topic in read_recording(tmp_path / "robot").topics)


def test_a_number_that_does_not_fit_is_counted_and_the_rest_goes_on(tmp_path):
    recorder = Recorder(tmp_path / "robot", manifest())
    probe = record_number(0)[1]
    assert isinstance(probe, ProbeResult)
    recorder.take(msgspec.structs.replace(probe, sequence=2**70))
    recorder.take(probe)
    recorder.close()
    assert recorder.records_lost == 1
    assert list(read_recording(tmp_path / "robot").records(ProbeResult)) == [probe]


def test_an_undecodable_ssid_does_not_cost_the_sample(tmp_path):
    with Recorder(tmp_path / "robot", manifest()) as recorder:
        recorder.take(WirelessLink(wall_ns=T0, mono_ns=0, iface="wlan0", source="nl80211", ssid="caf\udce9"))
    (found,) = read_recording(tmp_path / "robot").records(WirelessLink)
    assert isinstance(found, WirelessLink)
    assert found.ssid == "caf?"


_KILLED = """
import sys, time
from pathlib import Path
from linkrover.bag import Recorder
from tests.bag.samples import manifest, record_number
recorder = Recorder(Path(sys.argv[1]), manifest())
n = 0
while True:
    for record in record_number(n):
        recorder.take(record)
    print(n, flush=True)
    n += 1
    time.sleep(0.005)
"""


@pytest.fixture(scope="module")
def killed_once(tmp_path_factory):
    """A recording whose process was killed, and the last number it had taken a second before that."""
    directory = tmp_path_factory.mktemp("killed") / "robot"
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", _KILLED, directory],
        stdout=subprocess.PIPE,
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    taken: list[tuple[float, int]] = []
    assert process.stdout is not None
    for line in process.stdout:
        taken.append((time.monotonic(), int(line)))
        if taken[-1][0] - taken[0][0] > 2.0:
            break
    process.send_signal(signal.SIGKILL)
    died = time.monotonic()
    process.wait()
    process.stdout.close()
    return directory, max(n for at, n in taken if at < died - 1.0)


@pytest.fixture
def killed(killed_once, tmp_path):
    """The same, as a copy to work on."""
    shutil.copytree(killed_once[0], tmp_path / "robot")
    return tmp_path / "robot", killed_once[1]


def test_a_killed_recording_loses_at_most_a_second(killed):
    directory, known = killed
    recording = read_recording(directory)
    numbers = [r.sequence for r in recording.records(ProbeResult) if isinstance(r, ProbeResult)]
    assert recording.format == "mcap journal"
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > known
    assert any("not finished" in line for line in recording.problems)


def test_a_torn_journal_is_recovered_when_its_directory_is_opened_for_recording(killed):
    directory, known = killed
    journal = directory / "robot.mcap.journal"
    assert not is_live(journal)
    with journal.open("ab") as file:
        file.write(b"\x05\xff\x00\x00\x00\x00\x00\x00\x00torn")
    with pytest.raises(LinkRoverError, match="holds a recording already"):
        Recorder(directory, manifest())
    assert not journal.exists()
    recording = read_recording(directory)
    assert recording.format == "mcap"
    assert recording.messages > known
    assert [line for line in recording.problems if "recovered" in line]


def test_recover_makes_a_finished_recording(killed):
    directory, _ = killed
    before = list(read_recording(directory).records())
    finished = recover(directory)
    assert finished.path == directory / "robot.mcap"
    assert list(read_recording(directory).records()) == before


def test_there_must_be_something_to_recover(tmp_path):
    with pytest.raises(LinkRoverError, match="no journal"):
        recover(tmp_path)


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system of 256 KiB."""
    place = tmp_path / "disk"
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", place], capture_output=True, check=False)
    if done.returncode:
        pytest.skip(f"mounting a tmpfs needs root: {done.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_full_disk_is_said_measuring_goes_on_and_the_recording_stays_readable(tiny_disk):
    events: list[LinkEvent] = []
    recorder = Recorder(tiny_disk / "robot", manifest(), flush_s=0.02, on_event=events.append)
    n = 0
    deadline = time.monotonic() + 30
    while not events and time.monotonic() < deadline:
        for record in record_number(n):
            recorder.take(record)
        n += 1
        time.sleep(0.0005)
    assert events
    assert events[0].kind is EventKind.RECORDING
    assert "disk is full" in events[0].detail
    for record in record_number(n):
        recorder.take(record)  # measuring goes on
    assert recorder.close() is None
    assert recorder.problem is not None
    assert recorder.records_lost > 0
    recording = read_recording(tiny_disk / "robot")
    found = list(recording.records(ProbeResult))
    assert found == [record_number(i)[1] for i in range(len(found))]
    assert len(found) > 50
    assert not any("damaged" in line or "cut off:" in line for line in recording.problems)
    assert recorder.records_written == len(list(recording.records()))


def test_writing_resumes_when_there_is_space_again(tiny_disk):
    ballast = tiny_disk / "ballast"
    events: list[LinkEvent] = []
    recorder = Recorder(tiny_disk / "robot", manifest(), flush_s=0.02, on_event=events.append)
    ballast.write_bytes(bytes(150 * 1024))
    deadline = time.monotonic() + 60
    n = 0
    while len(events) < 2 and time.monotonic() < deadline:
        if events and ballast.exists():
            ballast.unlink()
        if n < 3000:
            recorder.take(record_number(n)[1])
            n += 1
        time.sleep(0.0005 if len(events) == 0 else 0.05)
    assert "writing again" in events[1].detail
    recorder.close()
    recording = read_recording(tiny_disk / "robot")
    found = [r.sequence for r in recording.records(ProbeResult) if isinstance(r, ProbeResult)]
    assert found == sorted(found)
    assert found[-1] == n - 1
    assert list(recording.records(LinkEvent)) != []
    assert not any("damaged" in line for line in recording.problems)


def test_a_file_that_is_no_recording_is_an_error(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"hello")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LinkRoverError, match="neither an MCAP file nor"):
        read_recording(tmp_path / "x.mcap")
    with pytest.raises(LinkRoverError, match="does not exist"):
        read_recording(tmp_path / "y.mcap")
    with pytest.raises(LinkRoverError, match="holds no recording"):
        read_recording(tmp_path / "empty")


def test_an_empty_file_is_an_empty_recording(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"")
    recording = read_recording(tmp_path / "x.mcap")
    assert recording.messages == 0
    assert recording.span is None
    assert recording.problems == ("the file is empty",)
    (tmp_path / "y.mcap").write_bytes(MAGIC)
    assert read_recording(tmp_path / "y.mcap").messages == 0


def test_the_manifest_is_read_without_its_metadata(tmp_path):
    record_all(tmp_path / "robot", 3)
    (found,) = read_recording(tmp_path / "robot").records(Manifest)
    assert found == manifest()


def test_records_of_several_threads_are_all_there(tmp_path):
    with Recorder(tmp_path / "robot", manifest()) as recorder:
        threads = [
            threading.Thread(target=lambda part=part: [recorder.take(record_number(n)[1]) for n in range(part, 400, 4)])
            for part in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = [r.sequence for r in read_recording(tmp_path / "robot").records(ProbeResult) if isinstance(r, ProbeResult)]
    assert sorted(found) == list(range(400))

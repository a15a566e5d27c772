from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from linkrover.bag.reading import read_recording
from linkrover.emulator.leftovers import find_leftovers
from linkrover.records import LinkTruth, LinkUtilization, Manifest, ProbeResult, WirelessLink
from tests.emulator.needs import as_nobody, packets

LINKROVER = [sys.executable, "-m", "linkrover"]


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    """A folder for working folders of this test's own; short, for the sockets in it."""
    with tempfile.TemporaryDirectory(prefix="lr-", dir="/tmp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


@pytest.fixture
def user_folder():
    """A folder an ordinary user can reach; pytest's own are closed to him."""
    with tempfile.TemporaryDirectory(prefix="lr-user-", dir="/tmp") as folder:
        yield Path(folder)


def devices():
    return sorted(path.name for path in Path("/sys/class/net").iterdir())


def descendants(text):
    """Processes whose command line has this text."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if text in line and entry.name != str(os.getpid()):
            found.append(line)
    return found


def driving_demo(out, *more):
    """A demo that has begun to drive."""
    process = subprocess.Popen(
        [*LINKROVER, "demo", "--duration", "60", "--out", str(out), *more], stderr=subprocess.PIPE, text=True
    )
    for line in process.stderr:
        if "driving" in line:
            return process
    raise AssertionError("the demo never began to drive")


def recorded(out, *kinds):
    return {end: list(read_recording(out / end).records(*kinds)) for end in ("robot", "station")}


@pytest.mark.netns
def test_a_short_demo_measures_records_reports_and_agrees_with_the_truth(tmp_path, runtime):
    packets()
    before = devices()
    out = tmp_path / "run"
    done = subprocess.run(
        [*LINKROVER, "demo", "--duration", "6", "--seed", "3", "--json", "--out", str(out)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)
    assert found["agrees"] is True
    page = Path(found["report"])
    assert page.stat().st_size > 10_000
    figures = {figure["what"]: figure for figure in found["outcome"]["agreement"]["figures"]}
    assert figures["robot sends"]["true"] > 1
    assert figures["median round trip"]["samples"] > 20
    assert figures["RSSI at robot"]["samples"] > 30
    assert figures["RSSI at station"]["difference"] == 0
    ends = recorded(out, LinkUtilization, ProbeResult, WirelessLink, Manifest)
    assert all(any(isinstance(r, LinkUtilization) for r in records) for records in ends.values())
    assert all(r.emulated for records in ends.values() for r in records if isinstance(r, Manifest))
    hops = {r.hop for r in read_recording(out / "truth").records(LinkTruth)}
    assert hops == {"robot>station", "station>robot"}
    assert devices() == before
    assert find_leftovers() == []
    assert list((runtime / "linkrover").iterdir()) == []
    again = subprocess.run([*LINKROVER, "demo", "--duration", "6", "--out", str(out)], capture_output=True, text=True)
    assert again.returncode != 0
    assert "never overwritten" in again.stderr


@pytest.mark.netns
def test_ctrl_c_leaves_whole_recordings_and_nothing_else(tmp_path, runtime):
    packets()
    out = tmp_path / "run"
    process = driving_demo(out)
    time.sleep(2.5)
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    process.stderr.close()
    assert process.wait(60) == 130, rest
    for end in ("robot", "station", "truth"):
        assert sorted(p.name for p in (out / end).iterdir()) == sorted([f"{end}.mcap", "metadata.yaml"])
        assert read_recording(out / end).problems == ()
    assert sum(isinstance(r, ProbeResult) for r in recorded(out, ProbeResult)["robot"]) > 10
    assert descendants(str(runtime)) == []
    assert list((runtime / "linkrover").iterdir()) == []


@pytest.mark.netns
def test_ctrl_c_before_it_drives_ends_it_without_a_complaint(tmp_path, runtime):
    packets()
    out = tmp_path / "run"
    process = subprocess.Popen(
        [*LINKROVER, "demo", "--out", str(out)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    for line in process.stdout:
        if "starting" in line:
            break
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    process.stdout.close()
    assert process.wait(60) == 130, rest
    assert "Interrupted" in rest
    assert "does not exist" not in rest
    assert descendants(str(runtime)) == []
    assert list((runtime / "linkrover").iterdir()) == []


@pytest.mark.netns
def test_after_kill_9_the_processes_end_the_recordings_are_readable_and_clean_removes_the_rest(tmp_path, runtime):
    packets()
    out = tmp_path / "run"
    process = driving_demo(out)
    time.sleep(2.5)
    process.kill()
    process.wait()
    process.stderr.close()
    until = time.monotonic() + 20
    while descendants(str(runtime)) and time.monotonic() < until:
        time.sleep(0.1)
    assert descendants(str(runtime)) == []
    assert sum(isinstance(r, ProbeResult) for r in recorded(out, ProbeResult)["robot"]) > 10
    assert any(isinstance(r, LinkTruth) for r in read_recording(out / "truth").records(LinkTruth))
    assert len(find_leftovers()) == 1
    done = subprocess.run([*LINKROVER, "demo", "--clean"], capture_output=True, text=True, check=True)
    assert "removed" in done.stdout
    assert str(out) in done.stdout.replace("\n", "")
    assert find_leftovers() == []
    done = subprocess.run([*LINKROVER, "demo", "--clean"], capture_output=True, text=True, check=True)
    assert "nothing is left" in done.stdout


@pytest.mark.netns
def test_an_ordinary_user_gets_the_same_where_the_device_is_open_to_him(user_folder, runtime):
    packets()
    folder = user_folder
    out = folder / "run"
    os.chown(runtime, 65534, 65534)
    command = as_nobody(0o666, [*LINKROVER, "demo", "--duration", "4", "--json", "--out", str(out)], str(folder))
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime), "HOME": str(folder)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if "virtual time" in done.stderr:
        pytest.skip(f"user namespaces are forbidden here: {done.stderr.splitlines()[0]}")
    assert "in a user namespace" in done.stderr, done.stderr
    assert done.stdout, done.stderr
    found = json.loads(done.stdout)
    figures = {figure["what"]: figure for figure in found["outcome"]["agreement"]["figures"]}
    for figure in figures.values():
        assert abs(figure["difference"]) <= figure["limit"], figure
    assert (out / "robot" / "robot.mcap").stat().st_uid == 65534


def test_without_permission_it_says_which_and_runs_in_virtual_time(user_folder):
    folder = user_folder
    out = folder / "run"
    command = as_nobody(0o600, [*LINKROVER, "demo", "--duration", "5", "--out", str(out)], str(folder))
    environment = {**os.environ, "XDG_RUNTIME_DIR": "", "HOME": str(folder), "COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "sudo chmod 0666 /dev/net/tun" in done.stdout
    assert "virtual time" in done.stdout
    assert all(r.simulated for r in read_recording(out / "robot").records(Manifest))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "1"], "at least 3 s"),
        (["--duration", "nan"], "at least 3 s"),
        (["--case", "eleven"], "no such case; there are 1 (router-2.4)"),
    ],
)
def test_what_cannot_be_run_is_refused_by_name(arguments, words, tmp_path):
    done = subprocess.run([*LINKROVER, "demo", *arguments], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode in (1, 2)
    assert words in re.sub(r"\s+", " ", done.stderr)
    assert list(tmp_path.iterdir()) == []

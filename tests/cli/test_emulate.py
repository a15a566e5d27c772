from __future__ import annotations

import subprocess
import sys
import tempfile

import pytest

from linkrover.bag.reading import read_recording
from linkrover.records import Pose, ProbeResult
from tests.emulator.needs import packets

LINKROVER = [sys.executable, "-m", "linkrover"]


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    with tempfile.TemporaryDirectory(prefix="lr-", dir="/tmp") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield folder


def emulate(*arguments, **more):
    return subprocess.run([*LINKROVER, "emulate", *arguments], capture_output=True, text=True, **more)


@pytest.mark.netns
def test_a_program_runs_behind_the_link_sees_it_and_its_status_is_ours(runtime):
    packets()
    code = (
        "import os, socket, subprocess, sys\n"
        "print(sorted(name for _, name in socket.if_nameindex()), socket.gethostbyname('robot'),"
        " os.environ['LINKROVER_END'])\n"
        "print(open(os.environ['LINKROVER_WIRELESS']).read())\n"
        "sys.exit(subprocess.run([sys.executable, '-m', 'linkrover', 'probe', 'robot', '--count', '5', '--quiet'])"
        ".returncode + 5)\n"
    )
    done = emulate("station-ap-internal-2.4", "--at", "station", "--", sys.executable, "-c", code)
    assert done.returncode == 5, done.stdout + done.stderr
    assert "['lo', 'wlan0'] 10.77.0.2 station" in done.stdout
    assert "wlan0: 0000" in done.stdout
    assert "answered 5" in done.stdout
    assert "station>robot: 5 of 5 packets arrived" in done.stderr


@pytest.mark.netns
def test_two_programs_talk_over_the_link_and_the_other_ends_with_the_first(tmp_path):
    packets()
    server = tmp_path / "server.py"
    server.write_text(
        "import socket\ns = socket.create_server(('10.77.0.1', 7777))\nwhile True:\n    s.accept()[0].sendall(b'ok')\n"
    )
    client = (
        "import socket, time\n"
        "for _ in range(200):\n"
        "    try:\n        print(socket.create_connection(('station', 7777), 5).recv(9)); break\n"
        "    except ConnectionRefusedError: time.sleep(0.05)\n"
    )
    done = emulate("8", "--quiet", "--other", f"{sys.executable} {server}", "--", sys.executable, "-c", client)
    assert done.returncode == 0, done.stderr
    assert "b'ok'" in done.stdout


@pytest.mark.netns
@pytest.mark.parametrize(
    ("command", "status"),
    [
        (["/nonexistent"], 127),
        (["sh", "-c", "kill -9 $$"], 137),
        (["--duration", "1", "--", "sleep", "60"], 0),
    ],
)
def test_how_the_program_ended_is_our_status(command, status):
    packets()
    arguments = command if "--" in command else ["--", *command]
    assert emulate("1", "--quiet", *arguments).returncode == status


@pytest.mark.netns
def test_a_recorded_drive_is_played_back_as_a_link(tmp_path):
    packets()
    first, second = tmp_path / "first", tmp_path / "second"
    code = "import time; time.sleep(4)"
    done = emulate("3", "--traffic", "--out", str(first), "--", sys.executable, "-c", code)
    assert done.returncode == 0, done.stderr
    done = emulate("--replay", str(first), "--out", str(second), "--quiet", "--", sys.executable, "-c", code)
    assert done.returncode == 0, done.stderr
    assert any(isinstance(r, ProbeResult) for r in read_recording(second / "robot").records(ProbeResult))
    assert any(isinstance(r, Pose) for r in read_recording(second / "robot").records(Pose))


@pytest.mark.netns
def test_several_robots_share_the_air():
    packets()
    done = emulate("6", "--robots", "3", "--", "sleep", "3")
    assert done.returncode == 0, done.stderr
    for name in ("robot-2", "robot-3"):
        (line,) = [line for line in done.stderr.splitlines() if f"{name}>station" in line]
        assert int(line.split(":")[2].split()[0]) > 50, line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["3"], "no COMMAND"),
        (["99", "--", "true"], "no such case"),
        (["3", "--distance", "5", "--", "true"], "--trajectory still"),
        (["3", "--trajectory", "still", "--distance", "-1", "--", "true"], "0 to 1000 m"),
        (["3", "--robots", "2", "--", "true"], "the router or the station"),
        (["5", "--robots", "11", "--", "true"], "must be 1 to 10"),
        (["3", "--duration", "0", "--", "true"], "above 0"),
        (["3", "--at", "moon", "--", "true"], "robot"),
        (["--replay", "/nonexistent", "--", "true"], "does not exist"),
    ],
)
def test_what_cannot_be_emulated_is_refused_by_name(arguments, words):
    done = emulate(*arguments)
    assert done.returncode in (1, 2)
    assert words in (done.stderr + done.stdout).replace("\n", " ")

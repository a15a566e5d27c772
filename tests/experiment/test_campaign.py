from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import msgspec
import pytest

from linkrover.agent.config import AgentConfig
from linkrover.bag.reading import read_recording
from linkrover.emulator import enter
from linkrover.emulator.driver import HEADER, wireless_line
from linkrover.emulator.netns import make_host
from linkrover.errors import ConfigError
from linkrover.experiment import control
from linkrover.experiment.campaign import Campaign, faults
from linkrover.experiment.control import (
    Check,
    ControlError,
    ExistsError,
    Fetch,
    Start,
    Started,
    Status,
    Stop,
    Stopped,
    UnreachableError,
    ask,
    load_key,
    seal,
    unseal,
)
from linkrover.experiment.control_server import ControlServer
from linkrover.experiment.plan import parse_plan, trials
from linkrover.records import Manifest, Role
from tests.emulator.needs import packets

KEY = b"0123456789abcdef0123"


@pytest.fixture
def serving(tmp_path):
    """A control port on loopback, for an agent that measures loopback."""
    wireless = tmp_path / "wireless"
    wireless.write_bytes(HEADER + wireless_line("lo", -50))
    config = AgentConfig(
        interfaces=("lo",), role=Role.STATION, record=str(tmp_path / "runs"), wireless_path=str(wireless)
    )
    server = ControlServer(config, KEY, "127.0.0.1", 0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield server
    server.close()
    thread.join()


def request(server, message, key=KEY):
    return ask("127.0.0.1", server.port, key, message)


def start(run="plan/case/trial-1", **more):
    return Start(run=run, case="case", trial=1, interfaces=("lo",), **more)


def test_a_recording_is_started_stopped_read_through_and_fetched_whole(serving, tmp_path):
    before = request(serving, Check(interfaces=("lo", "nothing0")))
    assert isinstance(before, Status)
    assert (before.role, before.recording, before.interfaces["nothing0"]) == ("station", None, "absent")
    assert before.interfaces["lo"] == "up"
    assert before.free_bytes > 0
    assert isinstance(request(serving, start()), Started)
    assert request(serving, Check()).recording == "plan/case/trial-1"
    with pytest.raises(ControlError, match="under way already"):
        request(serving, start("plan/case/trial-2"))
    stopped = request(serving, Stop())
    assert isinstance(stopped, Stopped)
    assert stopped.problems == ()
    assert stopped.topics["/station/linkrover/manifest"] == 1
    directory = tmp_path / "runs" / "plan" / "case" / "trial-1" / "station"
    for name, octets in stopped.files.items():
        data = b""
        while len(data) < octets:
            data += request(serving, Fetch(run=stopped.run, file=name, offset=len(data))).data
        assert data == (directory / name).read_bytes()
    manifest = next(iter(read_recording(directory).records(Manifest)))
    assert (manifest.case, manifest.trial, manifest.run) == ("case", 1, "plan/case/trial-1")
    with pytest.raises(ExistsError, match="not overwritten"):
        request(serving, start())
    with pytest.raises(ControlError, match="nothing is being recorded"):
        request(serving, Stop())


@pytest.mark.parametrize(
    "message",
    [
        start("../../etc"),
        start("/etc/x"),
        start("a/../b"),
        start("a b"),
        start("a/b/c/d/e"),
        Fetch(run="plan", file="../secret", offset=0),
        Fetch(run="..", file="x", offset=0),
        Fetch(run="plan", file="/etc/passwd", offset=0),
    ],
)
def test_no_request_leaves_the_agents_own_folder(serving, tmp_path, message):
    (tmp_path / "runs" / "secret").write_text("x")
    with pytest.raises(ControlError):
        request(serving, message)
    assert sorted(p.name for p in (tmp_path / "runs").iterdir()) == ["secret"]


def test_a_probe_target_is_a_host_and_nothing_else(serving):
    status = request(serving, Check(probe="--help"))
    assert status.probes_sent is None
    assert "no HOST" in status.probe_problem


def test_without_the_key_nothing_is_answered(serving):
    with pytest.raises(ControlError):
        request(serving, Check(), key=b"another key of good length")
    assert serving.refused == 1


def test_a_request_cannot_be_replayed(serving):
    with socket.create_connection(("127.0.0.1", serving.port)) as first:
        hello = msgspec.json.decode(control.read_line(first, 9999, 5), type=control.Hello)
        line = seal(KEY, "ask", hello.nonce, "aa" * 16, Check())
        first.sendall(line)
        assert control.read_line(first, 1_000_000, 10)
    with socket.create_connection(("127.0.0.1", serving.port)) as second:
        control.read_line(second, 9999, 5)
        second.sendall(line)
        assert second.recv(10) == b""
    assert serving.refused == 1


@pytest.mark.parametrize("junk", [b"\n", b"{}\n", b"[" * 9000 + b"\n", os.urandom(2000) + b"\n", b"x" * 20_000])
def test_junk_is_refused_and_the_port_goes_on(serving, junk):
    with socket.create_connection(("127.0.0.1", serving.port)) as handle:
        control.read_line(handle, 9999, 5)
        with contextlib.suppress(OSError):
            handle.sendall(junk)
            assert handle.recv(10) == b""
    assert isinstance(request(serving, Check()), Status)


def test_an_answer_altered_on_the_way_is_not_believed():
    line = seal(KEY, "answer", "s", "c", Started(directory="/a"))
    assert unseal(line, KEY, "answer", "s", control.Answer)[1] == Started(directory="/a")
    for altered in (line.replace(b"/a", b"/b"), line.replace(b'"c"', b'"d"')):
        with pytest.raises(control.ParseError):
            unseal(altered, KEY, "answer", "s", control.Answer)
    with pytest.raises(control.ParseError):
        unseal(line, KEY, "ask", "s", control.Answer)


def test_nobody_there_is_said_with_the_command_to_start():
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(UnreachableError, match="linkrover agent --control"):
        ask("127.0.0.1", port, KEY, Check())


def test_a_short_or_absent_key_is_refused(tmp_path):
    (tmp_path / "key").write_text("short")
    with pytest.raises(ConfigError, match="openssl rand"):
        load_key(tmp_path / "key")
    with pytest.raises(ConfigError, match="cannot read"):
        load_key(tmp_path / "none")
    plan = parse_plan('name = "x"\n[[cases]]\nname = "router-5"\n')
    with pytest.raises(ConfigError, match=r"campaign\.key_file"):
        Campaign(plan, tmp_path, tmp_path)


def test_a_recording_without_what_the_trial_is_about_is_faulty():
    def stopped(*topics, problems=()):
        counts = {f"/robot/wlan0/linkrover/{topic}": 5 for topic in topics}
        return Stopped(run="r", directory="d", problems=problems, seconds=1, topics=counts, files={})

    assert faults("robot", stopped("link_utilization", "wireless_link", "probe_result")) == []
    assert faults("robot", stopped("link_utilization", "station_link", "probe_result")) == []
    assert "probe result" in faults("robot", stopped("link_utilization", "wireless_link"))[0]
    assert "torn" in faults("station", stopped("link_utilization", problems=("torn",)))[0]


@pytest.mark.netns
def test_a_campaign_is_guided_recorded_collected_and_goes_on_where_it_was(tmp_path):
    packets()
    (tmp_path / "campaign.key").write_bytes(KEY)
    (tmp_path / "wireless").write_bytes(HEADER + wireless_line("wlan0", -50))
    (tmp_path / "plan.toml").write_text(
        'name = "lab"\n[[cases]]\nname = "router-5"\n[[cases]]\nname = "robot-ap-internal-5"\n'
        '[campaign]\nrobot = "127.0.0.1:8622"\nstation = "127.0.0.1:8623"\nkey_file = "campaign.key"\n'
    )
    host = make_host("x", "10.77.0.2")
    inside = [sys.executable, enter.__file__, str(host.netns_fd), "--", sys.executable, "-m", "linkrover"]
    ends = [
        subprocess.Popen(
            [*inside, "agent", "--control", "campaign.key", "--role", role, "--record", f"{role}-runs",
             "--control-port", port, "--wireless-path", "wireless"],
            pass_fds=[host.netns_fd], cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        )
        for role, port in (("robot", "8622"), ("station", "8623"))
    ]  # fmt: skip

    def run(*more, **options):
        command = [*inside, "experiment", "run", "plan.toml", *more]
        return subprocess.run(
            command, pass_fds=[host.netns_fd], cwd=tmp_path, capture_output=True, text=True, timeout=100, **options
        )

    try:
        for end in ends:
            assert "control port" in end.stderr.readline()
        # as an operator would: Enter checks, Enter starts, Enter ends the drive, and q leaves at the second case
        by_hand = run(input="\n\n\nq\n")
        assert "Missing: robot-ap-internal-5/trial-1" in by_hand.stdout.replace("\n", " "), by_hand.stdout
        rest = run("--duration", "2", "--yes")
        assert rest.returncode == 0, rest.stdout + rest.stderr
        assert "router-5, trial" not in rest.stdout
        assert "answers probes: 20 of 20" in rest.stdout
        nothing = run("--duration", "2", "--yes")
        assert nothing.returncode == 0
    finally:
        for end in ends:
            end.terminate()
            end.stderr.close()
            end.wait(30)
        host.close()
    plan = parse_plan((tmp_path / "plan.toml").read_text())
    for trial in trials(plan):
        folder = tmp_path / "lab-campaign" / trial.folder
        assert json.loads((folder / "campaign.json").read_text())["problems"] == []
        for role in ("robot", "station"):
            assert read_recording(folder / role).problems == ()
            original = tmp_path / f"{role}-runs" / "lab" / trial.folder / role / f"{role}.mcap"
            assert (folder / role / f"{role}.mcap").read_bytes() == original.read_bytes()
    assert Path(tmp_path / "lab-campaign" / "report.html").exists()

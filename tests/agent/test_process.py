from __future__ import annotations

import os
import pty
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from linkrover.agent import Agent, AgentConfig, FeedSender, Reflector
from linkrover.bag.recorder import recover
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.records import Pose, Unknown
from tests.namespace import Namespace, joined

from .running import RunningAgent

PORT = str(DEFAULT_PORT)


@pytest.fixture(scope="module")
def pair():
    one, two = joined()
    yield one, two
    one.close()
    two.close()


def messages(path: Path):
    """(topic, log time) of every message of a finished recording."""
    with path.open("rb") as file:
        return [(channel.topic, message.log_time) for _, channel, message in make_reader(file).iter_messages()]


def test_two_ends_measure_record_and_end_together(pair, tmp_path):
    robot_space, station_space = pair
    wireless = tmp_path / "wireless"
    wireless.write_text(
        "Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE\n"
        " face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22\n"
        "    v0: 0000   38.  -72.  -256        0      0      0      0      8        0\n"
    )
    run = tmp_path / "run"
    station_args = ["--interface", "v0", "--role", "station", "--reflect", "--record", str(run)]
    robot_args = ["--interface", "v0", "--peer", "10.9.0.2", "--record", str(run), "--wireless-path", str(wireless),
                  "--case", "3", "--trial", "1", "--duration", "2.5"]  # fmt: skip
    with RunningAgent(station_args, station_space) as station:
        station.wait_for("LinkUtilization")
        with RunningAgent(robot_args, robot_space) as robot:
            assert robot.end() == 0, robot.errors
        assert station.end(signal.SIGTERM) == 0, station.errors
    manifest = robot.records[0]
    assert (manifest["type"], manifest["role"], manifest["case"], manifest["trial"]) == ("Manifest", "robot", "3", 1)
    assert manifest["interfaces"][0]["driver"] == "veth"
    delays = robot.of("NetworkDelay", method="stamp", iface="v0")
    assert len(delays) >= 10
    assert sum(delay["alive"] for delay in delays) >= len(delays) - 1
    assert {link["rssi_dbm"] for link in robot.of("WirelessLink")} == {-72.0}
    assert len(robot.of("WirelessLink")) >= 10
    offsets = robot.of("ClockOffset")
    assert offsets
    # one machine, one clock
    assert all(abs(offset["offset_ns"]) <= offset["error_bound_ns"] for offset in offsets)
    for end, least in (("robot", 10), ("station", 0)):
        topics = [topic for topic, _ in messages(run / end / f"{end}.mcap")]
        assert topics.count(f"/{end}/linkrover/network_delay") >= least
        assert f"/{end}/v0/linkrover/link_utilization" in topics
        assert (run / end / "metadata.yaml").exists()
    again = RunningAgent(["--interface", "v0", "--record", str(run)], robot_space)
    assert again.end() == 1
    assert "holds a recording already" in again.errors


@pytest.mark.parametrize(
    ("number", "duration", "status"),
    [(signal.SIGINT, [], 0), (signal.SIGTERM, [], 0), (signal.SIGINT, ["--duration", "60"], 130)],
)
def test_signals_end_it_cleanly_with_a_finished_recording(tmp_path, number, duration, status):
    with RunningAgent(["--interface", "lo", "--record", str(tmp_path), *duration]) as agent:
        agent.wait_for("LinkUtilization")
        assert agent.end(number) == status, agent.errors
    recorded = messages(tmp_path / "robot" / "robot.mcap")
    assert recorded
    assert not list(tmp_path.glob("robot/*.journal"))
    assert "Traceback" not in agent.errors


def test_a_killed_agent_loses_at_most_the_last_second(tmp_path):
    with RunningAgent(["--interface", "lo", "--record", str(tmp_path), "--utilization-rate", "20"]) as agent:
        agent.wait_for("LinkUtilization", 40)
        killed_ns = time.time_ns()
        agent.end(signal.SIGKILL)
    recover(tmp_path / "robot")
    last_ns = max(at for _, at in messages(tmp_path / "robot" / "robot.mcap"))
    # a second, and another for the writer's turn on a busy machine
    assert killed_ns - last_ns < 2_000_000_000
    assert last_ns > killed_ns - 2_000_000_000


def test_a_peer_that_goes_away_is_an_outage_and_measuring_goes_on(pair):
    robot_space, station_space = pair
    station_args = ["--interface", "v0", "--role", "station", "--reflect"]
    with RunningAgent(station_args, station_space) as station:
        station.wait_for("LinkUtilization")
        with RunningAgent(["--interface", "v0", "--peer", f"10.9.0.2:{PORT}"], robot_space) as robot:
            robot.wait_for("NetworkDelay", 5, alive=True)
            station.end(signal.SIGKILL)
            (began,) = robot.wait_for("LinkEvent", kind="outage began")
            samples = len(robot.of("LinkUtilization"))
            lost = robot.wait_for("NetworkDelay", 3, alive=False)
            assert {(delay["delay_ns"], delay["unknown"]["delay_ns"]) for delay in lost} <= {
                (None, "timed out"),
                (None, "not connected"),
            }
            robot.wait_for("LinkUtilization", samples + 2)
            with RunningAgent(station_args, station_space) as returned:
                (ended,) = robot.wait_for("LinkEvent", kind="outage ended")
                assert ended["gap_ns"] == ended["mono_ns"] - began["mono_ns"] > 1_000_000_000
                returned.end(signal.SIGTERM)
            assert robot.end(signal.SIGTERM) == 0, robot.errors


def test_an_interface_may_come_go_and_be_renamed_while_measuring():
    space = Namespace()
    with RunningAgent(["--interface", "w0", "--utilization-rate", "10"], space) as refused:
        assert refused.end() == 2
        assert "no interface 'w0' here; there are: lo" in refused.errors
    arguments = ["--interface", "w0", "--wait", "--utilization-rate", "10"]
    with RunningAgent(arguments, space) as agent:
        agent.wait_for("LinkUtilization", 2, continuity="gone")
        space.ip("link add w0 type veth peer name w1")
        agent.wait_for("LinkEvent", kind="interface back")
        agent.wait_for("LinkUtilization", 2, continuity="steady")
        space.ip("link set w0 name z0")
        agent.wait_for("LinkEvent", kind="interface renamed")
        steady = len(agent.of("LinkUtilization", continuity="steady"))
        agent.wait_for("LinkUtilization", steady + 3, continuity="steady")
        space.ip("link delete z0")
        agent.wait_for("LinkEvent", kind="interface gone")
        space.ip("link add w0 type veth peer name w1")
        agent.wait_for("LinkUtilization", continuity="back")
        assert agent.end(signal.SIGTERM) == 0, agent.errors
    assert {record["iface"] for record in agent.of("LinkUtilization")} == {"w0"}
    space.close()


def test_what_a_robots_software_hands_in_is_recorded(tmp_path):
    feed = tmp_path / "feed"
    with RunningAgent(["--feed", str(feed), "--record", str(tmp_path / "run")]) as agent:
        agent.wait_for("SelfAccount")
        sender = FeedSender(str(feed))
        for n in range(50):
            sender.send(Pose(wall_ns=time.time_ns(), mono_ns=time.monotonic_ns(), x_m=n, y_m=0, heading_rad=0))
        agent.wait_until(sender.flush, bool, "room in the feed")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
            sock.sendto(b'{"type": "Posse"}', str(feed))
        agent.wait_for("Pose", 50)
        assert agent.end(signal.SIGTERM) == 0, agent.errors
    assert "expected one of Pose" in agent.errors
    topics = [topic for topic, _ in messages(tmp_path / "run" / "robot" / "robot.mcap")]
    assert topics.count("/robot/linkrover/pose") == 50
    assert topics.count("/robot/odom") == 50
    assert not feed.exists()


def test_a_full_disk_is_said_and_measuring_goes_on(tmp_path):
    if os.geteuid() != 0:
        pytest.skip("needs root, to mount a small disk")
    disk = tmp_path / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", str(disk)], check=True)
    try:
        arguments = ["--interface", "lo", "--record", str(disk), "--utilization-rate", "300", "--errors-rate", "300"]
        with RunningAgent(arguments) as agent:
            (event,) = agent.wait_for("LinkEvent", kind="recording")
            assert "disk is full" in event["detail"]
            samples = len(agent.of("LinkUtilization"))
            agent.wait_for("LinkUtilization", samples + 100)
            agent.wait_until(lambda: agent.of("SelfAccount"), lambda found: found[-1]["records_lost"] > 0, "lost count")
            assert agent.end(signal.SIGTERM) == 1
        assert "records could not be written" in agent.errors
        assert list(disk.glob("robot/*"))
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_start_that_is_refused_leaves_nothing_behind(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        port = str(taken.getsockname()[1])
        arguments = ["--interface", "lo", "--feed", str(tmp_path / "feed"), "--record", str(tmp_path / "run")]
        with RunningAgent([*arguments, "--reflect", "--port", port]) as agent:
            assert agent.end() == 2
            assert "is taken" in agent.errors
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run" / "robot").mkdir(parents=True)
    (tmp_path / "run" / "robot" / "robot.mcap").write_bytes(b"precious")
    with RunningAgent(arguments) as agent:
        assert agent.end() == 1
    assert not (tmp_path / "feed").exists()
    assert (tmp_path / "run" / "robot" / "robot.mcap").read_bytes() == b"precious"


def test_a_reader_that_goes_away_ends_it_cleanly():
    command = f"{sys.executable} -m linkrover agent --json --interface lo --utilization-rate 50 | head -n 3"
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {command}"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 3
    assert "Traceback" not in done.stderr


def test_a_reader_that_does_not_read_holds_nothing_up(tmp_path):
    """As a terminal stopped with Ctrl-S."""
    arguments = ["agent", "--json", "--interface", "lo", "--utilization-rate", "500", "--record", str(tmp_path)]
    process = subprocess.Popen([sys.executable, "-m", "linkrover", *arguments], stdout=subprocess.PIPE)
    try:
        journal = tmp_path / "robot" / "robot.mcap.journal"
        deadline = time.monotonic() + 30
        # far more than a pipe holds
        while not (journal.exists() and journal.stat().st_size > 150_000):
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    finally:
        process.kill()
        assert process.stdout is not None
        process.stdout.close()
    assert (tmp_path / "robot" / "robot.mcap").exists()


def test_a_lost_terminal_does_not_end_a_recording(tmp_path):
    """A session over the link under test is lost in every outage."""
    main, terminal = pty.openpty()
    command = [sys.executable, "-m", "linkrover", "agent", "--interface", "lo", "--record", str(tmp_path)]
    process = subprocess.Popen(command, stdout=terminal, stderr=terminal, env={**os.environ, "TERM": "xterm"})
    os.close(terminal)
    os.read(main, 10)
    journal = tmp_path / "robot" / "robot.mcap.journal"
    try:
        process.send_signal(signal.SIGHUP)
        os.close(main)
        size = journal.stat().st_size
        deadline = time.monotonic() + 30
        while journal.stat().st_size < size + 2000:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait()
    assert (tmp_path / "robot" / "robot.mcap").exists()


def test_an_ordinary_user_may_measure():
    if os.geteuid() != 0:
        pytest.skip("is one already: needs root, to become one")
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            status = 0 if measured_without_privileges() else 2
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def measured_without_privileges():
    class Kept(list):
        take = list.append

        def close(self):
            pass

    kept = Kept()
    config = AgentConfig(interfaces=("lo",), duration_s=0.4, reflect=True, reflector=Reflector(port=0))
    Agent(config, sinks=[kept]).run()
    # Whose another user's TCP connection is, an ordinary user may not know; everything else he may.
    refused = [r for r in kept if {k for k, v in r.unknown.items() if v is Unknown.NOT_PERMITTED} - {"process"}]
    kinds = {type(record).__name__ for record in kept}
    return not refused and {"LinkUtilization", "NetworkErrors", "SelfAccount"} <= kinds


def test_plain_log_lines_without_a_terminal():
    command = [sys.executable, "-m", "linkrover", "agent", "--interface", "lo", "--duration", "1.5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert "lo  rx " in done.stdout
    assert "% CPU" in done.stdout
    assert "\x1b" not in done.stdout

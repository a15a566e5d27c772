"""`linkrover ros2` as a user starts it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from linkrover.bag import read_recording
from linkrover.records import LinkUtilization, Manifest, NetworkDelay, NetworkErrors, Pose, VelocityCommand
from tests.middleware.contract import ODOMETRY, ROOT, TWIST, Driver

LINKROVER = [sys.executable, "-m", "linkrover", "ros2"]
FACTORY = "tests.ros2.test_contract:started"


class Program:
    def __init__(self, log: Path, environment: dict[str, str], *arguments: str) -> None:
        self.log_file = log
        with log.open("w") as file:
            self.process = subprocess.Popen(
                [*LINKROVER, *arguments], env=environment, cwd=ROOT, stdout=file, stderr=file
            )

    def log(self) -> str:
        return self.log_file.read_text()

    def wait_for(self, text: str, timeout_s: float = 40) -> None:
        until = time.monotonic() + timeout_s
        while text not in self.log():
            assert time.monotonic() < until, f"waited for '{text}': {self.log()}"
            assert self.process.poll() is None, self.log()
            time.sleep(0.05)

    def interrupt(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(30)


Begin = Callable[..., Program]


@pytest.fixture
def begin(environment: dict[str, str], tmp_path: Path) -> Iterator[Begin]:
    running: list[Program] = []

    def start(*arguments: str) -> Program:
        running.append(Program(tmp_path / f"{len(running)}.log", environment, *arguments))
        return running[-1]

    yield start
    for program in running:
        if program.process.poll() is None:
            program.process.kill()
        program.process.wait()


def run(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*LINKROVER, *arguments], env=environment, capture_output=True, text=True, timeout=60, cwd=ROOT
    )


def records(path: Path, kind: type[Any]) -> list[Any]:
    return list(read_recording(path).records(kind))


def test_client_and_server_measure_both_ways_and_record(
    begin: Begin, environment: dict[str, str], drivers: list[Driver], tmp_path: Path
) -> None:
    for topic, kind, fields in (("odom", "nav_msgs/Odometry", ODOMETRY), ("cmd_vel", "geometry_msgs/Twist", TWIST)):
        drivers.append(Driver(environment, FACTORY, "publish", topic, kind, json.dumps(fields), 20, 60))
    common = ["-i", "iface1=lo", "--record", str(tmp_path / "run"), "--delay-rate", "20"]
    server = begin("server", *common, "--reflect", "0", "--ping", "PingRobot")
    client = begin(
        "client", *common, "--answer", "PingRobot", "--reflect", "18633", "--odom", "odom", "--cmd-vel", "cmd_vel"
    )
    server.wait_for("has a STAMP reflector: probing 127.0.0.1:18633 beside it")
    client.wait_for("a ping server answers on '/Ping'")
    drivers.append(Driver(environment, FACTORY, "graph"))
    graph = drivers[-1].said("graph")
    time.sleep(2.0)
    assert (client.interrupt(), server.interrupt()) == (0, 0), client.log() + server.log()

    topics = {t["name"]: t for t in graph["topics"]}
    assert topics["/robot/iface1/network_analysis/network_errors"]["type_name"] == "network_analysis/msg/NetworkErrors"
    assert topics["/station/network_analysis/network_delay"]["publishers"] == ["/linkrover_server"]
    assert topics["/diagnostics"]["type_name"] == "diagnostic_msgs/msg/DiagnosticArray"
    assert topics["/odom"]["subscribers"] == ["/linkrover_client"]

    robot, station = tmp_path / "run/robot", tmp_path / "run/station"
    for path in (robot, station):
        pings = [r for r in records(path, NetworkDelay) if r.method == "ros2 topic"]
        assert sum(r.alive for r in pings) >= 10
        assert len({r.sequence for r in pings}) == len(pings)
        assert records(path, LinkUtilization)
        assert records(path, NetworkErrors)
        assert "ros2 cyclonedds" in str(records(path, Manifest)[0].middleware)
    beside = [r for r in records(station, NetworkDelay) if r.method == "ros2 topic" and r.middleware_ns is not None]
    assert beside
    assert all(r.peer == "127.0.0.1" and r.middleware_ns < r.delay_ns for r in beside[-3:])
    assert {p.x_m for p in records(robot, Pose)} == {1.5}
    assert {c.turn_rad_per_s for c in records(robot, VelocityCommand)} == {-1.5}


def test_published_records_arrive_as_the_messages_of_2021(
    begin: Begin, environment: dict[str, str], drivers: list[Driver]
) -> None:
    from linkrover.ros2.endpoints import Subscription
    from linkrover.ros2.network import read_network
    from linkrover.ros2.node import Ros2

    begin("client", "-i", "lo", "--prefix", "", "--ping", "", "--utilization-rate", "10", "__ns:=/r1")
    node = Ros2("listener", network=read_network(environment=environment))
    node.start()
    got: list[tuple[str, dict[str, Any]]] = []
    try:
        assert node.wait_joined(20)
        assert node._participant is not None
        subscription = Subscription(
            node._participant,
            "rt/r1/network_analysis/link_utilization",
            ("network_analysis/LinkUtilization",),
            lambda kind, message, _: got.append((kind, message)),
        )
        until = time.monotonic() + 40
        while len(got) < 2 and time.monotonic() < until:
            time.sleep(0.05)
        subscription.close()
    finally:
        node.close()
    first, second = got[0][1], got[1][1]
    assert first["iface"] == "lo"
    assert second["header"]["stamp"] != first["header"]["stamp"]
    assert second["total_rx_bytes"] >= first["total_rx_bytes"]


def test_help_teaches(environment: dict[str, str]) -> None:
    told = run(environment, "client", "--help").stdout
    assert "--interface" in told
    assert "--dds-peer" in told
    assert "linkrover ros2 client --interface wlan0 --odom /odom" in told


@pytest.mark.parametrize(
    ("arguments", "variables", "code", "said"),
    [
        (("client", "nonsense"), {}, 2, "'nonsense' is no remapping"),
        (("ping-server",), {"CYCLONEDDS_URI": "<a>"}, 2, "not well-formed XML"),
        (("client", "-i", "lo", "--odom", "a-b", "--duration", "1"), {}, 2, "'/a-b' cannot be a ROS 2 name"),
    ],
)
def test_wrong_words_are_refused(
    environment: dict[str, str], arguments: tuple[str, ...], variables: dict[str, str], code: int, said: str
) -> None:
    done = run({**environment, **variables}, *arguments)
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr


def test_without_the_extra_it_says_what_to_install(environment: dict[str, str]) -> None:
    script = "import sys; sys.modules['cyclonedds'] = None; from linkrover.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", script, "ros2", "ping-server"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "pip install 'linkrover[ros2]'" in done.stderr


def test_an_interface_that_is_not_there_costs_topics_not_the_recording(
    environment: dict[str, str], tmp_path: Path
) -> None:
    told = {**environment, "CYCLONEDDS_URI": ABSENT}
    done = run(
        told, "client", "-i", "lo", "--record", str(tmp_path / "run"), "--duration", "2", "--utilization-rate", "10"
    )
    assert done.returncode == 0, done.stderr
    assert "no interface absent0 here" in done.stderr
    assert len(records(tmp_path / "run/robot", LinkUtilization)) >= 5
    assert all(r.unknown for r in records(tmp_path / "run/robot", NetworkDelay))


ABSENT = '<General><Interfaces><NetworkInterface name="absent0"/></Interfaces></General>'

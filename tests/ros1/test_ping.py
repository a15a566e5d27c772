"""The ping action against actionlib's own C++ ends, two servers under one name, and goals that go stale."""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from tests.middleware.contract import Driver

from .conftest import LINKROVER, Master, Programs, state, wait_for

FACTORY = "tests.ros1.test_contract:started"


def ping(master: Master, drivers: list[Driver], *arguments: object) -> list[dict[str, object]]:
    driver = Driver(master.environment(), FACTORY, "ping", *arguments)
    drivers.append(driver)
    return driver.finish()[0]


def test_our_client_and_the_cpp_server(
    master: Master, programs: Programs, drivers: list[Driver], cpp_peers: Path
) -> None:
    programs.start([str(cpp_peers / "ping_server")], master.environment())
    lines = ping(master, drivers, "Ping", 30, 50, 2000, "connected")
    counts = lines[-1]
    assert counts["answered"] >= 20  # type: ignore[operator]
    assert (counts["late"], counts["duplicates"]) == (0, 0)


def test_our_client_gets_an_answer_to_every_goal_of_a_burst_from_the_cpp_server(
    master: Master, programs: Programs, drivers: list[Driver], cpp_peers: Path
) -> None:
    # a simple action server recalls goals that come faster than it takes them up: the round trip was made all the same
    programs.start([str(cpp_peers / "ping_server")], master.environment())
    lines = ping(master, drivers, "Ping", 300, 1, 2000, "connected")
    answered = [x for x in lines if x["kind"] == "delay" and x["alive"]]
    lost = [x for x in lines if x["kind"] == "delay" and x["unknown"] == {"delay_ns": "timed out"}]
    assert len(answered) >= 100
    assert len(lost) <= len(answered) // 20


@pytest.mark.parametrize("server", ["linkrover", "rosrun"])
def test_the_cpp_client_and_our_server(master: Master, programs: Programs, cpp_peers: Path, server: str) -> None:
    command = {
        "linkrover": [*LINKROVER, "ros1", "ping-server", "--reflect", "0"],
        "rosrun": ["rosrun", "network_analysis", "pingactionserver", "_reflect:=0"],
    }[server]
    programs.start(command, master.environment())
    told = subprocess.run(
        [str(cpp_peers / "ping_client"), "30", "10"],
        env=master.environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert told.returncode == 0, told.stderr
    states = [line.split()[0] for line in told.stdout.splitlines()]
    assert states == ["SUCCEEDED"] * 30
    assert statistics.median(float(line.split()[1]) for line in told.stdout.splitlines()) < 2000


PYTHON_CLIENT = """
import actionlib, rospy
from linkrover.ros1.types import message_class
rospy.init_node("python_client")
client = actionlib.SimpleActionClient("Ping", message_class("network_analysis/PingAction"))
assert client.wait_for_server(rospy.Duration(20))
for _ in range(10):
    client.send_goal(message_class("network_analysis/PingGoal")(inp=True))
    assert client.wait_for_result(rospy.Duration(5))
    print(client.get_state(), client.get_result().outp)
"""


def test_actionlibs_python_client_and_our_server(master: Master, programs: Programs) -> None:
    programs.start([*LINKROVER, "ros1", "ping-server", "--reflect", "0"], master.environment())
    told = subprocess.run(
        [sys.executable, "-c", PYTHON_CLIENT], env=master.environment(), capture_output=True, text=True, timeout=60
    )
    assert told.stdout.splitlines() == ["3 True"] * 10, told.stderr


def test_two_servers_under_one_name_are_warned_of_and_answers_count_once(
    master: Master, programs: Programs, drivers: list[Driver]
) -> None:
    command = [*LINKROVER, "ros1", "ping-server", "--reflect", "0"]
    first = programs.start(command, master.environment())
    wait_for(lambda: "joined" in programs.log(first), "the first server joins")
    second = programs.start(command, master.environment())
    wait_for(lambda: "answers of two servers mix" in programs.log(second), "the second server warns")
    assert "is running already: this one is called pingactionserver_2" in programs.log(second)
    lines = ping(master, drivers, "Ping", 20, 50, 1000, "connected")
    counts = lines[-1]
    assert counts["answered"] >= 15  # type: ignore[operator]
    assert counts["duplicates"] > 0  # type: ignore[operator]
    assert first.poll() is None, "the first server must not be thrown out"


def test_a_stopped_server_makes_pings_lost_then_late_and_they_are_cancelled(
    master: Master, programs: Programs, drivers: list[Driver]
) -> None:
    server = programs.start([*LINKROVER, "ros1", "ping-server", "--reflect", "0"], master.environment())
    wait_for(lambda: "joined" in programs.log(server), "the server joins")
    cancels = programs.start(["rostopic", "echo", "-p", "/Ping/cancel"], master.environment())
    wait_for(lambda: "/rostopic" in str(state(master)), "rostopic listens")
    driver = Driver(master.environment(), FACTORY, "ping", "Ping", 60, 50, 300, "connected")
    drivers.append(driver)
    assert driver.said("delay")["alive"]
    server.send_signal(19)  # SIGSTOP: as an outage, connections stay
    while driver.said("delay")["alive"]:
        pass
    server.send_signal(18)  # SIGCONT
    late = driver.said("delay")
    while not late["late"]:
        late = driver.said("delay")
    assert late["delay_ns"] > 300_000_000
    assert late["method"] == "ros1 action late"
    wait_for(lambda: "driver_ping" in programs.log(cancels), "stale goals are cancelled")

"""The nodes as a user starts them: names, parameters, topics, diagnostics, launch files."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.middleware.contract import ROOT

from .conftest import LINKROVER, Master, Programs, state, wait_for

PLAY = [sys.executable, "-m", "tests.ros1.play"]


def topics(master: Master) -> list[str]:
    return sorted({name for part in state(master)[:2] for name, _ in part})


def messages(master: Master, topic: str, type_name: str, count: int = 1) -> list[dict[str, Any]]:
    told = subprocess.run(
        [*PLAY, "listen", topic, type_name, str(count)],
        env=master.environment(),
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    return [json.loads(line) for line in told.stdout.splitlines()]


def message_where(
    master: Master, topic: str, type_name: str, right: Callable[[dict[str, Any]], bool]
) -> dict[str, Any]:
    for _ in range(20):
        for found in messages(master, topic, type_name, 1):
            if right(found):
                return found
    raise AssertionError(f"no such message on {topic}")


def has(master: Master, *wanted: str) -> Callable[[], bool]:
    return lambda: set(wanted) <= set(topics(master))


def test_rosrun_starts_a_published_node_with_its_published_topic(master: Master, programs: Programs) -> None:
    node = "link_utilization"
    programs.start(
        ["rosrun", "network_analysis", f"{node}.py", "_INTERFACE_NAME:=lo", f"_update_rate_{node}:=5"],
        master.environment(),
    )
    wait_for(has(master, f"/network_analysis/{node}"), "the topic of 2021")
    first, second = messages(master, f"/network_analysis/{node}", "network_analysis/LinkUtilization", 2)
    assert first["iface"] == "lo"
    assert 0.1e9 < second["header"]["stamp"] - first["header"]["stamp"] < 0.6e9
    assert not any("network_delay" in topic for topic in topics(master))


def test_public_parameters_are_read_where_no_private_one_is_set(master: Master, programs: Programs) -> None:
    environment = master.environment()
    for name, value in (("INTERFACE_NAME", "lo"), ("update_rate_network_errors", "4")):
        subprocess.run(["rosparam", "set", f"/{name}", value], env=environment, check=True)
    programs.start(["rosrun", "network_analysis", "network_errors", "__ns:=/robot/iface1"], environment)
    wait_for(has(master, "/robot/iface1/network_analysis/network_errors"), "the topic in its namespace")


def test_a_parameter_that_makes_no_sense_is_named(master: Master) -> None:
    told = subprocess.run(
        ["rosrun", "network_analysis", "link_utilization", "_update_rate_link_utilization:=often"],
        env=master.environment(),
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert told.returncode == 1
    assert "update_rate_link_utilization = 'often'" in told.stderr


def test_remapping_a_topic_works_as_users_know_it(master: Master, programs: Programs) -> None:
    programs.start(
        ["rosrun", "network_analysis", "link_utilization", "_INTERFACE_NAME:=lo",
         "/network_analysis/link_utilization:=/node1/network_analysis/link_utilization"],
        master.environment(),
    )  # fmt: skip
    wait_for(has(master, "/node1/network_analysis/link_utilization"), "the remapped topic")


def test_client_and_server_measure_both_ways_beside_each_other(
    master: Master, programs: Programs, tmp_path: Path
) -> None:
    environment = master.environment()
    common = ["-i", "iface1=lo", "--record", str(tmp_path / "run"), "--delay-rate", "5"]
    programs.start([*LINKROVER, "ros1", "server", *common, "--reflect", "18621", "--ping", "PingRobot"], environment)
    client = programs.start(
        [*LINKROVER, "ros1", "client", *common, "--answer", "PingRobot", "--reflect", "18622"], environment
    )
    delay = message_where(
        master, "/robot/network_analysis/network_delay", "network_analysis/NetworkDelay", lambda m: m["alive"]
    )
    assert 0 < delay["delay"] < 2000
    assert delay["iface"] == "lo"
    back = message_where(
        master, "/station/network_analysis/network_delay", "network_analysis/NetworkDelay", lambda m: m["alive"]
    )
    assert 0 < back["delay"] < 2000
    wait_for(lambda: "probing 127.0.0.1:18621 beside it" in programs.log(client), "the reflector is found")
    full = message_where(
        master,
        "/robot/linkrover/network_delay",
        "linkrover_msgs/NetworkDelay",
        lambda m: m["method"] == "ros1 action" and m["middleware_ns"] == m["middleware_ns"] and m["alive"],
    )
    assert full["peer"] == "127.0.0.1"
    assert full["middleware_ns"] < full["delay_ns"]
    combined = message_where(
        master,
        "/robot/network_analysis/network_analysis",
        "network_analysis/NetworkAnalysis",
        lambda m: bool(m["delay"] and m["utilization"] and m["errors"]),
    )
    assert combined["utilization"][0]["iface"] == "lo"
    diagnostics = message_where(
        master,
        "/diagnostics",
        "diagnostic_msgs/DiagnosticArray",
        lambda m: any("delay, ros1 action" in s["name"] for s in m["status"]),
    )
    names = [s["name"] for s in diagnostics["status"]]
    assert any(n in ("linkrover/robot: lo traffic", "linkrover/station: lo traffic") for n in names)
    assert {"/robot/iface1/network_analysis/link_utilization", "/station/iface1/linkrover/network_errors"} <= set(
        topics(master)
    )
    assert programs.interrupt(client) == 0


def test_odometry_velocity_and_path_reach_topics_and_recording(
    master: Master, programs: Programs, tmp_path: Path
) -> None:
    from linkrover.bag import read_recording
    from linkrover.records import Pose, VelocityCommand

    environment = master.environment()
    for what in ("odometry", "command"):
        programs.start([*PLAY, what, "50"], environment)
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--odom", "/odom", "--cmd-vel", "/cmd_vel", "--record",
         str(tmp_path / "run")],
        environment,
    )  # fmt: skip
    path = message_where(
        master, "/robot/linkrover/path", "visualization_msgs/MarkerArray", lambda m: len(m["markers"]) >= 4
    )
    assert {m["ns"] for m in path["markers"]} == {"rssi", "delay", "outage", "now"}
    assert programs.interrupt(client) == 0
    poses = list(read_recording(tmp_path / "run/robot").records(Pose))
    commands = list(read_recording(tmp_path / "run/robot").records(VelocityCommand))
    assert len(poses) > 10
    assert all(abs((p.x_m**2 + p.y_m**2) ** 0.5 - 2) < 1e-6 for p in poses if isinstance(p, Pose))
    assert {c.forward_m_per_s for c in commands if isinstance(c, VelocityCommand)} == {0.5}


def test_the_pose_comes_from_transforms_where_there_is_no_odometry(
    master: Master, programs: Programs, tmp_path: Path
) -> None:
    from linkrover.bag import read_recording
    from linkrover.records import Pose

    programs.start([*PLAY, "transforms", "50"], master.environment())
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--frame", "map", "--record", str(tmp_path / "run")],
        master.environment(),
    )
    wait_for(lambda: "/robot/linkrover/pose" in topics(master), "a pose")
    assert programs.interrupt(client) == 0
    poses = [p for p in read_recording(tmp_path / "run/robot").records(Pose) if isinstance(p, Pose)]
    assert poses
    assert all(p.x_m >= 10.0 and p.frame == "map" for p in poses)


LAUNCHES = (
    ("Client.launch", ["interface_name:=lo", "node_name:=r1"], "/r1/network_analysis/link_utilization"),
    ("Server.launch", ["interface_name:=lo"], "/server/network_analysis/network_errors"),
    ("Server-ping-only.launch", [], "/linkrover/manifest"),
    ("BothWays.launch", ["end:=robot", "interface1:=lo", "interface2:=nope0", "reflect:=18627"],
     "/robot/iface1/network_analysis/link_utilization"),
    ("BothWays.launch", ["end:=server", "interface1:=lo", "interface2:=nope0", "reflect:=18628"],
     "/server/iface1/network_analysis/link_utilization"),
)  # fmt: skip


def test_all_launch_files_start_and_live_beside_each_other_on_one_master(master: Master, programs: Programs) -> None:
    running = []
    for file, arguments, _ in LAUNCHES:
        command = ["roslaunch", "network_analysis", file, *arguments]
        running.append(programs.start(command, master.environment()))
        if len(running) == 1:
            wait_for(lambda: "started with pid" in programs.log(running[0]), "the first launch has set the run_id")
    try:
        wait_for(has(master, *(wanted for _, _, wanted in LAUNCHES)), "all topics", 25)
    except AssertionError:
        print(topics(master), *(programs.log(launch)[-800:] for launch in running), sep="\n")
        raise
    assert all("process has died" not in programs.log(launch) for launch in running)
    for launch in running:
        launch.send_signal(2)


def test_client_and_server_launched_twice_on_one_master_all_live(master: Master, programs: Programs) -> None:
    command = ["rosrun", "network_analysis", "client", "_INTERFACE_NAME:=lo"]
    first = programs.start(command, master.environment())
    wait_for(lambda: "joined" in programs.log(first), "the first joins")
    second = programs.start([*command, "_prefix:=other"], master.environment())
    wait_for(lambda: "joined" in programs.log(second), "the second joins")
    wait_for(has(master, "/robot/lo/linkrover/network_errors", "/other/linkrover/network_errors"), "both publish")
    assert first.poll() is None
    assert second.poll() is None


def test_help_teaches_and_wrong_words_are_refused() -> None:
    told = subprocess.run([*LINKROVER, "ros1", "client", "--help"], capture_output=True, text=True)
    assert "--interface" in told.stdout
    wrong = subprocess.run([*LINKROVER, "ros1", "client", "nonsense"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert "no remapping" in wrong.stderr

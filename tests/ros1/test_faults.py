"""What goes wrong on a real robot: a word on the log, and the recording goes on."""

from __future__ import annotations

import itertools
import signal
import subprocess
import time
from pathlib import Path

import pytest

from linkrover.bag import read_recording
from linkrover.records import LinkUtilization, NetworkDelay

from .conftest import LINKROVER, Master, Programs, wait_for
from .test_nodes import PLAY, has, messages

TOPIC = "/robot/lo/network_analysis/link_utilization"


def largest_gap_s(recording: Path) -> float:
    times = sorted(r.mono_ns for r in read_recording(recording).records(LinkUtilization))
    assert len(times) > 3
    return max(b - a for a, b in itertools.pairwise(times)) / 1e9


def test_master_away_hung_and_restarted_costs_no_sample_and_topics_resume(tmp_path: Path, programs: Programs) -> None:
    master = Master(tmp_path / "ros_home")
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--record", str(tmp_path / "run"), "--utilization-rate", "10"],
        master.environment(),
    )
    try:
        wait_for(lambda: "no ROS master yet" in programs.log(client), "it says that the master is away")
        time.sleep(0.5)
        master.start()
        wait_for(has(master, TOPIC), "it joins when the master comes")
        assert master.process is not None
        master.process.send_signal(signal.SIGSTOP)
        wait_for(lambda: "the ROS master is not reachable" in programs.log(client), "it notices the hung master")
        master.process.send_signal(signal.SIGCONT)
        wait_for(lambda: "reachable again" in programs.log(client), "it notices its return")
        master.stop()
        master.start()
        wait_for(lambda: "registering again" in programs.log(client), "it notices that it was forgotten")
        wait_for(has(master, TOPIC, "/Ping/goal"), "topics are back")
        assert messages(master, TOPIC, "network_analysis/LinkUtilization", 1)
        assert programs.interrupt(client) == 0
    finally:
        master.stop()
    # ten a second were asked for; a busy machine may be late, a call to a silent master takes seconds
    assert largest_gap_s(tmp_path / "run/robot") < 1.5
    delays = list(read_recording(tmp_path / "run/robot").records(NetworkDelay))
    assert delays
    assert all(isinstance(r, NetworkDelay) and r.delay_ns is None and not r.alive for r in delays)


def test_a_subscriber_that_hangs_costs_no_sample(master: Master, programs: Programs, tmp_path: Path) -> None:
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--record", str(tmp_path / "run"), "--utilization-rate", "50"],
        master.environment(),
    )
    wait_for(has(master, TOPIC), "the topic")
    subscriber = programs.start([*PLAY, "swallow", TOPIC, "network_analysis/LinkUtilization"], master.environment())

    def connected() -> bool:
        told = subprocess.run(
            ["rosnode", "info", "/linkrover_client"], env=master.environment(), capture_output=True, text=True
        )
        return "to: /play_swallow" in told.stdout

    wait_for(connected, "it is connected")
    subscriber.send_signal(signal.SIGSTOP)
    time.sleep(2.5)
    assert programs.interrupt(client) == 0
    subscriber.send_signal(signal.SIGCONT)
    assert largest_gap_s(tmp_path / "run/robot") < 1.5


def test_it_ends_in_time_and_with_a_finished_recording_when_all_others_hang(
    master: Master, programs: Programs, tmp_path: Path
) -> None:
    server = programs.start([*LINKROVER, "ros1", "ping-server", "--reflect", "0"], master.environment())
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--record", str(tmp_path / "run")], master.environment()
    )
    wait_for(lambda: "a ping server answers" in programs.log(client), "they are connected")
    assert master.process is not None
    for process in (server, master.process):
        process.send_signal(signal.SIGSTOP)
    time.sleep(1)
    assert programs.interrupt(client, 40) == 0
    for process in (server, master.process):
        process.send_signal(signal.SIGCONT)
    assert (tmp_path / "run/robot/metadata.yaml").exists()
    assert not list((tmp_path / "run/robot").glob("*.journal"))


def test_simulated_time_is_said_and_stamps_stay_real(master: Master, programs: Programs) -> None:
    subprocess.run(["rosparam", "set", "/use_sim_time", "true"], env=master.environment(), check=True)
    client = programs.start([*LINKROVER, "ros1", "client", "-i", "lo"], master.environment())
    wait_for(lambda: "/use_sim_time is set" in programs.log(client), "it says so")
    wait_for(has(master, TOPIC), "the topic")
    (found,) = messages(master, TOPIC, "network_analysis/LinkUtilization", 1)
    assert abs(found["header"]["stamp"] - time.time_ns()) < 60e9


def test_a_wrong_interface_is_named_with_what_is_there_and_the_rest_goes_on(master: Master, programs: Programs) -> None:
    client = programs.start([*LINKROVER, "ros1", "client", "-i", "wlna0", "-i", "lo"], master.environment())
    wait_for(lambda: "no interface wlna0 here (there are: lo" in programs.log(client), "it says so")
    wait_for(has(master, TOPIC), "the other interface is measured")


def test_a_peer_with_another_definition_is_named(master: Master, programs: Programs) -> None:
    programs.start([*PLAY, "other_md5", "/Ping/result", "10"], master.environment())
    client = programs.start([*LINKROVER, "ros1", "client", "-i", "lo"], master.environment())
    wait_for(lambda: "md5sum" in programs.log(client), "it says so")
    wait_for(has(master, TOPIC), "measuring goes on")


def test_an_odometry_topic_of_another_type_is_named(master: Master, programs: Programs) -> None:
    programs.start([*PLAY, "command", "20"], master.environment())
    client = programs.start([*LINKROVER, "ros1", "client", "-i", "lo", "--odom", "/cmd_vel"], master.environment())
    wait_for(
        lambda: "/cmd_vel carries geometry_msgs/Twist, expected nav_msgs/Odometry" in programs.log(client), "it says so"
    )


def test_a_node_that_another_one_threw_out_goes_on_recording(
    master: Master, programs: Programs, tmp_path: Path
) -> None:
    client = programs.start(
        [*LINKROVER, "ros1", "client", "-i", "lo", "--record", str(tmp_path / "run"), "--utilization-rate", "10"],
        master.environment(),
    )
    wait_for(has(master, TOPIC), "the topic")
    # a plain node takes a name without asking; the master tells the former holder to go
    programs.start(
        ["rostopic", "pub", "-r", "1", "/x", "std_msgs/Empty", "__name:=linkrover_client"], master.environment()
    )
    wait_for(lambda: "this ROS node was shut down" in programs.log(client), "it says so")
    before = time.time_ns()
    time.sleep(1.5)
    assert programs.interrupt(client) == 0
    after = [r for r in read_recording(tmp_path / "run/robot").records(LinkUtilization) if r.wall_ns > before]
    assert len(after) > 3


@pytest.mark.parametrize("uri", ["http://127.0.0.1:1", "nonsense", "http://"])
def test_a_master_address_that_cannot_be_is_said_and_the_node_ends_in_time(
    uri: str, master: Master, programs: Programs
) -> None:
    environment = {**master.environment(), "ROS_MASTER_URI": uri}
    node = programs.start([*LINKROVER, "ros1", "client", "-i", "lo", "--duration", "1"], environment)
    assert node.wait(30) == 0
    assert "no ROS master" in programs.log(node)

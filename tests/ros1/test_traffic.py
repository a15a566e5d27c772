"""`linkrover ros1 traffic` against rospy's and roscpp's own statistics and the kernel's sockets."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from .conftest import LINKROVER, Master, Programs, wait_for
from .test_nodes import PLAY, topics


def rows(master: Master, *options: str) -> list[dict[str, Any]]:
    told = subprocess.run(
        [*LINKROVER, "ros1", "traffic", "--json", "--count", "2", "--interval", "0.5", *options],
        env=master.environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert told.returncode == 0, told.stderr
    return [json.loads(line) for line in told.stdout.splitlines()]


def of(found: list[dict[str, Any]], topic: str, direction: str, node: str) -> list[dict[str, Any]]:
    return [
        r
        for r in found
        if r["traffic"]["topic"] == topic
        and r["traffic"]["direction"] == direction
        and r["traffic"]["node"].startswith(node)
    ]


def test_rospy_and_roscpp_count_the_same_bytes_and_the_kernels_socket_is_found(
    master: Master, programs: Programs, cpp_peers: Path
) -> None:
    programs.start([str(cpp_peers / "echo")], master.environment())
    topic, back = "/in/network_analysis/NetworkDelay", "/out/network_analysis/NetworkDelay"
    programs.start(
        ["rostopic", "pub", "-r", "50", topic, "network_analysis/NetworkDelay", "{delay: 1.5}"], master.environment()
    )
    programs.start([*PLAY, "swallow", back, "network_analysis/NetworkDelay"], master.environment())
    wait_for(lambda: of(rows(master), back, "in", "/play_swallow"), "all are connected")
    found = rows(master)
    ends = (
        of(found, topic, "out", "/rostopic"),  # rospy publishes
        of(found, topic, "in", "/cpp_echo"),  # roscpp subscribes
        of(found, back, "out", "/cpp_echo"),  # roscpp publishes
        of(found, back, "in", "/play_swallow"),  # rospy subscribes
    )
    for end in ends:
        last = end[-1]["traffic"]
        assert 10 < last["messages_per_s"] < 200
        # header, three strings and numbers: some 33 bytes a message, whoever counts
        assert 20 < last["rate_bps"] / 8 / last["messages_per_s"] < 80
        assert end[-1]["tcp"] is not None, last
        assert end[-1]["tcp"]["rtt_us"] is not None
        assert last["local"] == end[-1]["tcp"]["local"]
    assert ends[0][-1]["traffic"]["peer"] == "/cpp_echo"
    assert ends[1][-1]["traffic"]["peer"].startswith("/rostopic")


OVERFLOWING = """
import rospy
from rospy.impl.registration import get_topic_manager
from std_msgs.msg import String
rospy.init_node("long_lived")
publisher = rospy.Publisher("/long", String, queue_size=10)
rate = rospy.Rate(50)
while not rospy.is_shutdown():
    for connection in get_topic_manager().get_publisher_impl("/long").connections:
        if connection.stat_bytes < 2**31:
            connection._connection.stat_bytes += 2**31  # what a camera has sent after some minutes
    publisher.publish(data="x" * 1000)
    rate.sleep()
"""


def test_a_rospy_node_whose_counter_passed_2_to_the_31_is_counted_by_the_kernel(
    master: Master, programs: Programs
) -> None:
    programs.start([sys.executable, "-c", OVERFLOWING], master.environment())
    programs.start([*PLAY, "swallow", "/long", "std_msgs/String"], master.environment())
    wait_for(lambda: "/long" in topics(master), "the topic")

    def measured() -> list[dict[str, Any]]:
        found = of(rows(master), "/long", "out", "/long_lived")
        return [r for r in found if (r["traffic"]["rate_bps"] or 0) > 0]

    found = wait_for(measured, "a rate")
    assert 100_000 < found[-1]["traffic"]["rate_bps"] < 2_000_000
    assert found[-1]["traffic"]["messages_per_s"] is None


def test_the_table_names_topics_and_connections(master: Master, programs: Programs) -> None:
    programs.start([*PLAY, "command", "20"], master.environment())
    programs.start([*PLAY, "swallow", "/cmd_vel", "geometry_msgs/Twist"], master.environment())
    wait_for(lambda: of(rows(master), "/cmd_vel", "out", "/play_command"), "they are connected")
    told = subprocess.run(
        [*LINKROVER, "ros1", "traffic", "--count", "1", "--interval", "0.5"],
        env={**master.environment(), "COLUMNS": "160"},
        capture_output=True,
        text=True,
    )
    assert "/cmd_vel" in told.stdout
    assert "retransmits" in told.stdout


def test_without_a_master_it_says_so(master: Master) -> None:
    environment = {**master.environment(), "ROS_MASTER_URI": "http://127.0.0.1:1"}
    told = subprocess.run(
        [*LINKROVER, "ros1", "traffic", "--count", "1"], env=environment, capture_output=True, text=True
    )
    assert told.returncode == 1
    assert "http://127.0.0.1:1" in told.stderr

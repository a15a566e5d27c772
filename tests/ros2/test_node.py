"""What goes wrong on a graph, and what a user is told then."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

from linkrover.messages import Codec
from linkrover.ros2.endpoints import qos
from linkrover.ros2.graph import DISCOVERY, NodesCodec, _discovery
from linkrover.ros2.network import read_network
from linkrover.ros2.node import Ros2
from linkrover.ros2.types import complete, sample_class, sample_class_of
from linkrover.ros2.unlocked import UnlockedWriter
from tests.middleware.contract import TWIST, Driver

FACTORY = "tests.ros2.test_contract:started"
Begin = Callable[..., Driver]


@pytest.fixture
def begin(environment: dict[str, str], drivers: list[Driver]) -> Begin:
    def start(verb: str, *arguments: object) -> Driver:
        drivers.append(Driver(environment, FACTORY, verb, *arguments))
        return drivers[-1]

    return start


@pytest.fixture
def participant(environment: dict[str, str]) -> Iterator[DomainParticipant]:
    """A DDS application that is not ours, in this process."""
    network = read_network(environment=environment)
    domain = Domain(network.domain, network.config)
    found = DomainParticipant(network.domain, qos=Qos(Policy.EntityName("foreign")))
    yield found
    found.__del__()
    del domain


def wait_for(condition: Callable[[], Any], what: str, timeout_s: float = 30.0) -> None:
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until, f"waited for: {what}"
        time.sleep(0.05)


def told(driver: Driver, text: str) -> None:
    assert driver.process.stderr is not None
    lines = []
    for line in driver.process.stderr:
        lines.append(line)
        if text in line:
            return
    raise AssertionError(f"'{text}' was not said: {lines}")


def test_another_type_on_the_topic_is_named(begin: Begin) -> None:
    begin("publish", "odom", "geometry_msgs/Twist", json.dumps(TWIST), 10, 60)
    listener = begin("listen", "odometry", "odom", 60)
    told(listener, "/odom carries geometry_msgs/msg/Twist, expected nav_msgs/msg/Odometry: not recorded")


def test_two_ping_servers_are_noticed(begin: Begin) -> None:
    for _ in range(2):
        begin("answer", "Ping", 60)
    lines, err = begin("ping", "Ping", 40, 20, 2000, "connected").finish()
    assert lines[-1]["answered"] >= 30
    # the second may be discovered after the last ping was sent
    assert lines[-1]["duplicates"] == 0 or "2 ping servers share the name '/Ping'" in err


@pytest.mark.parametrize("gid_bytes", [16, 24])
def test_nodes_that_ros_2_announces_have_their_names_in_the_graph(
    environment: dict[str, str], participant: DomainParticipant, gid_bytes: int
) -> None:
    twist = Topic(participant, "rt/cmd_vel", sample_class("geometry_msgs/Twist"))
    writer = DataWriter(participant, twist, qos=qos())
    # ROS 2 announces this type without its structure, so that a reader for either length matches
    made = sample_class_of(DISCOVERY, _discovery(16), Codec(DISCOVERY, _discovery(gid_bytes)))

    def gid(key: bytes) -> dict[str, Any]:
        return {"data": list(key.ljust(gid_bytes, b"\0"))}

    announced = {
        "gid": gid(participant.guid.bytes),
        "nodes": [
            {"node_namespace": "/", "node_name": "teleop", "readers": [], "writers": [gid(writer.guid.bytes)]},
            {"node_namespace": "/r1", "node_name": "idle", "readers": [], "writers": []},
        ],
    }
    data = made(announced).serialize()
    assert NodesCodec().decode(data)["nodes"][1]["node_name"] == "idle"
    announcer = UnlockedWriter(participant, Topic(participant, "ros_discovery_info", made), qos=qos(latched=True))
    announcer.write(made(announced))
    node = Ros2("looker", network=read_network(environment=environment))
    node.start()
    try:
        assert node.wait_joined(20)

        def seen() -> bool:
            found = node.graph()
            topic = next((t for t in found.topics if t.name == "/cmd_vel"), None)
            return {"/teleop", "/r1/idle", "/looker"} <= set(found.nodes) and topic is not None and (
                topic.publishers == ("/teleop",)
            )  # fmt: skip

        wait_for(seen, "the names of ROS 2's nodes")
    finally:
        node.close()


def test_a_write_that_waits_for_a_reader_lets_sampling_go_on(begin: Begin, participant: DomainParticipant) -> None:
    driver = begin("answer", "Ping", 60)
    everything = Qos(
        Policy.Reliability.Reliable(max_blocking_time=1_000_000_000),
        Policy.History.KeepAll,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    header = sample_class("std_msgs/Header")
    writer = UnlockedWriter(participant, Topic(participant, "rt/Ping/goal", header), qos=everything)
    wait_for(lambda: writer.get_publication_matched_status().current_count, "the server is discovered")
    driver.process.send_signal(signal.SIGSTOP)
    ticks = [0]
    refused = threading.Event()
    during = []

    def fill() -> None:
        while not refused.is_set():
            before = ticks[0]
            try:
                writer.write(header(complete("std_msgs/Header", {"frame_id": "x" * 1000})))
            except DDSException:
                during.append(ticks[0] - before)
                refused.set()

    thread = threading.Thread(target=fill)
    thread.start()
    until = time.monotonic() + 60
    while not refused.is_set() and time.monotonic() < until:
        ticks[0] += 1
        time.sleep(0.001)
    refused.set()
    thread.join()
    driver.process.send_signal(signal.SIGCONT)
    # for the whole of the second that the write waited
    assert during
    assert during[0] >= 5


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("unshare") is None, reason="needs root for a network namespace")
def test_a_loopback_that_is_down_is_named_and_joined_when_it_is_up(
    environment: dict[str, str], drivers: list[Driver]
) -> None:
    driver = Driver(environment, FACTORY, "graph", before=("unshare", "--net"))
    drivers.append(driver)
    told(driver, "no network interface is up")
    enter = ["nsenter", f"--net=/proc/{driver.process.pid}/ns/net"]
    subprocess.run([*enter, "ip", "link", "set", "lo", "up"], check=True, timeout=20)
    assert driver.said("joined")["joined"]
    assert "/driver_graph" in driver.said("graph")["nodes"]

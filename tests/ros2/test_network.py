from __future__ import annotations

import socket
from pathlib import Path
from xml.etree import ElementTree

import pytest

from linkrover.errors import ConfigError
from linkrover.ros2.names import Names, dds_topic, ros_topic
from linkrover.ros2.network import Network, read_network


def elements(config: str) -> dict[str, str]:
    return {e.tag: e.get("address") or e.text or "" for e in ElementTree.fromstring(f"<a>{config}</a>").iter()}


def test_nothing_set_is_domain_0_with_multicast() -> None:
    found = read_network(environment={})
    assert (found.domain, found.interfaces) == (0, ())
    assert "AllowMulticast" not in found.config


@pytest.mark.parametrize("variables", [{}, {"ROS_LOCALHOST_ONLY": "1"}, {"ROS_STATIC_PEERS": "10.0.0.3"}])
def test_a_peer_that_was_away_for_long_is_looked_for_all_the_same(variables: dict[str, str]) -> None:
    found = elements(read_network(environment=variables).config)
    assert (found["SPDPInterval"], found["InitialLocatorPruneDelay"]) == ("3s", "inf")


def test_the_variables_of_ros_are_mapped() -> None:
    found = read_network(environment={"ROS_DOMAIN_ID": " 42 ", "ROS_LOCALHOST_ONLY": "1"})
    assert (found.domain, found.interfaces) == (42, ("lo",))
    assert elements(found.config)["AllowMulticast"] == "false"
    assert elements(found.config)["Peer"] == "127.0.0.1"
    assert read_network(environment={"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}).interfaces == ("lo",)


def test_peers_turn_multicast_off() -> None:
    found = read_network(7, ["10.0.0.2", 'a"<b'], {"ROS_DOMAIN_ID": "9", "ROS_STATIC_PEERS": "10.0.0.3;"})
    assert found.domain == 7
    peers = [e.get("address") for e in ElementTree.fromstring(f"<a>{found.config}</a>").iter("Peer")]
    assert peers == ["10.0.0.2", 'a"<b', "10.0.0.3"]
    assert "false" in found.config


def test_cyclonedds_uri_has_the_last_word_and_names_interfaces(tmp_path: Path) -> None:
    file = tmp_path / "a,b.xml"
    file.write_text(
        '<?xml version="1.0"?><CycloneDDS xmlns="https://cdds.io/config"><Domain><General><Interfaces>'
        '<NetworkInterface name="wlan7"/></Interfaces></General></Domain></CycloneDDS>'
    )
    uri = f"<Tracing><Verbosity>none</Verbosity></Tracing>,file://{file}"
    found = read_network(environment={"ROS_LOCALHOST_ONLY": "1", "CYCLONEDDS_URI": uri})
    assert found.config.endswith("," + uri)
    assert found.interfaces == ("wlan7",)
    assert "no interface wlan7 here" in (found.problem() or "")


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"ROS_DOMAIN_ID": "many"}, "ROS_DOMAIN_ID = 'many'"),
        ({"ROS_DOMAIN_ID": "233"}, "0 to 232"),
        ({"CYCLONEDDS_URI": "<General>"}, "CYCLONEDDS_URI: not well-formed XML"),
        ({"CYCLONEDDS_URI": "file:///not/here.xml"}, "/not/here.xml: cannot be read"),
        ({"CYCLONEDDS_URI": "<A>ä</A>"}, "ASCII"),
    ],
)
def test_a_variable_that_cannot_be_used_is_named(environment: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=said.replace("(", r"\(")):
        read_network(environment=environment)
    with pytest.raises(ConfigError, match="--domain -1"):
        read_network(-1)


def test_an_interface_that_is_up_is_no_problem() -> None:
    names = [name for _, name in socket.if_nameindex()]
    if "lo" not in names:
        pytest.skip("this machine has no loopback interface")
    assert Network(0, interfaces=("lo",)).problem() is None


def test_names_are_resolved_as_ros_2_does() -> None:
    names = Names("n", ["__ns:=/r1", "odom:=/robot/odom", "__node:=m"])
    assert names.full_name == "/r1/m"
    assert names.resolve("odom") == "/robot/odom"
    assert names.resolve("/odom") == "/odom"
    assert names.resolve("cmd_vel") == "/r1/cmd_vel"
    assert names.resolve("~/x") == "/r1/m/x"
    assert (dds_topic("/r1/x"), ros_topic("rt/r1/x"), ros_topic("rq/r1/xRequest"), ros_topic("x")) == (
        "rt/r1/x", "/r1/x", None, None,
    )  # fmt: skip


@pytest.mark.parametrize("wrong", [["__node:=a b"], ["__ns:=/1"], ["a:=b-c"]])
def test_names_ros_2_does_not_allow_are_refused(wrong: list[str]) -> None:
    with pytest.raises(ConfigError, match="cannot be a ROS 2"):
        Names("n", wrong)

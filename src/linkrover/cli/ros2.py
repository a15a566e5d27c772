"""`linkrover ros2`: the nodes on a ROS 2 graph, without a ROS 2 installation."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

app = App(
    name="ros2",
    help="Nodes on a ROS 2 graph, by DDS itself: needs pip install 'linkrover[ros2]', no ROS 2 on this machine. "
    "ROS_DOMAIN_ID, ROS_LOCALHOST_ONLY, ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, ROS_STATIC_PEERS and CYCLONEDDS_URI "
    "are heeded. Odometry, velocity, pings and /diagnostics are standard types; see docs/ros2.md for our own.",
)


@Parameter(name="*")
@dataclass
class Measuring:
    """What to measure and where it goes."""

    interface: Annotated[list[str] | None, Parameter(name=["--interface", "-i"], negative=())] = None
    """Network device, or ALIAS=NAME for another name in topics; repeatable. [default: wlan0]"""

    record: Path | None = None
    """Directory of the run; this end goes to DIR/robot or DIR/station, complete whatever the network does."""

    prefix: str | None = None
    """Of topics; '' gives network_analysis/link_utilization as in 2021. [default: {end}/{iface}]"""

    peer: Annotated[list[str] | None, Parameter(negative=())] = None
    """HOST[:PORT] of the other end's STAMP reflector. [default: found through the ping server, where that is ours]"""

    ping: str | None = None
    """Ask pings on NAME/goal; '' = none. [default: Ping for the client, none for the server]"""

    answer: str | None = None
    """Answer pings on NAME/answer; '' = none. [default: Ping for the server, none for the client]"""

    reflect: int | None = None
    """UDP port on which to answer the other end's STAMP probes; 0 = none. [default: 8620 for the server]"""

    wireless_rate: float | None = None
    """Samples of the wireless link per second; 0 = off. [default: 10]"""

    utilization_rate: float | None = None
    """Samples of traffic per second; 0 = off. [default: 1]"""

    errors_rate: float | None = None
    """Samples of the error counters per second; 0 = off. [default: 1]"""

    tcp_rate: float = 1.0
    """Samples of each TCP connection per second; 0 = off."""

    delay_rate: float | None = None
    """Pings per second. [default: 1]"""

    timeout: float | None = None
    """Seconds without an answer after which a ping counts as lost. [default: 2]"""

    odom: str | None = None
    """Topic of nav_msgs/msg/Odometry to record."""

    cmd_vel: str | None = None
    """Topic of geometry_msgs/msg/Twist or TwistStamped to record."""

    diagnostics: bool = True
    """Publish /diagnostics once a second."""

    duration: float | None = None
    """Stop after this many seconds."""

    wireless_path: Path | None = None
    """Read this file in the format of /proc/net/wireless instead of asking the kernel (an emulated radio)."""

    case: str | None = None
    """Name of the set-up under test, for the recording."""

    trial: int | None = None
    """Number of the trial, for the recording."""

    key_file: Path | None = None
    """File with the shared key of authenticated probes (RFC 8762), at both ends."""

    end: str | None = None
    """Name of this end in topics. [default: robot for the client, station for the server]"""

    node: str | None = None
    """Name of the node; __node:= does the same."""

    emulated: Annotated[bool, Parameter(negative=(), show=False)] = False


@Parameter(name="*")
@dataclass
class Joining:
    """Which graph to join, and over what."""

    domain: int | None = None
    """DDS domain. [default: ROS_DOMAIN_ID, else 0]"""

    dds_peer: Annotated[list[str] | None, Parameter(negative=())] = None
    """Host whose ROS 2 nodes to find by unicast, with multicast off (Wi-Fi often drops multicast); repeatable."""


Remappings = Annotated[str, Parameter(negative=())]


@app.command
def client(*remappings: Remappings, measuring: Measuring | None = None, joining: Joining | None = None) -> int:
    """Measure at the end that asks, normally the robot: link, traffic, errors, delay of pings over two topics.

    robot$ linkrover ros2 client --interface wlan0 --odom /odom --cmd-vel /cmd_vel --record runs/001

    Parameters
    ----------
    remappings
        Namespace and names: __ns:=/r1, /odom:=/r1/odom.
    measuring
        What to measure and where it goes.
    joining
        Which graph to join, and over what.
    """
    return _run("client", remappings, measuring, joining)


@app.command
def server(*remappings: Remappings, measuring: Measuring | None = None, joining: Joining | None = None) -> int:
    """Measure at the end that answers, normally the station, and answer pings and STAMP probes.

    station$ linkrover ros2 server --interface eth0 --record runs/001

    Parameters
    ----------
    remappings
        Namespace and names: __ns:=/r1, Ping:=/r1/Ping.
    measuring
        What to measure and where it goes.
    joining
        Which graph to join, and over what.
    """
    return _run("server", remappings, measuring, joining)


@app.command(name="ping-server")
def ping_server(
    *remappings: Remappings, answer: str = "Ping", reflect: int = 8620, joining: Joining | None = None
) -> int:
    """Only answer pings (and STAMP probes): the smallest station.

    Parameters
    ----------
    remappings
        Namespace and names: __ns:=/r1, Ping:=/r1/Ping.
    answer
        Pings on NAME/goal are answered on NAME/answer.
    reflect
        UDP port for STAMP probes; 0 = none.
    joining
        Which graph to join, and over what.
    """
    return _start("ping-server", remappings, {"answer": answer, "reflect": reflect}, joining)


def _run(kind: str, remappings: tuple[str, ...], measuring: Measuring | None, joining: Joining | None) -> int:
    given = measuring or Measuring()
    changes: dict[str, Any] = {
        "interface": None if given.interface is None else tuple(given.interface),
        "record": _text(given.record),
        "prefix": given.prefix,
        "peer": None if given.peer is None else tuple(given.peer),
        "ping": given.ping,
        "answer": given.answer,
        "reflect": given.reflect,
        "wireless_hz": given.wireless_rate,
        "utilization_hz": given.utilization_rate,
        "errors_hz": given.errors_rate,
        "tcp_hz": given.tcp_rate,
        "delay_hz": given.delay_rate,
        "timeout_s": given.timeout,
        "odom": given.odom,
        "cmd_vel": given.cmd_vel,
        "duration_s": given.duration,
        "diagnostics": given.diagnostics,
        "wireless_path": _text(given.wireless_path),
        "case": given.case,
        "trial": given.trial,
        "key_file": _text(given.key_file),
        "end": given.end,
        "node": given.node,
        "emulated": given.emulated or None,
    }
    return _start(kind, remappings, changes, joining)


def _start(kind: str, remappings: tuple[str, ...], changes: dict[str, Any], joining: Joining | None) -> int:
    wrong = [text for text in remappings if ":=" not in text]
    if wrong:
        print(f"linkrover ros2: '{wrong[0]}' is no remapping (name:=value)", file=sys.stderr)
        return 2
    _need_cyclonedds()
    from linkrover.ros2.entry import run

    where = joining or Joining()
    changes |= {"domain": where.domain, "dds_peers": None if where.dds_peer is None else tuple(where.dds_peer)}
    return run(kind, {k: v for k, v in changes.items() if v is not None}, remappings)


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _need_cyclonedds() -> None:
    from importlib.util import find_spec

    from linkrover.errors import MissingExtraError

    if find_spec("cyclonedds") is None:
        raise MissingExtraError("ros2", "cyclonedds")

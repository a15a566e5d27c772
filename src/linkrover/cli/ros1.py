"""`linkrover ros1`: the nodes on a ROS 1 graph, and what its topics cost."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

app = App(
    name="ros1",
    help="Nodes on a ROS 1 (Noetic) graph. Needs rospy: on Ubuntu 20.04 `source /opt/ros/noetic/setup.bash`, on "
    "Debian 12 `apt install ros-core python3-actionlib`. Parameters on the parameter server keep their 2021 names "
    "(~INTERFACE_NAME, ~update_rate_*, ~timeout_network_delay); options given here come first.",
)


@Parameter(name="*")
@dataclass
class Measuring:
    """What to measure and where it goes."""

    interface: Annotated[list[str] | None, Parameter(name=["--interface", "-i"], negative=())] = None
    """Network device, or ALIAS=NAME for another name in topics; repeatable. [default: ~INTERFACE_NAME, else wlan0]"""

    record: Path | None = None
    """Directory of the run; this end goes to DIR/robot or DIR/station, complete whatever the network does."""

    prefix: str | None = None
    """Of topics; '' gives network_analysis/link_utilization as in 2021. [default: {end}/{iface}]"""

    peer: Annotated[list[str] | None, Parameter(negative=())] = None
    """HOST[:PORT] of the other end's STAMP reflector. [default: found through the ping server, where that is ours]"""

    ping: str | None = None
    """Ping action to ask; '' = none. [default: Ping for the client, none for the server]"""

    answer: str | None = None
    """Ping action to serve; '' = none. [default: Ping for the server, none for the client]"""

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
    """Topic of nav_msgs/Odometry to record and to draw the path from."""

    cmd_vel: str | None = None
    """Topic of geometry_msgs/Twist to record."""

    frame: str | None = None
    """Without --odom: frame in which to take the robot's pose from /tf."""

    base_frame: str = "base_link"
    """The robot's own frame in /tf."""

    traffic_period: float | None = None
    """Seconds between readings of the local nodes' bus statistics; 0 = off. [default: 5]"""

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
    """Name of the node; __name:= does the same."""

    emulated: Annotated[bool, Parameter(negative=(), show=False)] = False


Remappings = Annotated[str, Parameter(negative=())]


@app.command
def client(*remappings: Remappings, measuring: Measuring | None = None) -> int:
    """Measure at the end that asks, normally the robot: link, traffic, errors, delay of action pings.

    robot$ linkrover ros1 client --interface wlan0 --odom /odom --record runs/001

    Parameters
    ----------
    remappings
        As roslaunch gives them: __ns:=/r1, /odom:=/r1/odom, _INTERFACE_NAME:=wlan1.
    measuring
        What to measure and where it goes.
    """
    return _run("client", remappings, measuring)


@app.command
def server(*remappings: Remappings, measuring: Measuring | None = None) -> int:
    """Measure at the end that answers, normally the station, and answer pings and STAMP probes.

    station$ linkrover ros1 server --interface eth0 --record runs/001

    Parameters
    ----------
    remappings
        As roslaunch gives them: __ns:=/r1, _INTERFACE_NAME:=wlan1.
    measuring
        What to measure and where it goes.
    """
    return _run("server", remappings, measuring)


@app.command(name="ping-server")
def ping_server(*remappings: Remappings, answer: str = "Ping", reflect: int = 8620) -> int:
    """Only answer pings (and STAMP probes): the smallest station.

    Parameters
    ----------
    remappings
        As roslaunch gives them: __ns:=/r1, Ping:=/r1/Ping.
    answer
        Name of the action.
    reflect
        UDP port for STAMP probes; 0 = none.
    """
    return _start("pingactionserver", remappings, {"answer": answer, "reflect": reflect})


@app.command
def traffic(
    *,
    interval: float = 1.0,
    count: int | None = None,
    local: Annotated[bool, Parameter(negative=())] = False,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Which topic fills the air, which connection retransmits: live, without subscribing to anything.

    Bytes and messages come from the nodes' own bus statistics, round trip, retransmits and congestion window from
    the kernel, for connections that end on this machine. Each reading costs two small calls to every node.

    Parameters
    ----------
    interval
        Seconds between readings.
    count
        Stop after this many readings. [default: until Ctrl-C]
    local
        Ask nodes of this machine only, so that nothing more than one call to the master goes over the network.
    json
        One line of JSON for each connection and reading.
    """
    _need_rospy()
    from linkrover.ros1.show import KernelConnections, show_traffic

    if interval <= 0:
        print("linkrover ros1 traffic: --interval must be positive", file=sys.stderr)
        return 2
    with KernelConnections() as kernel:
        return show_traffic(interval_s=interval, count=count, only_local=local, json=json, connections=kernel.read)


@app.command
def pythonpath() -> int:
    """Print where the message classes lie, for tools of a shell without the catkin package.

    PYTHONPATH=$PYTHONPATH:$(linkrover ros1 pythonpath) rostopic echo /robot/wlan0/network_analysis/link_utilization
    """
    from importlib.util import find_spec

    spec = find_spec("linkrover.ros1")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    print(Path(spec.submodule_search_locations[0]) / "generated")
    return 0


def _run(kind: str, remappings: tuple[str, ...], measuring: Measuring | None) -> int:
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
        "frame": given.frame,
        "base_frame": given.base_frame,
        "traffic_s": given.traffic_period,
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
    return _start(kind, remappings, changes)


def _start(kind: str, remappings: tuple[str, ...], changes: dict[str, Any]) -> int:
    wrong = [text for text in remappings if ":=" not in text]
    if wrong:
        print(f"linkrover ros1: '{wrong[0]}' is no remapping (name:=value)", file=sys.stderr)
        return 2
    _need_rospy()
    from linkrover.ros1.entry import NODES, run
    from linkrover.ros1.options import Ros1Options

    fixed, defaults = NODES[kind]
    options = Ros1Options(**{**fixed, **{k: v for k, v in changes.items() if v is not None}})
    return run(options, remappings, defaults)


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _need_rospy() -> None:
    from importlib.util import find_spec

    from linkrover.errors import LinkRoverError

    if find_spec("rospy") is None:
        raise LinkRoverError(
            "rospy is not installed for this Python: source /opt/ros/noetic/setup.bash (Ubuntu 20.04), or apt install "
            "ros-core python3-actionlib (Debian 12) and make the environment with --system-site-packages"
        )

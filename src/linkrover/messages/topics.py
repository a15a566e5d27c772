"""Which topics a record goes to, in a recording and on a ROS graph (the table in docs/architecture.md)."""

from __future__ import annotations

import functools
import re

from linkrover.records import (
    ChannelSurvey,
    LinkEvent,
    LinkTruth,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    ProbeTruth,
    RadioCapability,
    Record,
    ScanSnapshot,
    StationLink,
    TcpConnection,
    VelocityCommand,
    WirelessLink,
)

from .mapping import type_name

_PER_INTERFACE = (
    WirelessLink,
    LinkUtilization,
    NetworkErrors,
    StationLink,
    ChannelSurvey,
    ScanSnapshot,
    RadioCapability,
    LinkEvent,
    TcpConnection,
)
_TRUTH = (LinkTruth, ProbeTruth)
# the names the 2021 package gave its topics
_TOPIC_2021: dict[type[Record], tuple[str, str]] = {
    WirelessLink: ("wireless_quality", "network_analysis/WirelessLink"),
    LinkUtilization: ("link_utilization", "network_analysis/LinkUtilization"),
    NetworkErrors: ("network_errors", "network_analysis/NetworkErrors"),
    NetworkDelay: ("network_delay", "network_analysis/NetworkDelay"),
}
_STANDARD: dict[type[Record], tuple[str, str]] = {
    Pose: ("odom", "nav_msgs/Odometry"),
    VelocityCommand: ("cmd_vel", "geometry_msgs/Twist"),
}


@functools.cache
def legal_name(name: str) -> str:
    """`name` as one token of a ROS topic: letters, digits and single underscores, beginning with a letter."""
    token = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9_]", "_", name)).rstrip("_")
    return token if re.match(r"[A-Za-z]", token) else f"if_{token.lstrip('_')}".rstrip("_")


def snake(name: str) -> str:
    """A class name as ROS spells topics: WirelessLink becomes wireless_link."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def topics(record: Record, end: str) -> tuple[tuple[str, str], ...]:
    """(topic, message type) of a record: the full one first, then the 2021 and standard types where there are any."""
    return topics_of(type(record), end, getattr(record, "iface", ""))


@functools.lru_cache(maxsize=4096)
def topics_of(kind: type[Record], end: str, iface: str = "") -> tuple[tuple[str, str], ...]:
    """As `topics`, from the record's type."""
    place = f"/{end}/{legal_name(iface)}" if iface and kind in _PER_INTERFACE else f"/{end}"
    if kind in _TRUTH:
        return ((f"/truth/{snake(kind.__name__)}", type_name(kind)),)
    found = [(f"{place}/linkrover/{snake(kind.__name__)}", type_name(kind))]
    if kind in _TOPIC_2021:
        name, message_type = _TOPIC_2021[kind]
        found.append((f"{place}/network_analysis/{name}", message_type))
    if kind in _STANDARD:
        name, message_type = _STANDARD[kind]
        found.append((f"{place}/{name}", message_type))
    return tuple(found)

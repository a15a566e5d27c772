"""Every record there is: frozen, typed, units in names, `None` = unknown."""

from .base import Now, Record, Role, Unknown, now
from .delay import ClockOffset, ClockSource, NetworkDelay, ProbeResult, ProbeState
from .event import EventKind, LinkEvent
from .link import (
    Bitrate,
    ChannelSurvey,
    Continuity,
    LinkUtilization,
    NetworkErrors,
    StationLink,
    TidCounters,
    WirelessLink,
)
from .motion import Pose, VelocityCommand
from .run import Interface, Manifest, SelfAccount
from .scan import Neighbour, Overlap, RadioCapability, ScanSnapshot
from .tcp import TcpConnection, TopicTraffic
from .truth import LinkTruth, ProbeTruth

__all__ = [
    "Bitrate",
    "ChannelSurvey",
    "ClockOffset",
    "ClockSource",
    "Continuity",
    "EventKind",
    "Interface",
    "LinkEvent",
    "LinkTruth",
    "LinkUtilization",
    "Manifest",
    "Neighbour",
    "NetworkDelay",
    "NetworkErrors",
    "Now",
    "Overlap",
    "Pose",
    "ProbeResult",
    "ProbeState",
    "ProbeTruth",
    "RadioCapability",
    "Record",
    "Role",
    "ScanSnapshot",
    "SelfAccount",
    "StationLink",
    "TcpConnection",
    "TidCounters",
    "TopicTraffic",
    "Unknown",
    "VelocityCommand",
    "WirelessLink",
    "now",
]

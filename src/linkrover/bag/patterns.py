"""Which topic of a recording is which record of which end: ours by type, all others by a table a user can replace."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import msgspec

from linkrover.errors import ConfigError
from linkrover.messages import record_type
from linkrover.records import (
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    Record,
    VelocityCommand,
    WirelessLink,
)

from .blocks import Topic

TRUTH = "truth"
ENDS = ("robot", "station", TRUTH)
# how the 2021 package and ROS users call the ends
_END_WORDS = {"robot": "robot", "client": "robot", "station": "station", "server": "station", "truth": TRUTH}

_KINDS: dict[str, type[Record]] = {
    "network_analysis/LinkUtilization": LinkUtilization,
    "network_analysis/NetworkErrors": NetworkErrors,
    "network_analysis/WirelessLink": WirelessLink,
    "network_analysis/WirelessLinkVector": WirelessLink,
    "network_analysis/NetworkDelay": NetworkDelay,
    "network_analysis/NetworkAnalysis": NetworkDelay,
    "nav_msgs/Odometry": Pose,
    "geometry_msgs/Twist": VelocityCommand,
    "geometry_msgs/TwistStamped": VelocityCommand,
}


class TopicPattern(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One line of the table.

    topic: regular expression for the whole topic name; a group `end` gives the end (robot or client, station or
    server), a group `iface` a name for messages that hold none. type: "package/Name", empty = any that can be read.
    end: the end where the topic does not say. Of several patterns that give the same record of the same end, the
    first in the table that matches a topic is taken, unless `also` is true.
    """

    topic: str
    type: str = ""
    end: str = "robot"
    also: bool = False


DEFAULT_PATTERNS: tuple[TopicPattern, ...] = (
    TopicPattern(r"/(?P<end>robot|server|client|station)/(?P<iface>[^/]+)/network_analysis/[^/]+", also=True),
    TopicPattern(r"/(?P<end>robot|server|client|station)/network_analysis/[^/]+", also=True),
    TopicPattern(r"/network_analysis/[^/]+", also=True),
    TopicPattern(r"/(?P<end>robot|station|truth)/odom", "nav_msgs/Odometry"),
    TopicPattern(r"/odom", "nav_msgs/Odometry"),
    TopicPattern(r"(/[^/]+)*/odom(etry)?(/filtered)?", "nav_msgs/Odometry"),
    TopicPattern(r"/teleop_velocity_smoother/raw_cmd_vel"),
    TopicPattern(r"/(?P<end>robot|station|truth)/cmd_vel"),
    TopicPattern(r"/cmd_vel"),
    TopicPattern(r"(/[^/]+)*/cmd_vel(_[a-z]+)?"),
)


class Meaning(msgspec.Struct, frozen=True):
    """What a topic's messages are: records of `kind` from `end`; native: our own type, nothing derived."""

    kind: type[Record]
    end: str
    native: bool
    iface: str = ""


def meanings(topics: Iterable[Topic], patterns: Sequence[TopicPattern] = DEFAULT_PATTERNS) -> dict[int, Meaning]:
    """By topic id, for every topic that is to be read.

    A topic that only repeats, in a 2021 or standard type, what a full one of the same end holds is left out.
    """
    topics = list(topics)
    found: dict[int, Meaning] = {}
    full: set[tuple[type[Record], str]] = set()
    for topic in topics:
        kind = record_type(topic.type)
        if kind is not None:
            end = topic.name.strip("/").partition("/")[0]
            end = end if end in ENDS else "robot"
            found[topic.id] = Meaning(kind, end, native=True)
            full.add((kind, end))
    decided = set(found)
    taken: dict[tuple[type[Record], str], int] = {}
    for rank, pattern in enumerate(patterns):
        matcher = _compiled(pattern)
        for topic in topics:
            if topic.id in decided or topic.type not in _KINDS or (pattern.type and pattern.type != topic.type):
                continue
            match = matcher.fullmatch(topic.name)
            if match is None:
                continue
            decided.add(topic.id)
            groups = match.groupdict()
            end = _END_WORDS.get(groups.get("end") or pattern.end, pattern.end)
            key = (_KINDS[topic.type], end)
            if key in full or (not pattern.also and taken.get(key, rank) != rank):
                continue
            taken.setdefault(key, rank)
            found[topic.id] = Meaning(key[0], end, native=False, iface=groups.get("iface") or "")
    return found


def _compiled(pattern: TopicPattern) -> re.Pattern[str]:
    try:
        return re.compile(pattern.topic)
    except re.error as error:
        raise ConfigError(f"topic pattern {pattern.topic!r} is no regular expression: {error}") from None


def load_patterns(path: Path) -> tuple[TopicPattern, ...]:
    """A table from TOML, `[[topic]]` per line with the keys of `TopicPattern`; the default table follows it.

    Raises ConfigError.
    """
    try:
        data = msgspec.toml.decode(path.read_bytes(), type=dict[str, tuple[TopicPattern, ...]])
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except msgspec.MsgspecError as error:
        raise ConfigError(f"{path}: {error}; every [[topic]] has topic, and may have type, end and also") from None
    _only_topic(data, path)
    for pattern in data.get("topic", ()):
        _compiled(pattern)
        if pattern.end not in _END_WORDS:
            raise ConfigError(f"{path}: end = {pattern.end!r}, known are {', '.join(_END_WORDS)}")
    return data.get("topic", ()) + DEFAULT_PATTERNS


def _only_topic(data: Mapping[str, object], path: Path) -> None:
    extra = sorted(data.keys() - {"topic"})
    if extra:
        raise ConfigError(f"{path}: unknown key {extra[0]!r}, the table is called [[topic]]")

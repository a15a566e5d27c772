"""rosbag2's `metadata.yaml` and QoS profiles, written without a YAML library: a robot's install stays small.

Version 8 of the format: the last that every ROS 2 from Humble on reads (QoS as text, `custom_data` for the manifest).
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import msgspec

VERSION = 8
_FOREVER = "  {name}:\n    sec: 9223372036\n    nsec: 854775807\n"


class TopicInfo(msgspec.Struct, frozen=True):
    """One topic of a recording. type: "package/msg/Name"."""

    name: str
    type: str
    qos: str
    count: int


class BagInfo(msgspec.Struct, frozen=True):
    """What `metadata.yaml` says of one recording file."""

    file: str
    start_ns: int
    end_ns: int
    topics: Sequence[TopicInfo]
    custom: dict[str, str] = {}


def qos(*, latched: bool = False) -> str:
    """The offered QoS as rosbag2 stores it: reliable, keep last; latched = transient local with depth 1."""
    depth, durability = (1, 1) if latched else (10, 2)
    return (
        f"- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n"
        + _FOREVER.format(name="deadline")
        + _FOREVER.format(name="lifespan")
        + "  liveliness: 1\n"
        + _FOREVER.format(name="liveliness_lease_duration")
        + "  avoid_ros_namespace_conventions: false"
    )


def quoted(text: str) -> str:
    """A YAML double-quoted scalar. JSON's is one, but for the control characters JSON leaves bare."""
    escaped = json.dumps(text, ensure_ascii=False)
    return "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped)


def metadata_yaml(info: BagInfo) -> str:
    """The text of `metadata.yaml`."""
    total = sum(topic.count for topic in info.topics)
    duration = max(0, info.end_ns - info.start_ns)
    lines = [
        "rosbag2_bagfile_information:",
        f"  version: {VERSION}",
        "  storage_identifier: mcap",
        f"  duration:\n    nanoseconds: {duration}",
        f"  starting_time:\n    nanoseconds_since_epoch: {info.start_ns}",
        f"  message_count: {total}",
        "  topics_with_message_count:" + ("" if info.topics else " []"),
    ]
    for topic in info.topics:
        lines += [
            "    - topic_metadata:",
            f"        name: {quoted(topic.name)}",
            f"        type: {quoted(topic.type)}",
            "        serialization_format: cdr",
            f"        offered_qos_profiles: {quoted(topic.qos)}",
            '        type_description_hash: ""',
            f"      message_count: {topic.count}",
        ]
    lines += [
        '  compression_format: ""',
        '  compression_mode: ""',
        f"  relative_file_paths:\n    - {quoted(info.file)}",
        "  files:",
        f"    - path: {quoted(info.file)}",
        f"      starting_time:\n        nanoseconds_since_epoch: {info.start_ns}",
        f"      duration:\n        nanoseconds: {duration}",
        f"      message_count: {total}",
    ]
    if info.custom:
        lines.append("  custom_data:")
        lines += [f"    {quoted(key)}: {quoted(value)}" for key, value in info.custom.items()]
    else:
        lines.append("  custom_data: {}")
    lines.append("  ros_distro: linkrover")
    return "\n".join(lines) + "\n"

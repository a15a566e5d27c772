"""Who is on the graph, from what DDS itself knows of every participant, writer and reader."""

from __future__ import annotations

import re
import struct
from typing import Any

import msgspec
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from linkrover.errors import ParseError
from linkrover.messages import Codec, Message
from linkrover.messages.schema import Definitions, Field
from linkrover.middleware.protocol import Graph, TopicInfo

from .endpoints import qos
from .names import ros_topic
from .types import ros_name, sample_class_of

MOST = 10_000
DISCOVERY = "rmw_dds_common/ParticipantEntitiesInfo"


def _discovery(gid_bytes: int) -> Definitions:
    return {
        DISCOVERY: (Field("gid", "rmw_dds_common/Gid"), Field("nodes", "rmw_dds_common/NodeEntitiesInfo", -1)),
        "rmw_dds_common/NodeEntitiesInfo": (
            Field("node_namespace", "string"),
            Field("node_name", "string"),
            Field("readers", "rmw_dds_common/Gid", -1),
            Field("writers", "rmw_dds_common/Gid", -1),
        ),
        "rmw_dds_common/Gid": (Field("data", "uint8", gid_bytes),),
    }


class NodesCodec(Codec):
    """ros_discovery_info: who the nodes of a ROS 2 participant are. A gid has 24 bytes on Humble, 16 from Iron on."""

    def __init__(self) -> None:
        super().__init__(DISCOVERY, _discovery(16))
        self._codecs = [Codec(DISCOVERY, _discovery(size)) for size in (16, 24)]

    def decode(self, data: bytes | memoryview) -> Message:
        """By whichever length accounts for all bytes."""
        for codec in self._codecs:
            try:
                found = codec.decode(data)
                if 0 <= len(data) - len(codec.encode(found)) < 4:
                    return found
            except (ParseError, struct.error):  # noqa: PERF203
                continue
        raise ParseError(DISCOVERY, "message", "gids of 16 or 24 bytes", f"{len(data)} bytes")


class Endpoint(msgspec.Struct, frozen=True):
    """A publisher or subscription: topic and type as ROS 2 calls them, the participant it belongs to."""

    key: bytes
    participant: bytes
    topic: str
    type_name: str


class Participant(msgspec.Struct, frozen=True):
    """A process on the graph. addresses: where its data go; said: what it says of itself (user data)."""

    key: bytes
    name: str
    addresses: tuple[str, ...]
    said: dict[str, str]


class Discovery:
    """Reads Cyclone DDS's built-in topics and the nodes that ROS 2 announces."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._participants: Any = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant)
        self._writers: Any = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        self._readers: Any = BuiltinDataReader(participant, BuiltinTopicDcpsSubscription)
        announced = sample_class_of(DISCOVERY, _discovery(16), NodesCodec())
        topic: Any = Topic(participant, "ros_discovery_info", announced)
        self._nodes: Any = DataReader(participant, topic, qos=qos(latched=True))
        self._announced: dict[bytes, Message] = {}

    def participants(self) -> list[Participant]:
        """All that are alive, this one included."""
        return [_participant(one) for one in _alive(self._participants)]

    def publishers(self) -> list[Endpoint]:
        """Of ROS topics."""
        return [found for found in map(_endpoint, _alive(self._writers)) if found is not None]

    def subscriptions(self) -> list[Endpoint]:
        """Of ROS topics."""
        return [found for found in map(_endpoint, _alive(self._readers)) if found is not None]

    def graph(self) -> Graph:
        """As it is known now. A node that ROS 2 does not announce goes by its participant's name."""
        people = {p.key: p.name for p in self.participants()}
        owners, nodes = self._owners(people)
        said, heard = self.publishers(), self.subscriptions()
        types = {e.topic: e.type_name for e in (*heard, *said)}

        def names(endpoints: list[Endpoint], topic: str) -> tuple[str, ...]:
            found = {owners.get(e.key) or people.get(e.participant, "?") for e in endpoints if e.topic == topic}
            return tuple(sorted(found))

        topics = tuple(TopicInfo(t, types[t], names(said, t), names(heard, t)) for t in sorted(types))
        return Graph(tuple(sorted(nodes)), topics)

    def _owners(self, people: dict[bytes, str]) -> tuple[dict[bytes, str], set[str]]:
        """Endpoint -> node, and all nodes."""
        for sample in self._nodes.take(MOST):
            if not isinstance(sample, InvalidSample) and not isinstance(sample.message, ParseError):
                self._announced[_gid(sample.message["gid"])] = sample.message
        owners: dict[bytes, str] = {}
        nodes: set[str] = set()
        for key, name in people.items():
            announced = self._announced.get(key)
            if announced is None:
                nodes.add(name)
                continue
            for node in announced["nodes"]:
                full = f"{node['node_namespace'].rstrip('/')}/{node['node_name']}"
                nodes.add(full)
                owners |= {_gid(gid): full for gid in (*node["readers"], *node["writers"])}
        self._announced = {key: value for key, value in self._announced.items() if key in people}
        return owners, nodes


def _gid(gid: Message) -> bytes:
    return bytes(gid["data"])[:16]


def _alive(reader: Any) -> list[Any]:
    found = reader.read(MOST)
    return [s for s in found if s.sample_info.valid_data and s.sample_info.instance_state == InstanceState.Alive]


def _endpoint(sample: Any) -> Endpoint | None:
    topic, type_name = ros_topic(sample.topic_name), ros_name(sample.type_name)
    if topic is None or type_name is None:
        return None
    return Endpoint(sample.key.bytes, sample.participant_key.bytes, topic, type_name)


def _participant(sample: Any) -> Participant:
    key = sample.key.bytes
    policies: dict[str, Any] = {}
    addresses: tuple[str, ...] = ()
    for policy in sample.qos:
        if isinstance(policy, Policy.EntityName):
            policies["name"] = policy.name
        elif isinstance(policy, Policy.Userdata):
            policies["said"] = policy.data.decode("utf-8", "replace")
        elif getattr(policy, "key", "") == "__NetworkAddresses":
            addresses = tuple(_host(text) for text in policy.value.split(",") if text)
    said = dict(text.split("=", 1) for text in policies.get("said", "").split(";") if "=" in text)
    return Participant(key, policies.get("name") or f"unknown_{key[:12].hex()}", addresses, said)


def _host(locator: str) -> str:
    """The host in "udp/192.168.1.5:7410@2"; "localprocess" as it is."""
    found = re.match(r"\w+/\[?([^\]@]+?)\]?:\d+(@\d+)?$", locator)
    return found[1] if found else locator

"""A recording as others open it: rosbags, the mcap package, and what rosbag2 expects of metadata.yaml."""

from __future__ import annotations

import functools
import math

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from linkrover.bag import read_recording
from linkrover.bag.frames import read_frames
from linkrover.bag.metadata import BagInfo, TopicInfo, metadata_yaml, qos
from linkrover.messages import Codec, from_message, messages_of, record_types, texts, to_message
from linkrover.messages.schema import parse_definitions
from linkrover.records import LinkUtilization, Manifest, NetworkDelay, Pose, WirelessLink
from tests.messages.strategies import any_record

from .ros1_bags import Maker, ros1_message, samples_of_2021
from .samples import T0, manifest, record_all

# the typestore generates its own functions by the definitions in the file: an independent serializer


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "robot"
    return path, record_all(path, 100)


@pytest.fixture(scope="module")
def store():
    found = get_typestore(Stores.ROS2_HUMBLE)
    types = {}
    for package in texts.PACKAGES:
        for name in texts.names(package):
            definition = texts.text(name).replace("\nHeader header", "\nstd_msgs/Header header")
            definition = "std_msgs/" + definition if definition.startswith("Header ") else definition
            types.update(get_types_from_msg(definition, name.replace("/", "/msg/")))
    found.register(types)
    return found


def test_rosbags_opens_it_and_decodes_every_message(recorded):
    path, _ = recorded
    with AnyReader([path]) as reader:
        manifests = [
            from_message(Manifest, reader.deserialize(raw, connection.msgtype))
            for connection, _, raw in reader.messages()
            if connection.topic == "/robot/linkrover/manifest"
        ]
        assert manifests == [manifest()]
        probes = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/robot/linkrover/probe_result"
        ]
        assert [p.sequence for p in probes] == list(range(100))
        assert {c.msgtype for c in reader.connections if c.topic == "/robot/odom"} == {"nav_msgs/msg/Odometry"}
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def test_rosbags_sees_the_quality_of_service(recorded):
    path, _ = recorded
    with AnyReader([path]) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    (latched,) = offered["/robot/linkrover/manifest"]
    assert latched.durability is QosDurability.TRANSIENT_LOCAL
    assert latched.depth == 1
    (plain,) = offered["/robot/wlan0/linkrover/wireless_link"]
    assert plain.durability is QosDurability.VOLATILE
    assert plain.reliability is QosReliability.RELIABLE


def test_the_mcap_package_opens_it_by_its_index_and_its_checksums_hold(recorded):
    path, written = recorded
    with (path / "robot.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics.message_count == read_recording(path).messages
        assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
        links = list(reader.iter_messages(topics=["/robot/wlan0/linkrover/wireless_link"]))
        assert len(links) == 100
        schema, channel, message = links[0]
        assert (schema.name, schema.encoding) == ("linkrover_msgs/msg/WirelessLink", "ros2msg")
        assert channel.message_encoding == "cdr"
        codec = Codec("linkrover_msgs/WirelessLink", texts.definitions("linkrover_msgs/WirelessLink"))
        assert from_message(WirelessLink, codec.decode(message.data)) == written[1]
        found = {m.name: m.metadata for m in reader.iter_metadata()}
    assert msgspec.json.decode(found["linkrover"]["manifest"], type=Manifest) == manifest()


def test_the_mcap_package_finds_messages_by_time(recorded):
    path, _ = recorded
    with (path / "robot.mcap").open("rb") as file:
        some = list(make_reader(file).iter_messages(starting_at=T0 + 10**9, ending_before=T0 + 2 * 10**9))
    assert {m.log_time // 10**8 - T0 // 10**8 for _, _, m in some} == set(range(10, 20))


def test_metadata_yaml_says_what_rosbag2_asks_for(recorded):
    path, _ = recorded
    info = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert info["version"] == 8
    assert info["storage_identifier"] == "mcap"
    assert info["relative_file_paths"] == ["robot.mcap"]
    assert info["message_count"] == sum(t["message_count"] for t in info["topics_with_message_count"])
    assert info["message_count"] == info["files"][0]["message_count"] == read_recording(path).messages
    assert info["starting_time"]["nanoseconds_since_epoch"] == T0
    assert info["duration"]["nanoseconds"] == 99 * 100_000_000
    for topic in info["topics_with_message_count"]:
        (profile,) = yaml.safe_load(topic["topic_metadata"]["offered_qos_profiles"])
        assert profile["history"] == 1
        assert set(profile) == {
            "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
            "liveliness_lease_duration", "avoid_ros_namespace_conventions",
        }  # fmt: skip
    assert msgspec.json.decode(info["custom_data"]["manifest"], type=Manifest) == manifest()


def test_any_text_survives_metadata_yaml():
    nasty = 'a"b\\c\n\t\x00\x7f\x85\u2028: - #é😀'
    info = BagInfo("a b.mcap", 0, 0, [TopicInfo("/t", "p/msg/T", qos(), 1)], {"k": nasty})
    assert yaml.safe_load(metadata_yaml(info))["rosbag2_bagfile_information"]["custom_data"] == {"k": nasty}
    assert yaml.safe_load(metadata_yaml(BagInfo("x", 0, 0, [])))["rosbag2_bagfile_information"]["message_count"] == 0


def rosbags_message(store, name: str, message: dict):
    values = {}
    for field in texts.definitions(name)[name]:
        value = message[field.name]
        if "/" in field.type:
            one = [rosbags_message(store, field.type, v) for v in ([value] if field.count is None else value)]
            value = one[0] if field.count is None else one
        elif field.count is not None and field.type == "float64":
            value = np.array(value, dtype=np.float64)
        values[field.name] = list(value) if isinstance(value, tuple) else value
    return store.types[name.replace("/", "/msg/")](**values)


@given(any_record)
@settings(max_examples=150, deadline=None)
def test_our_bytes_are_those_of_rosbags_serializer(store, record):
    for _, name, message in messages_of(record, "robot"):
        ours = Codec(name, texts.definitions(name)).encode(message)
        theirs = bytes(store.serialize_cdr(rosbags_message(store, name, message), name.replace("/", "/msg/")))
        # rosbags pads the end of a message to a multiple of four; nothing reads that
        assert theirs[: len(ours)] == ours
        assert not any(theirs[len(ours) :])


@given(any_record)
@settings(max_examples=100, deadline=None)
def test_our_ros_1_bytes_are_those_of_rosbags_serializer(record):
    store = _ros1_store()
    name = f"linkrover_msgs/{type(record).__name__}"
    definition, _ = store.generate_msgdef(name.replace("/", "/msg/"), ros_version=1)
    codec = Codec(name, parse_definitions(definition, name), ros1=True)
    message = to_message(record, "robot")
    message["header"]["seq"] = 0
    theirs = bytes(store.serialize_ros1(ros1_message(store, name, message), name.replace("/", "/msg/")))
    assert codec.encode(message) == theirs
    assert from_message(type(record), codec.decode(theirs)) == record


@functools.cache
def _ros1_store():
    found = get_typestore(Stores.ROS1_NOETIC)
    types = {}
    for name in texts.names("linkrover_msgs"):
        types.update(get_types_from_msg(texts.text(name), name.replace("/", "/msg/")))
    found.register(types)
    return found


def test_every_record_type_is_known_to_the_test_typestore(store):
    assert {f"linkrover_msgs/msg/{k.__name__}" for k in record_types()} <= set(store.types)


def rosbag2_of_2021(path, store, version: int = 9):
    """The 2021 topics in a rosbag2 MCAP as another tool writes it."""
    make = Maker(store, ros1=False)
    forever = QosTime(9223372036, 854775807)
    offered = Qos(
        QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE, forever, forever,
        QosLiveliness.AUTOMATIC, forever, avoid_ros_namespace_conventions=False,
    )  # fmt: skip
    with Writer(path, version=version, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, kind, ns, message in samples_of_2021(make):
            name = kind.replace("/", "/msg/")
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store, offered_qos_profiles=[offered])
            writer.write(connections[topic], ns, store.serialize_cdr(message, name))
    return path


@pytest.mark.parametrize("version", [8, 9])
def test_a_rosbag2_recording_of_another_tool_is_read(tmp_path, store, version):
    path = rosbag2_of_2021(tmp_path / "bag", store, version)
    recording = read_recording(path)
    assert recording.problems == ()
    assert recording.manifest is None
    ends = {(end, type(record)) for end, record in recording.entries()}
    assert ("station", LinkUtilization) in ends
    assert ("robot", Pose) in ends
    frames = read_frames(path)
    assert len(frames[LinkUtilization]) == 40
    assert len(frames[Pose]) == 50
    delays = [r.delay_ns for r in recording.records(NetworkDelay) if isinstance(r, NetworkDelay)]
    assert delays.count(None) == 1
    assert not any(math.isnan(x) for x in frames[Pose]["x_m"])

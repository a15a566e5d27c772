"""ROS 1 bags of the 2021 package: read as records of both ends, also those the real rosbag wrote."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_types_from_msg

from linkrover.bag import TopicPattern, load_patterns, read_recording
from linkrover.bag.patterns import DEFAULT_PATTERNS
from linkrover.errors import ConfigError
from linkrover.messages import messages_of, texts
from linkrover.records import (
    Continuity,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    VelocityCommand,
    WirelessLink,
)

from .ros1_bags import STARTED, Maker, bag_of_2021, ros1_message, samples_of_2021, typestore
from .samples import T0, record_number


def test_both_ends_and_interfaces_are_told_apart(tmp_path):
    recording = read_recording(bag_of_2021(tmp_path / "a.bag"))
    assert recording.problems == ()
    assert recording.format == "ros1 bag"
    found = {(end, type(r).__name__, getattr(r, "iface", "")) for end, r in recording.entries()}
    for end in ("robot", "station"):
        for iface in ("wlan0", "wlan1"):
            for kind in ("LinkUtilization", "WirelessLink", "NetworkErrors"):
                assert (end, kind, iface) in found
    assert ("robot", "NetworkDelay", "default") in found


def test_sentinels_are_unknown(tmp_path):
    recording = read_recording(bag_of_2021(tmp_path / "a.bag"))
    links = [
        r for r in recording.records(WirelessLink, end="robot") if isinstance(r, WirelessLink) and r.iface == "wlan0"
    ]
    assert [r.rssi_dbm for r in links[3:6]] == [-53.0, None, -55.0]
    assert all(r.noise_dbm is None for r in links)
    assert [r.connected for r in links[3:6]] == [True, False, True]


def test_a_delay_is_placed_when_it_was_asked_for_not_when_its_node_began(tmp_path):
    recording = read_recording(bag_of_2021(tmp_path / "a.bag"))
    delays = [r for r in recording.records(NetworkDelay) if isinstance(r, NetworkDelay)]
    assert [r.delay_ns for r in delays[4:7]] == [2_500_000, None, 2_500_000]
    assert delays[4].wall_ns == T0 + 4 * 1_050_000_000 - 2_500_000
    assert delays[5].wall_ns == T0 + 5 * 1_050_000_000 - 2_000_000_000
    assert all(r.wall_ns != STARTED for r in delays[1:])


def test_rates_come_from_the_counters_and_a_reset_gives_none(tmp_path):
    recording = read_recording(bag_of_2021(tmp_path / "a.bag"))
    found = [
        r
        for r in recording.records(LinkUtilization, end="station")
        if isinstance(r, LinkUtilization) and r.iface == "wlan1"
    ]
    assert found[0].continuity is Continuity.FIRST
    assert found[0].tx_rate_bps is None
    assert found[1].tx_rate_bps == pytest.approx(1e6 / 1.05)
    assert found[1].interval_ns == 1_050_000_000
    assert found[7].continuity is Continuity.RESET
    assert found[7].tx_rate_bps is None
    assert found[8].continuity is Continuity.STEADY


def test_of_several_velocity_topics_the_teleoperation_is_read(tmp_path):
    recording = read_recording(bag_of_2021(tmp_path / "a.bag"))
    commands = [r for r in recording.records(VelocityCommand) if isinstance(r, VelocityCommand)]
    assert {r.forward_m_per_s for r in commands} == {0.5}
    assert len(commands) == 10
    assert len(list(recording.records(Pose))) == 50


def test_patterns_can_be_given(tmp_path):
    path = bag_of_2021(tmp_path / "a.bag")
    table = tmp_path / "topics.toml"
    table.write_text('[[topic]]\ntopic = "/cmd_vel"\ntype = "geometry_msgs/Twist"\n')
    recording = read_recording(path, patterns=load_patterns(table))
    assert {r.forward_m_per_s for r in recording.records(VelocityCommand) if isinstance(r, VelocityCommand)} == {0.4}
    none = read_recording(path, patterns=[TopicPattern(r"/odom", end="station")])
    assert {(end, type(r)) for end, r in none.entries()} == {("station", Pose)}
    assert len(load_patterns(table)) == len(DEFAULT_PATTERNS) + 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[topic]]\ntopic = "("\n', "regular expression"),
        ('[[topic]]\ntype = "x"\n', "topic"),
        ('[[topic]]\ntopic = "x"\nends = "robot"\n', "ends"),
        ('[[topic]]\ntopic = "x"\nend = "moon"\n', "moon"),
        ('[[topics]]\ntopic = "x"\n', "topics"),
        ("[[", "t.toml"),
    ],
)
def test_a_table_that_cannot_be_used_says_why(tmp_path, text, said):
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        load_patterns(tmp_path / "t.toml")
    with pytest.raises(ConfigError):
        load_patterns(tmp_path / "absent.toml")


_REAL = """
import sys
from pathlib import Path
import genpy, genpy.dynamic, rosbag
from rosbags.typesys import Stores
from tests.bag.ros1_bags import Maker, samples_of_2021, typestore

store = typestore()
classes = {}
def real(kind):
    if kind not in classes:
        text, _ = store.generate_msgdef(kind.replace("/", "/msg/"), ros_version=1)
        classes[kind] = genpy.dynamic.generate_dynamic(kind, text)[kind]
    return classes[kind]

path, compression = sys.argv[1:]
with rosbag.Bag(path, "w", compression=compression, chunk_threshold=4096) as bag:
    for topic, kind, ns, message in samples_of_2021(Maker(store), 20):
        one = real(kind)()
        one.deserialize(bytes(store.serialize_ros1(message, kind.replace("/", "/msg/"))))
        bag.write(topic, one, genpy.Time(ns // 10**9, ns % 10**9))
"""


@pytest.mark.ros1
@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_of_the_real_rosbag_reads_like_one_of_rosbags(tmp_path, compression):
    pytest.importorskip("rosbag", reason="needs Debian's python3-rosbag (make test installs it)")
    root = Path(__file__).parents[2]
    real = tmp_path / "real.bag"
    done = subprocess.run(
        [sys.executable, "-c", _REAL, real, compression],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    other = bag_of_2021(tmp_path / "other.bag", seconds=20)
    recording = read_recording(real)
    assert recording.problems == ()
    ours = sorted(map(repr, recording.entries()))
    assert ours == sorted(map(repr, read_recording(other).entries()))
    assert len(ours) == 20 * (12 + 1 + 1 + 5)
    data = real.read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(data[: len(data) // 2])
    damaged = read_recording(cut)
    assert damaged.messages > 100
    assert damaged.problems
    assert list(damaged.records(NetworkErrors))


def test_the_samples_cover_every_2021_type_a_bag_holds():
    kinds = {kind for _, kind, _, _ in samples_of_2021(Maker(typestore()), 1)}
    assert len(kinds) == 6


def test_our_own_topics_recorded_by_rosbag_come_back_whole(tmp_path):
    """`rosbag record` on a graph where our nodes publish: full and 2021 types side by side, read once."""
    store = typestore()
    types = {}
    for name in texts.names("linkrover_msgs"):
        types.update(get_types_from_msg(texts.text(name), name.replace("/", "/msg/")))
    store.register(types)
    wanted = [record for n in range(20) for record in record_number(n)]
    with Writer(tmp_path / "a.bag") as writer:
        connections = {}
        for record in wanted:
            for topic, name, message in messages_of(record, "station"):
                kind = name.replace("/", "/msg/")
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                raw = store.serialize_ros1(ros1_message(store, name, message), kind)
                writer.write(connections[topic], record.wall_ns, raw)
    recording = read_recording(tmp_path / "a.bag")
    assert list(recording.records()) == wanted
    assert recording.end == "station"

"""ROS 1 bags like those of the 2021 package, written by rosbags."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from linkrover.messages import texts

from .samples import T0

STARTED = T0 - 1_000_000_000  # when the 2021 delay node began: the stamp of its every sample


def typestore(store: Stores = Stores.ROS1_NOETIC):
    found = get_typestore(store)
    types = {}
    for name in texts.names("network_analysis"):
        types.update(get_types_from_msg(texts.text(name), name.replace("/", "/msg/")))
    found.register(types)
    return found


class Maker:
    """Makes messages of a typestore from plain values."""

    def __init__(self, store, ros1: bool = True) -> None:
        self.store = store
        self.ros1 = ros1

    def __call__(self, name: str, **values):
        return self.store.types[name.replace("/", "/msg/")](**values)

    def header(self, ns: int, frame: str = ""):
        stamp = self("builtin_interfaces/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self("std_msgs/Header", stamp=stamp, frame_id=frame, **sequence)

    def utilization(self, ns: int, iface: str, tx_bytes: int):
        return self(
            "network_analysis/LinkUtilization", header=self.header(ns), iface=iface, tcp_tx_segments=tx_bytes // 1000,
            tcp_rx_segments=5, tcp_tx_segmentrate=1.0, tcp_rx_segmentrate=0.0, udp_tx_datagrams=7, udp_rx_datagrams=8,
            udp_tx_datagramrate=0.0, udp_rx_datagramrate=0.0, total_tx_packets=9, total_tx_bytes=tx_bytes,
            total_rx_packets=3, total_rx_bytes=4, total_tx_mbps=1.0, total_rx_mbps=0.0,
        )  # fmt: skip

    def wireless(self, ns: int, iface: str, rssi: int):
        return self(
            "network_analysis/WirelessLink", header=self.header(ns), iface=iface, ssid="lab", status=rssi > -256,
            txpower=20, rssi=rssi, lqi=60.0, noise=-256,
        )  # fmt: skip

    def errors(self, ns: int, iface: str, count: int):
        return self(
            "network_analysis/NetworkErrors", header=self.header(ns), iface=iface, retransmits=count, badsegments=0,
            udperrors=0, tx_retires=count * 2, rx_dropped=0, nic_tx_errors=0, nic_rx_errors=0, nic_tx_dropped=0,
            nic_rx_dropped=0,
        )  # fmt: skip

    def delay(self, ns: int, ms: float):
        return self("network_analysis/NetworkDelay", header=self.header(ns), iface="default", delay=ms, alive=ms >= 0)

    def odometry(self, ns: int, x: float, heading: float):
        zero = np.zeros(36)
        point = self("geometry_msgs/Point", x=x, y=0.0, z=0.0)
        turn = self("geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
        pose = self("geometry_msgs/Pose", position=point, orientation=turn)
        return self(
            "nav_msgs/Odometry",
            header=self.header(ns, "odom"),
            child_frame_id="base_link",
            pose=self("geometry_msgs/PoseWithCovariance", pose=pose, covariance=zero),
            twist=self("geometry_msgs/TwistWithCovariance", twist=self.twist(0.5, 0.1), covariance=zero),
        )

    def twist(self, forward: float, turn: float):
        return self(
            "geometry_msgs/Twist",
            linear=self("geometry_msgs/Vector3", x=forward, y=0.0, z=0.0),
            angular=self("geometry_msgs/Vector3", x=0.0, y=0.0, z=turn),
        )


def ros1_message(store, name: str, message: dict):
    make = Maker(store)
    values = {}
    for field in texts.definitions(name)[name]:
        value = message[field.name]
        if field.type == "std_msgs/Header":
            stamp = value["stamp"]
            value = make.header(stamp["sec"] * 10**9 + stamp["nanosec"], value["frame_id"])
        elif "/" in field.type:
            one = [ros1_message(store, field.type, v) for v in ([value] if field.count is None else value)]
            value = one[0] if field.count is None else one
        elif field.count is not None and field.type == "float64":
            value = np.array(value, dtype=np.float64)
        values[field.name] = list(value) if isinstance(value, tuple) else value
    return store.types[name.replace("/", "/msg/")](**values)


def samples_of_2021(make: Maker, seconds: int = 10):
    """(topic, type, arrival ns, message): both ends, two interfaces, one delay stamp for ever, as recorded in 2021."""
    for second in range(seconds):
        ns = T0 + second * 1_050_000_000
        for end in ("robot", "server"):
            for number in (1, 2):
                iface = f"wlan{number - 1}"
                place = f"/{end}/iface{number}/network_analysis"
                tx_bytes = 125_000 * second if second != 7 else 0  # the counter was reset
                utilization = make.utilization(ns, iface, tx_bytes)
                yield f"{place}/link_utilization", "network_analysis/LinkUtilization", ns, utilization
                wireless = make.wireless(ns, iface, -256 if second == 4 else -50 - second)
                yield f"{place}/wireless_quality", "network_analysis/WirelessLink", ns, wireless
                yield f"{place}/network_errors", "network_analysis/NetworkErrors", ns, make.errors(ns, iface, second)
        delay = -1.0 if second == 5 else 2.5
        yield "/network_analysis/network_delay", "network_analysis/NetworkDelay", ns, make.delay(STARTED, delay)
        yield "/teleop_velocity_smoother/raw_cmd_vel", "geometry_msgs/Twist", ns, make.twist(0.5, 0.0)
        yield "/cmd_vel", "geometry_msgs/Twist", ns, make.twist(0.4, 0.0)
        for n in range(5):
            at = ns + n * 20_000_000
            yield "/odom", "nav_msgs/Odometry", at, make.odometry(at, 0.1 * n, 0.01 * n)


def bag_of_2021(path: Path, compression: str = "none", seconds: int = 10) -> Path:
    store = typestore()
    make = Maker(store)
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(getattr(Writer.CompressionFormat, compression.upper()))
    with writer:
        connections = {}
        for topic, kind, ns, message in samples_of_2021(make, seconds):
            name = kind.replace("/", "/msg/")
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(connections[topic], ns, store.serialize_ros1(message, name))
    return path

"""Our bytes are those of cyclonedds' own serialiser, which real ROS 2 nodes were seen to read."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings

from linkrover.errors import LinkRoverError, ParseError
from linkrover.messages import Codec, messages_of, texts
from linkrover.records import Pose, Record, VelocityCommand
from linkrover.ros2.types import complete, dds_name, definitions, idl_class, ros_name, sample_class
from tests.messages.strategies import any_record
from tests.middleware.contract import ODOMETRY, TWIST

HEADER = {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "wlan0"}
STANDARD = {
    "nav_msgs/Odometry": ODOMETRY,
    "geometry_msgs/Twist": TWIST,
    "geometry_msgs/TwistStamped": {"header": HEADER, "twist": TWIST},
    "std_msgs/Header": HEADER,
    "network_analysis/NetworkAnalysis": {
        "header": HEADER,
        "delay": [{"iface": "a", "delay": -1.0}, {"iface": "bcd", "delay": 2.5, "alive": True}],
        "quality": [{"ssid": "x", "rssi": -60}],
        "errors": [],
        "utilization": [{"total_rx_bytes": 2**40}],
    },
    "network_analysis/WirelessLinkVector": {"wireless_quality": [{"iface": "wlan0", "status": True, "lqi": 0.5}] * 2},
    "diagnostic_msgs/DiagnosticArray": {
        "header": HEADER,
        "status": [{"level": 2, "name": "a", "values": [{"key": "k", "value": "v"}] * 2}],
    },
}
# classes take their time to make; each is made once
CLASSES: dict[str, Any] = {}


def as_object(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{key: as_object(one) for key, one in value.items()})
    return [as_object(one) for one in value] if isinstance(value, (list, tuple)) else value


def cyclonedds_bytes(name: str, message: dict[str, Any]) -> bytes:
    if name not in CLASSES:
        CLASSES[name] = idl_class(name, definitions(name))
    return bytes(CLASSES[name].__idl__.serialize(as_object(message), use_version_2=False))


@pytest.mark.parametrize("name", [*texts.names("network_analysis"), *texts.names("linkrover_msgs"), *STANDARD])
def test_every_type_has_the_bytes_of_cyclonedds(name: str) -> None:
    message = complete(name, STANDARD.get(name, {}))
    data = sample_class(name)(message).serialize()
    assert data == cyclonedds_bytes(name, message)
    assert sample_class(name).deserialize(data).message == Codec(name, definitions(name)).decode(data)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(any_record)
def test_any_record_has_the_bytes_of_cyclonedds(record: Record) -> None:
    for _, name, message in messages_of(record, "robot", compatible=isinstance(record, (Pose, VelocityCommand))):
        assert sample_class(name)(message).serialize() == cyclonedds_bytes(name, message)


def test_what_cyclonedds_wrote_is_read() -> None:
    message = complete("nav_msgs/Odometry", ODOMETRY)
    read = sample_class("nav_msgs/Odometry").deserialize(cyclonedds_bytes("nav_msgs/Odometry", message)).message
    assert isinstance(read, dict)
    assert read["pose"]["pose"]["position"] == {"x": 1.5, "y": -2.5, "z": 0.0}


def test_names_are_mangled_as_ros_2_does() -> None:
    assert dds_name("geometry_msgs/Twist") == "geometry_msgs::msg::dds_::Twist_"
    assert ros_name("geometry_msgs::msg::dds_::Twist_") == "geometry_msgs/msg/Twist"
    assert ros_name("HelloWorld") is None
    made = sample_class("nav_msgs/Odometry")
    assert made.__idl__.idl_transformed_typename == "nav_msgs::msg::dds_::Odometry_"  # type: ignore[attr-defined]


def test_bytes_of_another_type_are_one_bad_sample() -> None:
    assert isinstance(sample_class("nav_msgs/Odometry").deserialize(b"\0\1\0\0\1\2\3").message, ParseError)


def test_a_field_the_type_does_not_have_is_named() -> None:
    with pytest.raises(LinkRoverError, match="no field 'lineal'"):
        complete("geometry_msgs/Twist", {"lineal": {}})


def test_a_type_that_is_not_known_is_named() -> None:
    with pytest.raises(LinkRoverError, match="foo_msgs/Bar"):
        sample_class("foo_msgs/Bar")

"""Odometry and velocity commands from whatever definition their publisher sends."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Any

import genpy
import rospy

from linkrover.records import Pose, VelocityCommand, now

from .types import class_from_definition

log = logging.getLogger("linkrover.ros1")


class _Described:
    """A subscription that reads messages by the definition in the connection header."""

    def __init__(self, topic: str, expected: tuple[str, ...]) -> None:
        self._topic = topic
        self._expected = expected
        self._classes: dict[str, Any] = {}
        self._refused: set[str] = set()
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._received, queue_size=10, tcp_nodelay=True)

    def close(self) -> None:
        """Unregister."""
        self._subscriber.unregister()

    def _received(self, message: Any) -> None:
        header = message._connection_header
        type_name, md5 = header.get("type", "?"), header.get("md5sum", "?")
        if type_name not in self._expected:
            if type_name not in self._refused:
                self._refused.add(type_name)
                log.error(
                    "%s carries %s, expected %s: not recorded", self._topic, type_name, " or ".join(self._expected)
                )
            return
        if md5 not in self._classes:
            self._classes[md5] = class_from_definition(type_name, header.get("message_definition", ""))
        decoded = self._classes[md5]()
        try:
            decoded.deserialize(message._buff)
            self._take(decoded)
        except (genpy.DeserializationError, AttributeError, ValueError) as error:
            if md5 not in self._refused:
                self._refused.add(md5)
                log.error("%s: a %s that cannot be read: %s", self._topic, type_name, error)

    def _take(self, message: Any) -> None:
        raise NotImplementedError


class Odometry(_Described):
    """nav_msgs/Odometry -> Pose; the record is stamped on arrival, by this machine's clocks."""

    def __init__(self, topic: str, take: Callable[[Pose], None]) -> None:
        self._taker = take
        super().__init__(topic, ("nav_msgs/Odometry",))

    def _take(self, message: Any) -> None:
        instant = now()
        pose, twist = message.pose.pose, message.twist.twist
        self._taker(
            Pose(
                wall_ns=instant.wall_ns,
                mono_ns=instant.mono_ns,
                x_m=pose.position.x,
                y_m=pose.position.y,
                heading_rad=yaw(pose.orientation),
                forward_m_per_s=twist.linear.x,
                turn_rad_per_s=twist.angular.z,
                frame=message.header.frame_id or "odom",
            )
        )


class Velocity(_Described):
    """geometry_msgs/Twist or TwistStamped -> VelocityCommand."""

    def __init__(self, topic: str, take: Callable[[VelocityCommand], None]) -> None:
        self._taker = take
        super().__init__(topic, ("geometry_msgs/Twist", "geometry_msgs/TwistStamped"))

    def _take(self, message: Any) -> None:
        instant = now()
        twist = message.twist if hasattr(message, "twist") else message
        self._taker(
            VelocityCommand(
                wall_ns=instant.wall_ns,
                mono_ns=instant.mono_ns,
                forward_m_per_s=twist.linear.x,
                sideways_m_per_s=twist.linear.y,
                turn_rad_per_s=twist.angular.z,
            )
        )


def yaw(q: Any) -> float:
    """Heading of a quaternion in radians, -pi..pi."""
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))

"""Pose <-> nav_msgs/Odometry and VelocityCommand <-> geometry_msgs/Twist, TwistStamped."""

from __future__ import annotations

import math
from typing import Any

from linkrover.errors import ParseError
from linkrover.records import Pose, Record, VelocityCommand

from .mapping import get, header, stamp_ns
from .wire import Message

_NO_COVARIANCE = [0.0] * 36
BASE_FRAME = "base_link"


def to_standard(record: Record) -> tuple[str, Message] | None:
    """(message type, message) of a pose or velocity command, else None."""
    if isinstance(record, Pose):
        return "nav_msgs/Odometry", _odometry(record)
    if isinstance(record, VelocityCommand):
        return "geometry_msgs/Twist", _twist(record.forward_m_per_s, record.sideways_m_per_s, record.turn_rad_per_s)
    return None


def _odometry(record: Pose) -> Message:
    half = record.heading_rad / 2 if math.isfinite(record.heading_rad) else math.nan
    return {
        "header": header(record.wall_ns, record.frame),
        "child_frame_id": BASE_FRAME,
        "pose": {
            "pose": {
                "position": {"x": record.x_m, "y": record.y_m, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
            },
            "covariance": _NO_COVARIANCE,
        },
        "twist": {
            "twist": _twist(_or_nan(record.forward_m_per_s), 0.0, _or_nan(record.turn_rad_per_s)),
            "covariance": _NO_COVARIANCE,
        },
    }


def _twist(forward: float, sideways: float, turn: float) -> Message:
    return {"linear": {"x": forward, "y": sideways, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": turn}}


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def heading(x: float, y: float, z: float, w: float) -> float:
    """Rotation about z (rad, -pi..pi) of a quaternion that need not be of unit length."""
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def from_odometry(message: Any) -> Pose:
    """The planar pose in a nav_msgs/Odometry; mono_ns is the stamp. Raises ParseError."""
    try:
        pose = get(get(message, "pose"), "pose")
        twist = get(get(message, "twist"), "twist")
        turn = get(pose, "orientation")
        position = get(pose, "position")
        wall_ns = stamp_ns(message)
        return Pose(
            wall_ns=wall_ns,
            mono_ns=wall_ns,
            x_m=float(get(position, "x")),
            y_m=float(get(position, "y")),
            heading_rad=heading(*(float(get(turn, axis)) for axis in "xyzw")),
            forward_m_per_s=_known(get(get(twist, "linear"), "x")),
            turn_rad_per_s=_known(get(get(twist, "angular"), "z")),
            frame=str(get(get(message, "header"), "frame_id")),
        )
    except (KeyError, AttributeError, TypeError, ValueError) as error:
        raise ParseError("nav_msgs/Odometry", "message", "an odometry message", str(error)) from None


def from_twist(message: Any, received_ns: int) -> VelocityCommand:
    """The command in a geometry_msgs/Twist or TwistStamped, at `received_ns` or its stamp. Raises ParseError."""
    try:
        stamped = "twist" in message if isinstance(message, dict) else hasattr(message, "twist")
        twist = get(message, "twist") if stamped else message
        wall_ns = (stamp_ns(message) if stamped else 0) or received_ns
        return VelocityCommand(
            wall_ns=wall_ns,
            mono_ns=wall_ns,
            forward_m_per_s=float(get(get(twist, "linear"), "x")),
            sideways_m_per_s=float(get(get(twist, "linear"), "y")),
            turn_rad_per_s=float(get(get(twist, "angular"), "z")),
        )
    except (KeyError, AttributeError, TypeError, ValueError) as error:
        raise ParseError("geometry_msgs/Twist", "message", "a velocity command", str(error)) from None


def _known(value: Any) -> float | None:
    return None if math.isnan(value) else float(value)

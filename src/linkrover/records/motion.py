"""Where the robot is and what it was told."""

from __future__ import annotations

from .base import Record


class Pose(Record, frozen=True, kw_only=True):
    """Planar pose and velocity from odometry, metres, radians, m/s, rad/s, in frame `frame`."""

    x_m: float
    y_m: float
    heading_rad: float
    forward_m_per_s: float | None = None
    turn_rad_per_s: float | None = None
    frame: str = "odom"


class VelocityCommand(Record, frozen=True, kw_only=True):
    """A velocity command as it arrived at the robot, m/s and rad/s."""

    forward_m_per_s: float
    turn_rad_per_s: float
    sideways_m_per_s: float = 0.0

"""A robot that drives by script, for programs that bring their own traffic: its true pose goes to the relay."""

from __future__ import annotations

import contextlib
import socket
import time

from linkrover.agent.feed import FeedSender
from linkrover.emulator.robot import Drive, Operator, Robot, Route
from linkrover.emulator.traffic import POSE
from linkrover.records import now


class Scripted:
    """Drives the route again and again; still_m: stands at that distance along the x axis instead. feed_path: the
    agent's feed, for odometry.
    """

    def __init__(
        self, route: Route, drive: Drive, pose_path: str, still_m: float | None = None, feed_path: str | None = None
    ) -> None:
        self.route = route
        self.drive = drive
        self.robot = Robot(route, drive)
        self._operator = Operator(route, drive)
        self._still_m = still_m
        self._path = pose_path
        self._feed = None if feed_path is None else FeedSender(feed_path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def step(self) -> None:
        """Move on to now and tell the relay; to be called about 20 times a second."""
        robot, now_ns = self.robot, time.monotonic_ns()
        if self._still_m is not None:
            start = self.route.waypoints[0]
            pose = POSE.pack(start.x_m + self._still_m, start.y_m, 0.0, 0.0, 0.0)
        else:
            robot.command(now_ns, *self._operator.command(now_ns, robot.x_m, robot.y_m, robot.heading_rad))
            robot.step(now_ns)
            if self._operator.done:
                self._operator = Operator(self.route, self.drive)
            pose = POSE.pack(robot.x_m, robot.y_m, robot.heading_rad, robot.forward_m_per_s, robot.turn_rad_per_s)
            if self._feed is not None:
                self._feed.send(robot.odometry(now()))
        # a busy relay misses one pose; the next comes in 50 ms
        with contextlib.suppress(OSError):
            self._socket.sendto(pose, self._path)

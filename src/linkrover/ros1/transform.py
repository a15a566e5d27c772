"""The robot's pose from /tf, where there is no odometry topic: the newest transforms along the chain of frames."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import msgspec
import rospy

from linkrover.records import Pose, now

from .motion import yaw
from .types import class_from_definition


class Planar(msgspec.Struct, frozen=True):
    """A transform in the plane, parent <- child."""

    x_m: float
    y_m: float
    heading_rad: float

    def then(self, inner: Planar) -> Planar:
        """This transform after `inner`."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        turn = self.heading_rad + inner.heading_rad
        return Planar(
            self.x_m + c * inner.x_m - s * inner.y_m,
            self.y_m + s * inner.x_m + c * inner.y_m,
            math.atan2(math.sin(turn), math.cos(turn)),
        )


class FrameTree:
    """The newest transform of each child frame."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Planar]] = {}

    def set(self, parent: str, child: str, transform: Planar) -> None:
        """A transform arrived."""
        self._parents[child.strip("/")] = (parent.strip("/"), transform)

    def find(self, target: str, source: str) -> Planar | None:
        """Where `source` is in `target`, going up from source; None: no such chain (yet)."""
        frame, found = source.strip("/"), Planar(0.0, 0.0, 0.0)
        for _ in range(len(self._parents) + 1):
            if frame == target.strip("/"):
                return found
            above = self._parents.get(frame)
            if above is None:
                return None
            frame, found = above[0], above[1].then(found)
        return None  # a ring


class TransformPoses:
    """Takes a pose of `base` in `frame` whenever a transform of the chain arrives, max_hz times a second at most."""

    def __init__(self, frame: str, base: str, take: Callable[[Pose], None], *, max_hz: float = 20.0) -> None:
        self._frame = frame
        self._base = base
        self._take = take
        self._least_ns = round(1e9 / max_hz)
        self._last_ns = 0
        self._tree = FrameTree()
        self._classes: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._subscribers = [
            rospy.Subscriber(topic, rospy.AnyMsg, self._received, queue_size=20) for topic in ("/tf", "/tf_static")
        ]

    def close(self) -> None:
        """Unregister."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _received(self, message: Any) -> None:
        header = message._connection_header
        md5 = header.get("md5sum", "?")
        with self._lock:
            if md5 not in self._classes:
                self._classes[md5] = class_from_definition(header["type"], header["message_definition"])
            decoded = self._classes[md5]()
            decoded.deserialize(message._buff)
            for stamped in decoded.transforms:
                t = stamped.transform
                planar = Planar(t.translation.x, t.translation.y, yaw(t.rotation))
                self._tree.set(stamped.header.frame_id, stamped.child_frame_id, planar)
            instant = now()
            found = self._tree.find(self._frame, self._base)
            if found is None or instant.mono_ns - self._last_ns < self._least_ns:
                return
            self._last_ns = instant.mono_ns
        self._take(
            Pose(
                wall_ns=instant.wall_ns,
                mono_ns=instant.mono_ns,
                x_m=found.x_m,
                y_m=found.y_m,
                heading_rad=found.heading_rad,
                frame=self._frame,
            )
        )

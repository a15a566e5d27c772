"""The driven path coloured by signal, delay and outage, as visualization_msgs/MarkerArray for rviz."""

from __future__ import annotations

import colorsys
import math
from typing import Any

import msgspec

from linkrover.messages.mapping import header
from linkrover.records import EventKind, LinkEvent, NetworkDelay, Pose, Record, WirelessLink, now

from .protocol import Middleware

LINE_STRIP, TEXT = 4, 9  # visualization_msgs/Marker
CHUNK_POINTS = 50
WHOLE_EVERY = 30
"""Each second only the newest chunk of at most 50 points is sent (about 6 kB); the whole path, for who joined
meanwhile, every 30 s: a picture must not load the link it shows."""
HEIGHTS_M = {"rssi": 0.0, "delay": 0.15, "outage": 0.3}
GREY = {"r": 0.5, "g": 0.5, "b": 0.5, "a": 1.0}


class Point(msgspec.Struct, frozen=True):
    """One place of the path and what the link was like there."""

    x_m: float
    y_m: float
    rssi_dbm: float | None
    delay_ms: float | None
    outage: bool


def ramp(share: float) -> dict[str, float]:
    """Green for 0 (good) over yellow to red for 1 (bad)."""
    r, g, b = colorsys.hsv_to_rgb((1.0 - min(max(share, 0.0), 1.0)) / 3.0, 1.0, 0.9)
    return {"r": r, "g": g, "b": b, "a": 1.0}


def colour(point: Point, quantity: str) -> dict[str, float]:
    """rssi: green at -45 dBm, red at -85; delay: green at 3 ms, red at 1 s (logarithmic); outage: green or red."""
    if quantity == "rssi":
        return GREY if point.rssi_dbm is None else ramp((-45.0 - point.rssi_dbm) / 40.0)
    if quantity == "delay":
        if point.delay_ms is None:
            return GREY
        return ramp(math.log10(max(point.delay_ms, 3.0) / 3.0) / math.log10(1000.0 / 3.0))
    return ramp(1.0 if point.outage else 0.0)


class PathMarkers:
    """A sink that follows the robot; publish() once a second.

    A point is kept every step_m of way and whenever an outage begins or ends.
    """

    def __init__(self, middleware: Middleware, topic: str, *, step_m: float = 0.1, limit: int = 20_000) -> None:
        self._middleware = middleware
        self._topic = topic
        self._step_m = step_m
        self._limit = limit
        self._frame = "odom"
        self._points: list[Point] = []
        self._rssi_dbm: float | None = None
        self._delay_ms: float | None = None
        self._outage = False
        self._turn = 0

    def take(self, record: Record) -> None:
        """Remember what the link is like, and where."""
        if isinstance(record, WirelessLink):
            if record.peer is None or self._rssi_dbm is None:
                self._rssi_dbm = record.rssi_dbm
        elif isinstance(record, NetworkDelay):
            self._delay_ms = None if record.delay_ns is None else record.delay_ns / 1e6
        elif isinstance(record, LinkEvent):
            if record.kind in (EventKind.OUTAGE_BEGAN, EventKind.OUTAGE_ENDED):
                self._outage = record.kind is EventKind.OUTAGE_BEGAN
        elif isinstance(record, Pose):
            self._move(record)

    def close(self) -> None:
        """Nothing is held."""

    def publish(self) -> None:
        """Say the newest part of the path, all of it every WHOLE_EVERY turns."""
        if not self._points:
            return
        chunks = range((len(self._points) - 1) // CHUNK_POINTS + 1)
        wanted = chunks if self._turn % WHOLE_EVERY == 0 else chunks[-2:]
        self._turn += 1
        stamp = header(now().wall_ns, self._frame)
        markers = [self._strip(chunk, quantity, stamp) for chunk in wanted for quantity in HEIGHTS_M]
        markers.append(self._label(stamp))
        self._middleware.publish(self._topic, "visualization_msgs/MarkerArray", {"markers": markers})

    def _move(self, pose: Pose) -> None:
        self._frame = pose.frame
        point = Point(pose.x_m, pose.y_m, self._rssi_dbm, self._delay_ms, self._outage)
        if self._points:
            last = self._points[-1]
            way_m = math.hypot(point.x_m - last.x_m, point.y_m - last.y_m)
            if (way_m < self._step_m and point.outage == last.outage) or len(self._points) >= self._limit:
                return
        self._points.append(point)

    def _strip(self, chunk: int, quantity: str, stamp: dict[str, Any]) -> dict[str, Any]:
        # one point more than the chunk, so that chunks join
        points = self._points[chunk * CHUNK_POINTS : (chunk + 1) * CHUNK_POINTS + 1]
        height_m = HEIGHTS_M[quantity]
        return {
            "header": stamp,
            "ns": quantity,
            "id": chunk,
            "type": LINE_STRIP,
            "pose": {"orientation": {"w": 1.0}},
            "scale": {"x": 0.12, "y": 0.0, "z": 0.0},
            "color": {"a": 1.0},
            "points": [{"x": p.x_m, "y": p.y_m, "z": height_m} for p in points],
            "colors": [colour(p, quantity) for p in points],
        }

    def _label(self, stamp: dict[str, Any]) -> dict[str, Any]:
        last = self._points[-1]
        signal = "no signal reading" if last.rssi_dbm is None else f"{last.rssi_dbm:.0f} dBm"
        delay = "no answer" if last.delay_ms is None else f"{last.delay_ms:.1f} ms"
        return {
            "header": stamp,
            "ns": "now",
            "id": 0,
            "type": TEXT,
            "pose": {"position": {"x": last.x_m, "y": last.y_m + 0.9, "z": 0.8}, "orientation": {"w": 1.0}},
            "scale": {"x": 0.0, "y": 0.0, "z": 0.4},
            "color": {"r": 0.1, "g": 0.1, "b": 0.1, "a": 1.0},
            "text": f"{signal}, {delay}{', outage' if last.outage else ''}",
        }

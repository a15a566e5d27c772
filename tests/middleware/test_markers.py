from __future__ import annotations

from typing import cast

from linkrover.middleware import Middleware
from linkrover.middleware.markers import CHUNK_POINTS, WHOLE_EVERY, PathMarkers, Point, colour, ramp
from linkrover.records import EventKind, LinkEvent, NetworkDelay, Pose, WirelessLink

from .recording import Recording


def pose(x_m: float) -> Pose:
    return Pose(wall_ns=0, mono_ns=0, x_m=x_m, y_m=0.0, heading_rad=0.0, frame="odom")


def path(points: int) -> tuple[PathMarkers, Recording]:
    middleware = Recording()
    markers = PathMarkers(cast("Middleware", middleware), "robot/linkrover/path")
    markers.take(WirelessLink(wall_ns=0, mono_ns=0, iface="wlan0", source="wext", rssi_dbm=-60.0))
    for index in range(points):
        markers.take(pose(index * 0.2))
    return markers, middleware


def test_good_is_green_and_bad_is_red() -> None:
    assert ramp(0.0)["g"] > ramp(0.0)["r"]
    assert ramp(1.0)["r"] > ramp(1.0)["g"]
    assert ramp(-5.0) == ramp(0.0)
    near, far = Point(0, 0, -45.0, 3.0, False), Point(0, 0, -85.0, 1000.0, True)
    for quantity in ("rssi", "delay", "outage"):
        assert colour(near, quantity) == ramp(0.0)
        assert colour(far, quantity) == ramp(1.0)


def test_standing_still_adds_no_points_but_an_outage_does() -> None:
    markers, middleware = path(1)
    for _ in range(10):
        markers.take(pose(0.0))
    markers.take(LinkEvent(wall_ns=0, mono_ns=0, iface="wlan0", kind=EventKind.OUTAGE_BEGAN))
    markers.take(pose(0.0))
    markers.publish()
    strips = [m for m in middleware.messages[-1][2]["markers"] if m["ns"] == "outage"]
    assert [c for s in strips for c in s["colors"]] == [ramp(0.0), ramp(1.0)]


def test_each_second_only_the_newest_chunks_are_sent_and_the_whole_path_now_and_then() -> None:
    markers, middleware = path(CHUNK_POINTS * 5)
    for _ in range(WHOLE_EVERY + 1):
        markers.publish()
    counts = [len(m[2]["markers"]) for m in middleware.messages]
    assert counts[0] == counts[WHOLE_EVERY] == 5 * 3 + 1
    assert set(counts[1:WHOLE_EVERY]) == {2 * 3 + 1}


def test_chunks_join() -> None:
    markers, middleware = path(CHUNK_POINTS + 10)
    markers.publish()
    first, second = (m for m in middleware.messages[0][2]["markers"] if m["ns"] == "rssi")
    assert first["points"][-1] == second["points"][0]
    assert len(first["points"]) == len(first["colors"])


def test_the_label_says_what_the_link_is_like_now() -> None:
    markers, middleware = path(1)
    markers.take(NetworkDelay(wall_ns=0, mono_ns=0, iface="wlan0", peer="p", method="stamp", delay_ns=12_300_000))
    markers.take(pose(1.0))
    markers.publish()
    assert middleware.messages[-1][2]["markers"][-1]["text"] == "-60 dBm, 12.3 ms"


def test_without_a_pose_there_is_nothing_to_draw() -> None:
    markers, middleware = path(0)
    markers.publish()
    assert middleware.messages == []

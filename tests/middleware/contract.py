"""What every middleware must do; subclassed with a real one in tests/ros1."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
ODOMETRY = {
    "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "odom"},
    "pose": {"pose": {"position": {"x": 1.5, "y": -2.5}, "orientation": {"z": 1.0, "w": 0.0}}},
    "twist": {"twist": {"linear": {"x": 0.5}, "angular": {"z": 0.25}}},
}
TWIST = {"linear": {"x": 0.5, "y": 0.1}, "angular": {"z": -1.5}}


class Driver:
    """A running tests.middleware.driver."""

    def __init__(
        self, environment: dict[str, str], factory: str, *command: object, before: tuple[str, ...] = ()
    ) -> None:
        self.process = subprocess.Popen(
            [*before, sys.executable, "-m", "tests.middleware.driver", factory, *map(str, command)],
            env=environment,
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def said(self, kind: str) -> dict[str, Any]:
        """The next line of this kind."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            found: dict[str, Any] = json.loads(line)
            if found["kind"] == kind:
                return found
        assert self.process.stderr is not None
        raise AssertionError(f"ended without saying '{kind}': {self.process.stderr.read()}")

    def finish(self, timeout_s: float = 40) -> tuple[list[dict[str, Any]], str]:
        """All further lines, and standard error."""
        out, err = self.process.communicate(timeout=timeout_s)
        assert self.process.returncode == 0, err
        return [json.loads(line) for line in out.splitlines()], err

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


Start = Callable[..., Driver]


class MiddlewareContract:
    """Needs a fixture `start`: start(verb, *arguments, joined=True) -> Driver; joined=False: nobody is there."""

    def test_a_ping_comes_back_once_and_in_order(self, start: Start) -> None:
        start("answer", "Ping", 60)
        lines, _ = start("ping", "Ping", 20, 20, 2000, "connected").finish()
        counts = lines[-1]
        delays = [line for line in lines if line["kind"] == "delay"]
        assert counts["answered"] >= 15
        assert (counts["late"], counts["duplicates"], counts["in_flight"]) == (0, 0, 0)
        sequences = [line["sequence"] for line in delays]
        assert sequences == sorted(set(sequences))
        assert all(0 < line["delay_ns"] < 2e9 and line["alive"] for line in delays)

    def test_without_a_server_every_ping_is_lost_and_none_is_waited_for(self, start: Start) -> None:
        lines, _ = start("ping", "Nobody", 10, 20, 200, "now").finish()
        assert lines[-1]["answered"] == 0
        assert lines[-1]["lost"] >= 10
        delays = [line for line in lines if line["kind"] == "delay"]
        assert all(line["delay_ns"] is None and not line["alive"] for line in delays)
        assert all(line["unknown"] == {"delay_ns": "not connected"} for line in delays)

    def test_a_published_odometry_arrives_as_a_pose(self, start: Start) -> None:
        listener = start("listen", "odometry", "odom", 60)
        start("publish", "odom", "nav_msgs/Odometry", json.dumps(ODOMETRY), 20, 60)
        pose = listener.said("record")
        assert (pose["x_m"], pose["y_m"], pose["frame"]) == (1.5, -2.5, "odom")
        assert pose["heading_rad"] == pytest.approx(3.14159, abs=1e-4)
        assert (pose["forward_m_per_s"], pose["turn_rad_per_s"]) == (0.5, 0.25)

    def test_a_published_velocity_arrives(self, start: Start) -> None:
        listener = start("listen", "velocity", "cmd_vel", 60)
        start("publish", "cmd_vel", "geometry_msgs/Twist", json.dumps(TWIST), 20, 60)
        command = listener.said("record")
        assert (command["forward_m_per_s"], command["sideways_m_per_s"], command["turn_rad_per_s"]) == (0.5, 0.1, -1.5)

    def test_the_graph_shows_nodes_topics_and_who_is_at_their_ends(self, start: Start) -> None:
        publisher = start("publish", "cmd_vel", "geometry_msgs/Twist", json.dumps(TWIST), 20, 60)
        listener = start("listen", "velocity", "cmd_vel", 60)
        listener.said("record")
        publisher.said("begun")
        found = start("graph").said("graph")
        topic = next(t for t in found["topics"] if t["name"].endswith("cmd_vel"))
        assert topic["type_name"].startswith("geometry_msgs/")
        assert any("driver_publish" in name for name in topic["publishers"])
        assert any("driver_listen" in name for name in topic["subscribers"])
        assert any("driver_graph" in name for name in found["nodes"])

    def test_no_call_waits_when_nobody_is_there(self, start: Start) -> None:
        took = start("instant", joined=False).said("took")
        assert took["joined"] is False
        assert max(took["ns"].values()) < 500_000_000

    def test_publishing_never_blocks_and_says_what_it_lost(self, start: Start) -> None:
        driver = start("publish", "cmd_vel", "geometry_msgs/Twist", json.dumps(TWIST), 5000, 2, joined=False)
        end = driver.said("published")
        assert end["longest_ns"] < 500_000_000
        assert end["lost"] == end["refused"]

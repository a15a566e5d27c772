"""The whole of it over the emulated radio: two namespaces, one master on the robot, images and scans, both nodes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from linkrover.bag import read_recording
from linkrover.records import (
    LinkTruth,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    ProbeResult,
    ProbeState,
    Record,
    TopicTraffic,
    VelocityCommand,
)
from tests.middleware.contract import ROOT

from .conftest import LINKROVER

pytestmark = [pytest.mark.netns, pytest.mark.timeout(300)]
IMAGE_BPS = 640 * 480 * 3 * 8 * 3.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if os.geteuid() != 0 or not Path("/dev/net/tun").exists():
        pytest.skip("needs root and /dev/net/tun, for emulated hosts")
    out = tmp_path_factory.mktemp("ros1") / "out"
    told = subprocess.run(
        [sys.executable, "-m", "tests.ros1.emulated", "10", "9", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    return out


def records(path: Path, *kinds: type[Record]) -> list[Record]:
    return list(read_recording(path).records(*kinds))


def test_both_ends_recorded_what_they_measure(drive: Path) -> None:
    for end in ("robot", "station"):
        kinds = {type(r) for r in records(drive / "run" / end)}
        assert {LinkUtilization, NetworkErrors, TopicTraffic} <= kinds
    robot = {type(r) for r in records(drive / "run/robot")}
    assert {NetworkDelay, ProbeResult, Pose, VelocityCommand} <= robot


def test_the_radio_knows_where_the_robot_stands(drive: Path) -> None:
    distances = {round(r.distance_m, 1) for r in records(drive / "run/truth", LinkTruth) if isinstance(r, LinkTruth)}
    assert any(d > 2.0 for d in distances), "the emulator was never told the robot's place"


def test_images_fill_the_air_and_the_traffic_says_so(drive: Path) -> None:
    images = [
        r
        for r in records(drive / "run/robot", TopicTraffic)
        if isinstance(r, TopicTraffic) and r.topic == "/camera/image" and r.rate_bps is not None
    ]
    assert images, "the camera's connection was never seen"
    assert {r.peer.startswith("/play_swallow") for r in images} == {True}
    busiest = max(r.rate_bps or 0.0 for r in images)
    assert IMAGE_BPS * 0.3 < busiest < IMAGE_BPS * 2
    # joined with the kernel's own socket: its address is this end's, not only a port
    assert any((r.local or "").startswith("10.77.0.2:") for r in images)


def test_the_interface_carries_what_the_topics_send(drive: Path) -> None:
    sent = [r.tx_rate_bps for r in records(drive / "run/robot", LinkUtilization) if isinstance(r, LinkUtilization)]
    known = sorted(rate for rate in sent if rate is not None)
    assert known[len(known) // 2] > IMAGE_BPS * 0.3
    got = [r.rx_rate_bps for r in records(drive / "run/station", LinkUtilization) if isinstance(r, LinkUtilization)]
    assert max(rate for rate in got if rate is not None) > IMAGE_BPS * 0.3


def test_the_end_that_subscribes_receives_more_than_it_sends_wherever_the_master_runs(drive: Path) -> None:
    def totals(end: str) -> tuple[int, int]:
        found = [r for r in records(drive / "run" / end, LinkUtilization) if isinstance(r, LinkUtilization)]
        known = [(r.rx_bytes, r.tx_bytes) for r in found if r.rx_bytes is not None and r.tx_bytes is not None]
        return known[-1][0] - known[0][0], known[-1][1] - known[0][1]

    robot_received, robot_sent = totals("robot")  # the master is here
    station_received, station_sent = totals("station")
    assert robot_sent > 5 * robot_received
    assert station_received > 5 * station_sent
    told = subprocess.run([*LINKROVER, "report", str(drive / "run"), "--format", "md"], capture_output=True, text=True)
    for line in ("robot wlan0: sent", "robot wlan0: received", "station wlan0: sent", "station wlan0: received"):
        assert line in told.stdout


def test_the_action_and_the_probe_measure_one_path_and_differ_by_the_middleware(drive: Path) -> None:
    delays = [r for r in records(drive / "run/robot", NetworkDelay) if isinstance(r, NetworkDelay)]
    actions = [r for r in delays if r.method == "ros1 action" and r.alive]
    assert len(actions) >= 5
    assert actions[-1].peer == "10.77.0.1"
    assert any(r.middleware_ns is not None for r in actions)
    probes = [r for r in records(drive / "run/robot", ProbeResult) if isinstance(r, ProbeResult)]
    assert sum(r.state is ProbeState.ANSWERED for r in probes) > 50


def test_the_bag_of_rosbag_record_agrees_with_our_own_recording(drive: Path) -> None:
    def seen(path: Path) -> dict[int, tuple[int | None, int | None]]:
        found = [r for r in records(path, LinkUtilization) if isinstance(r, LinkUtilization) and r.interval_ns]
        return {r.wall_ns: (r.rx_bytes, r.tx_bytes) for r in found}

    ours, theirs = seen(drive / "run/robot"), seen(drive / "robot.bag")
    assert len(theirs) >= 4
    assert theirs.items() <= ours.items()
    window = [stamp for stamp in ours if min(theirs) <= stamp <= max(theirs)]
    assert sorted(theirs) == sorted(window), "rosbag missed messages within its own span"


def test_run_and_bag_go_through_the_report(drive: Path) -> None:
    for what in ("run", "robot.bag"):
        told = subprocess.run(
            [*LINKROVER, "report", str(drive / what), "--format", "json"], capture_output=True, text=True
        )
        assert told.returncode == 0, told.stderr
        assert json.loads(told.stdout)


def test_nothing_had_to_be_killed_and_nobody_complained(drive: Path) -> None:
    for program in ("client", "server"):
        text = (drive / "log" / f"{program}.log").read_text()
        assert "joined the ROS graph" in text
        assert "ERROR" not in text
        assert "Traceback" not in text

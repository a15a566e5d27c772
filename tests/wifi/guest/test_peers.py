"""Two robots on one access point, and who else is on the air."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from linkrover.records import EventKind, Overlap
from linkrover.sources.netlink import NetlinkError
from linkrover.sources.nl80211_scan import Scanner, scan_results

from .air import Air, Ear, Eye, Radio, datagrams, inside, run, wait_for


@pytest.fixture(scope="module", autouse=True)
def cell(air: Air, station: Radio, robot: Radio, robot2: Radio, station2: Radio) -> None:
    air.access_point(station, "hall", 1, more="bss_load_update_period=1\nchan_util_avg_period=1")
    air.station(robot, "hall", [1])
    air.station(robot2, "hall", [1])
    air.access_point(station2, "other", 3)


def test_each_robot_has_its_own_record_at_the_access_point(eyes: dict[str, Eye], robot: Radio, robot2: Radio):
    robot.level(-44)
    robot2.level(-68)
    for ns in ("robot", "robot2"):
        datagrams(ns, "10.1.0.2", 3)

    def both() -> bool:
        return {link.peer: link.rssi_dbm for link in eyes["station"].quick().links} == {robot.mac: -44, robot2.mac: -68}

    wait_for("both robots", both, 10)
    sample = eyes["station"].quick()
    assert {link.mode for link in sample.links} == {"ap"}
    assert {one.peer for one in sample.stations} == {robot.mac, robot2.mac}


def test_a_scan_shows_neighbours_their_overlap_and_load(
    eyes: dict[str, Eye], robot: Radio, station: Radio, station2: Radio
):
    ear = Ear(robot)
    with inside("robot"):
        scanner = Scanner()
    ours = _interface(eyes["robot"])
    with inside("robot"):
        scanner.start(ours.ifindex, (2412, 2422))
        found = wait_for("the end of the scan", lambda: ear.listen() is None or scanner.ready(robot.iface, ours), 20)
    scanner.close()
    assert found.triggered
    assert found.duration_ns > 0
    by_name = {one.ssid: one for one in found.neighbours}
    assert by_name["hall"].associated
    assert by_name["hall"].bssid == station.mac
    assert by_name["hall"].load_stations == 2
    assert 0 <= by_name["hall"].load_utilization <= 1
    assert by_name["other"].bssid == station2.mac
    assert by_name["other"].overlap is Overlap.ADJACENT
    assert by_name["other"].rssi_dbm == -30
    assert (found.co_channel, found.adjacent) == (0, 1)
    told = ear.wait(EventKind.SCAN)
    assert told.gap_ns is None or told.gap_ns > 0  # None: a busy guest read its beginning and end at once
    ear.close()
    text = run("iw", "dev", robot.iface, "scan", "dump", ns="robot")
    assert f"BSS {station2.mac}" in text
    assert "* station count: 2" in text


def _interface(eye: Eye):
    with inside(eye.radio.ns):
        return eye.nl.interface(eye.radio.iface)


READ_AS_NOBODY = """
import os, sys
from linkrover.sources.netlink import NetlinkError
from linkrover.sources.nl80211 import Nl80211
from linkrover.sources.nl80211_scan import Scanner
assert os.getuid() == 65534
sample = Nl80211().read(sys.argv[1])
print(sample.links[0].rssi_dbm, sample.links[0].ssid, len(sample.stations))
scanner = Scanner()
try:
    scanner.start(Nl80211().interface(sys.argv[1]).ifindex)
except NetlinkError as refused:
    print(refused)
"""


def test_an_unprivileged_user_reads_everything_and_may_not_scan(robot: Radio, station: Radio, eyes: dict[str, Eye]):
    with inside("robot"):
        done = subprocess.run(
            [sys.executable, "-c", READ_AS_NOBODY, robot.iface],
            user=65534,
            group=65534,
            extra_groups=[],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
            timeout=60,
        )
    assert done.returncode == 0, done.stderr
    read, refused = done.stdout.splitlines()
    assert read == "-30.0 hall 1"
    assert "EPERM" in refused
    assert "CAP_NET_ADMIN" in refused


def test_the_kernels_list_is_read_without_a_scan(eyes: dict[str, Eye]):
    with inside("robot"):
        found = scan_results(eyes["robot"].nl._nl, _interface(eyes["robot"]).ifindex)
    assert any(one.associated and one.ssid == "hall" for one in found)


def test_scanning_an_interface_that_is_down_says_so(spare: Radio, eyes: dict[str, Eye]):
    with inside("spare"):
        scanner = Scanner()
        with pytest.raises(NetlinkError, match="ENETDOWN"):
            scanner.start(eyes["spare"].nl.interface(spare.iface).ifindex)
        scanner.close()

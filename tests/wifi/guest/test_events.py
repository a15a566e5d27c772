"""What happens to a link, as a timeline: roam, loss and return, reasons, thresholds, channel, country, scans."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from linkrover.records import EventKind

from .air import Air, Daemon, Ear, Eye, Radio, run, wait_for


@pytest.fixture(scope="module")
def ears(robot: Radio, station: Radio) -> Iterator[dict[str, Ear]]:
    made = {radio.ns: Ear(radio) for radio in (robot, station)}
    yield made
    for ear in made.values():
        ear.close()


@pytest.fixture(scope="module")
def access_point(air: Air, robot: Radio, ears: dict[str, Ear]) -> Daemon:
    return air.access_point(robot, "roaming", 1)


@pytest.fixture(scope="module")
def client(air: Air, access_point: Daemon, station: Radio) -> Daemon:
    more = 'bgscan="simple:1:-65:20"'
    return air.station(station, "roaming", [1, 6], more=more)


def test_association_is_told_at_both_ends(client: Daemon, ears: dict[str, Ear], robot: Radio, station: Radio):
    joined = ears["station"].wait(EventKind.ASSOCIATED)
    assert joined.bssid == robot.mac
    assert joined.gap_ns is None
    assert ears["robot"].wait(EventKind.PEER_JOINED).peer == station.mac
    assert not [event for event in ears["station"].heard if event.kind is EventKind.PEER_JOINED]


def test_a_disconnection_has_its_reason_and_its_gap(client: Daemon, ears: dict[str, Ear], robot: Radio, station: Radio):
    control = f"/run/hostapd-{robot.iface}"
    run("hostapd_cli", "-p", control, "-i", robot.iface, "deauthenticate", station.mac, "reason=5", ns="robot")
    lost = ears["station"].wait(EventKind.DISCONNECTED)
    assert lost.reason_code == 5
    assert "too many stations" in lost.detail
    assert lost.locally_generated is False
    assert lost.bssid == robot.mac
    left = ears["robot"].wait(EventKind.PEER_LEFT)
    assert left.peer == station.mac
    back = ears["station"].wait(EventKind.ASSOCIATED)
    assert back.gap_ns == (back.mono_ns - lost.mono_ns or None)  # None: a busy guest may read both at once
    again = ears["robot"].wait(EventKind.PEER_JOINED)
    assert again.gap_ns == (again.mono_ns - left.mono_ns or None)


def test_the_country_changing_is_told(ears: dict[str, Ear]):
    run("iw", "reg", "set", "DE")
    told = ears["station"].wait(EventKind.REGULATORY)
    assert "DE" in told.detail
    assert "a user" in told.detail
    run("iw", "reg", "set", "US")
    assert "US" in ears["station"].wait(EventKind.REGULATORY).detail


def test_a_weak_signal_is_told_and_then_the_roam(
    air: Air, client: Daemon, ears: dict[str, Ear], robot: Radio, robot2: Radio, eyes: dict[str, Eye]
):
    air.access_point(robot2, "roaming", 6)
    robot2.level(-45)
    for level in (-50, -60, -72):
        robot.level(level)
        wait_for(f"{level} dBm", lambda level=level: eyes["station"].quick().links[0].rssi_dbm == level, 10)
    weak = ears["station"].wait(EventKind.CQM_LOW)
    assert -72 <= weak.rssi_dbm <= -66  # the kernel's average, which follows the ramp
    assert weak.bssid == robot.mac
    assert "done" in ears["station"].wait(EventKind.SCAN).detail  # the supplicant's own, by which it found the other
    roam = ears["station"].wait(EventKind.ROAMED)
    assert roam.previous_bssid == robot.mac
    assert roam.bssid == robot2.mac
    assert roam.gap_ns is None or 0 < roam.gap_ns < 10e9  # None: so fast that both messages were read at once
    link = eyes["station"].quick().links[0]
    assert (link.bssid, link.frequency_mhz, link.rssi_dbm) == (robot2.mac, 2437, -45)


def test_an_access_point_that_loses_power_is_noticed_and_its_return(
    air: Air, client: Daemon, ears: dict[str, Ear], robot: Radio, robot2: Radio, station: Radio, access_point: Daemon
):
    access_point.stop()  # so that there is nowhere to roam to
    cut_ns = time.monotonic_ns()
    air.daemons[-1].stop(at_once=True)
    run("ip", "link", "set", robot2.iface, "down", ns="robot2")
    lost = ears["station"].wait(EventKind.DISCONNECTED, 40)
    assert lost.mono_ns > cut_ns
    assert lost.locally_generated
    run("ip", "link", "set", robot2.iface, "up", ns="robot2")
    air.access_point(robot2, "roaming", 6)
    back = ears["station"].wait(EventKind.ASSOCIATED, 60)
    assert back.bssid == back.previous_bssid == robot2.mac
    assert back.gap_ns == back.mono_ns - lost.mono_ns


def test_a_channel_switch_is_told_and_the_link_follows(
    client: Daemon, ears: dict[str, Ear], robot2: Radio, eyes: dict[str, Eye]
):
    control = f"/run/hostapd-{robot2.iface}"
    run("hostapd_cli", "-p", control, "-i", robot2.iface, "chan_switch", 5, 2462, ns="robot2")
    told = ears["station"].wait(EventKind.CHANNEL_SWITCH)
    assert told.frequency_mhz == 2462
    wait_for("the new channel", lambda: eyes["station"].read().links[0].frequency_mhz == 2462, 10)

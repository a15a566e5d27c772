"""Signal levels: followed exactly at both ends, marked when they are old, and the same by wireless extensions."""

from __future__ import annotations

import time

import pytest

from linkrover.records import Unknown
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch
from linkrover.sources.wireless import WextSource

from .air import Air, Eye, Radio, datagrams, inside, wait_for

RAMP_DBM = (-35, -48, -61, -74, -67, -40)


@pytest.fixture(scope="module", autouse=True)
def link(air: Air, robot: Radio, station: Radio) -> None:
    air.access_point(robot, "levels", 6)
    air.station(station, "levels", [6])


def test_a_station_follows_its_access_point_by_beacons(robot: Radio, eyes: dict[str, Eye]):
    seen = []
    for level in RAMP_DBM:
        robot.level(level)
        wait_for(f"{level} dBm", lambda level=level: eyes["station"].quick().links[0].rssi_dbm == level, 10)
        seen.append(eyes["station"].quick().links[0].rssi_dbm)
    assert seen == [float(level) for level in RAMP_DBM]


def test_an_access_point_follows_its_station_by_traffic(station: Radio, eyes: dict[str, Eye]):
    seen = []
    for level in RAMP_DBM:
        station.level(level)
        datagrams("station", "10.1.0.1", 2)
        wait_for(f"{level} dBm", lambda level=level: eyes["robot"].quick().links[0].rssi_dbm == level, 10)
        seen.append(eyes["robot"].quick().links[0].rssi_dbm)
    assert seen == [float(level) for level in RAMP_DBM]


def test_a_silent_stations_rssi_is_marked_old_at_the_access_point(station: Radio, eyes: dict[str, Eye]):
    datagrams("station", "10.1.0.1", 2)
    assert eyes["robot"].quick().links[0].rssi_stale is False
    station.level(-80)  # nobody hears of it while the station sends nothing
    old = wait_for("an old RSSI", lambda: eyes["robot"].quick().links[0].rssi_stale and eyes["robot"].quick(), 20)
    assert old.links[0].inactive_ms > 1000
    assert old.stations[0].rssi_stale
    datagrams("station", "10.1.0.1", 2)
    wait_for("a new RSSI", lambda: eyes["robot"].quick().links[0].rssi_stale is False, 10)
    assert eyes["robot"].quick().links[0].rssi_dbm == -80


def test_beacons_keep_a_silent_stations_rssi_fresh(eyes: dict[str, Eye]):
    eyes["station"].quick()
    time.sleep(1.5)
    link = eyes["station"].quick().links[0]
    assert link.inactive_ms > 1000  # nothing was sent to this station but beacons
    assert link.rssi_stale is False


def test_wireless_extensions_say_the_same_and_nothing_of_access_points(
    robot: Radio, station: Radio, eyes: dict[str, Eye]
):
    robot.level(-57)
    wait_for("-57 dBm", lambda: eyes["station"].quick().links[0].rssi_dbm == -57, 10)
    with inside("station"):
        source = WextSource(InterfaceWatch(station.iface, sockets=InterfaceSocket()))
        extensions = source.sample()[0]
        source.close()
    ours = eyes["station"].read().links[0]
    assert (extensions.source, ours.source) == ("wext", "nl80211")
    for field in (
        "connected",
        "rssi_dbm",
        "link_quality",
        "tx_failed",
        "ssid",
        "bssid",
        "frequency_mhz",
    ):
        assert getattr(extensions, field) == getattr(ours, field), field
    assert extensions.unknown["missed_beacons"] is Unknown.UNSUPPORTED
    assert ours.missed_beacons is not None
    with inside("robot"):
        source = WextSource(InterfaceWatch(robot.iface, sockets=InterfaceSocket()))
        nothing = source.sample()[0]
        source.close()
    assert nothing.rssi_dbm is None
    assert nothing.unknown["rssi_dbm"] is Unknown.UNSUPPORTED
    assert eyes["robot"].read().links[0].rssi_dbm is not None

"""Our codec against `iw` and pyroute2, field by field, at both ends of one WPA2 link."""

from __future__ import annotations

import importlib
import socket
import time
from typing import Any

import pytest

from linkrover.records import Unknown

from .air import PASSPHRASE, Air, Eye, Radio, datagrams, inside, run, scan, wait_for
from .iw_text import bitrate, stations, surveys

# Our field -> iw's words and the unit after the number; these grow with traffic, so the link is left idle meanwhile.
COUNTED = {
    "tx_packets": "tx packets",
    "tx_bytes": "tx bytes",
    "tx_retries": "tx retries",
    "tx_failed": "tx failed",
}
LEVELS = {"rssi_dbm": "signal", "rssi_avg_dbm": "signal avg", "beacon_rssi_avg_dbm": "beacon signal avg"}


@pytest.fixture(scope="module", autouse=True)
def link(air: Air, robot: Radio, station: Radio, eyes: dict[str, Eye]) -> None:
    air.access_point(robot, "linkrover", 36, passphrase=PASSPHRASE)
    air.station(station, "linkrover", [36], passphrase=PASSPHRASE)
    station.level(-52)
    robot.level(-47)
    datagrams("station", "10.1.0.1", 30)
    datagrams("robot", "10.1.0.2", 30)
    wait_for("a settled average", lambda: _settled(eyes["station"]))


def _settled(eye: Eye) -> bool:
    first = eye.read().stations[0]
    time.sleep(0.4)  # a few beacons
    second = eye.read().stations[0]
    return (first.rssi_avg_dbm, first.beacon_rssi_avg_dbm) == (second.rssi_avg_dbm, second.beacon_rssi_avg_dbm)


@pytest.mark.parametrize("end", ["robot", "station"])
def test_station_dump_agrees_with_iw(end: str, robot: Radio, station: Radio, eyes: dict[str, Eye]):
    radio, peer = (robot, station) if end == "robot" else (station, robot)
    ours = eyes[end].read().stations[0]
    theirs = stations(run("iw", "dev", radio.iface, "station", "dump", ns=end))[peer.mac]
    again = eyes[end].read().stations[0]
    assert ours.peer == peer.mac
    for field, words in COUNTED.items():
        value = int(theirs[words])
        assert getattr(ours, field) <= value <= getattr(again, field), field
    for field, words in LEVELS.items():
        if words in theirs:
            assert getattr(ours, field) == float(theirs[words].split()[0]), field
        else:
            assert getattr(ours, field) is None
            assert ours.unknown[field] is Unknown.UNSUPPORTED
    for field, words in (("rx_packets", "rx packets"), ("rx_bytes", "rx bytes"), ("rx_dropped", "rx drop misc")):
        assert getattr(ours, field) <= int(theirs[words]) <= getattr(again, field), field
    assert bitrate(ours.tx_bitrate) == theirs["tx bitrate"]
    assert bitrate(ours.rx_bitrate) == theirs["rx bitrate"]
    assert abs(ours.connected_s - int(theirs["connected time"].split()[0])) <= 2
    assert ours.authorized is (theirs["authorized"] == "yes")
    assert ours.associated is (theirs["associated"] == "yes")
    assert ours.tx_airtime_us == int(theirs["tx duration"].split()[0])
    assert ours.rx_airtime_us == int(theirs["rx duration"].split()[0])
    if end == "station":
        assert ours.beacon_loss == int(theirs["beacon loss"])
        assert ours.rx_beacons <= int(theirs["beacon rx"]) <= again.rx_beacons
    else:
        assert ours.unknown["beacon_loss"] is Unknown.UNSUPPORTED


@pytest.mark.parametrize("end", ["robot", "station"])
def test_link_agrees_with_iw(end: str, robot: Radio, station: Radio, eyes: dict[str, Eye]):
    radio = robot if end == "robot" else station
    link = eyes[end].read().links[0]
    info = run("iw", "dev", radio.iface, "info", ns=end)
    assert link.source == "nl80211"
    assert link.connected
    assert link.mode == ("ap" if end == "robot" else "station")
    assert f"({link.frequency_mhz} MHz), width: {link.width_mhz} MHz" in info
    assert f"txpower {link.tx_power_dbm:.2f} dBm" in info
    assert link.ssid == "linkrover"
    assert link.bssid == robot.mac
    assert link.peer == (station.mac if end == "robot" else None)
    assert link.regulatory_domain == "US"
    if end == "station":
        told = run("iw", "dev", radio.iface, "link", ns=end)
        assert f"Connected to {link.bssid}" in told
        assert f"SSID: {link.ssid}" in told
        assert f"signal: {link.rssi_dbm:.0f} dBm" in told
        assert f"Power save: {'on' if link.power_save else 'off'}" in run(
            "iw", "dev", radio.iface, "get", "power_save", ns=end
        )


def test_power_save_is_followed(station: Radio, eyes: dict[str, Eye]):
    for state in ("on", "off"):
        run("iw", "dev", station.iface, "set", "power_save", state, ns="station")
        assert eyes["station"].read().links[0].power_save is (state == "on")


def test_survey_agrees_with_iw_and_noise_is_negative(station: Radio, eyes: dict[str, Eye]):
    scan(station, 2412, 5180)  # this driver surveys what it scans
    ours = eyes["station"].read().surveys
    theirs = surveys(run("iw", "dev", station.iface, "survey", "dump", ns="station"))
    assert len(ours) == len(theirs) > 0
    for mine, other in zip(ours, theirs, strict=True):
        assert mine.frequency_mhz == int(other["frequency"].split()[0])
        assert mine.noise_dbm == float(other["noise"].split()[0]) == -92
        assert mine.active_ms == int(other["channel active time"].split()[0])
        assert mine.busy_ms == int(other["channel busy time"].split()[0])
    assert eyes["station"].read().links[0].noise_dbm == -92


@pytest.fixture(scope="module")
def pyroute2_iw() -> Any:
    return importlib.import_module("pyroute2.iwutil").IW


@pytest.mark.parametrize("end", ["robot", "station"])
def test_station_and_interface_agree_with_pyroute2(
    end: str, pyroute2_iw: Any, robot: Radio, station: Radio, eyes: dict[str, Eye]
):
    radio = robot if end == "robot" else station
    sample = eyes[end].read()
    ours, link = sample.stations[0], sample.links[0]
    with inside(end):
        iw = pyroute2_iw()
        try:
            index = socket.if_nametoindex(radio.iface)
            found = list(iw.get_stations(index))
            interface = dict(next(iter(iw.get_interface_by_ifindex(index)))["attrs"])
        finally:
            iw.close()
    theirs = dict(found[0]["attrs"])
    info = dict(theirs["NL80211_ATTR_STA_INFO"]["attrs"])
    assert len(found) == 1
    assert ours.peer == theirs["NL80211_ATTR_MAC"]
    assert ours.rssi_dbm == info["NL80211_STA_INFO_SIGNAL"]
    assert ours.rssi_avg_dbm == info["NL80211_STA_INFO_SIGNAL_AVG"]
    assert ours.tx_packets <= info["NL80211_STA_INFO_TX_PACKETS"]
    assert ours.tx_failed == info["NL80211_STA_INFO_TX_FAILED"]
    assert ours.beacon_loss == info.get("NL80211_STA_INFO_BEACON_LOSS")
    throughput_kbps = info.get("NL80211_STA_INFO_EXPECTED_THROUGHPUT")  # absent while rate control knows nothing yet
    assert (ours.expected_throughput_bps or 0) // 1000 == (throughput_kbps or 0)
    rate = dict(info["NL80211_STA_INFO_TX_BITRATE"]["attrs"])
    assert ours.tx_bitrate.rate_bps == rate["NL80211_RATE_INFO_BITRATE32"] * 100_000
    assert link.iface == interface["NL80211_ATTR_IFNAME"]
    assert link.frequency_mhz == interface["NL80211_ATTR_WIPHY_FREQ"]
    assert (link.mode == "ap") == (interface["NL80211_ATTR_IFTYPE"] == 3)
    assert link.tx_power_dbm == interface["NL80211_ATTR_WIPHY_TX_POWER_LEVEL"] / 100


def test_the_driver_shows_what_it_gives(eyes: dict[str, Eye]):
    eyes["station"].read()
    found = eyes["station"].nl.capability("wlan1", "mac80211_hwsim")
    assert "station_link.rssi_dbm" in found.given
    assert "station_link.tx_failed" in found.given
    assert "channel_survey.noise_dbm" in found.given
    assert "station_link.ack_rssi_dbm" in found.not_given
    assert "channel_survey.tx_ms" in found.not_given
    assert found.undecided == ()

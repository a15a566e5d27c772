"""nl80211 parsers on dumps of a real kernel (6.1, mac80211_hwsim), and on what a driver must never send."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Bitrate, Now, Unknown
from linkrover.sources.netlink import pack, u32
from linkrover.sources.nl80211_interface import (
    parse_interface,
    parse_power_save,
    parse_regulatory,
    parse_survey,
    ssid_text,
)
from linkrover.sources.nl80211_link import links
from linkrover.sources.nl80211_link import settings as link_settings
from linkrover.sources.nl80211_station import parse_bitrate, parse_station
from tests.wifi.guest.iw_text import bitrate, stations

CAPTURED: dict[str, Any] = json.loads((Path(__file__).parent / "captured" / "nl80211.json").read_text())
AT = Now(1_000, 2_000)
KINDS = ["legacy", "ht", "vht", "he"]
ENDS = ["robot", "station"]
MAC = bytes.fromhex("020000000100")


def captured(kind: str, end: str, what: str) -> bytes:
    return bytes.fromhex(CAPTURED[kind][end][what][0])


def station(*values: tuple[int, bytes]) -> bytes:
    return bytes(4) + pack(6, MAC) + pack(21, b"".join(pack(*value) for value in values))


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_real_station_dump_reads_as_iw_printed_it(kind: str, end: str):
    found = parse_station(captured(kind, end, "station"), AT, "wlan0")
    theirs = stations(CAPTURED[kind][end]["iw_station"])[found.peer]
    assert found.rssi_dbm == float(theirs["signal"].split()[0]) == (-61 if end == "robot" else -47)
    assert bitrate(found.tx_bitrate) == theirs["tx bitrate"]
    assert found.tx_packets <= int(theirs["tx packets"])
    assert found.tx_failed == int(theirs["tx failed"])
    assert found.authorized is True
    assert found.expected_throughput_bps is None or found.expected_throughput_bps > 0
    assert (found.beacon_loss is None) == (end == "robot")
    assert found.wall_ns == AT.wall_ns


def test_what_a_driver_does_not_give_is_unsupported_and_not_zero():
    found = parse_station(captured("ht", "robot", "station"), AT, "wlan0")
    for field in ("ack_rssi_dbm", "beacon_loss", "rx_beacons", "beacon_rssi_avg_dbm"):
        assert getattr(found, field) is None
        assert found.unknown[field] is Unknown.UNSUPPORTED
    assert "rssi_dbm" not in found.unknown


def test_tid_counters_are_left_out_where_not_asked_for_and_that_is_no_lack():
    payload = captured("ht", "station", "station")
    assert parse_station(payload, AT, "wlan0").tids
    short = parse_station(payload, AT, "wlan0", tids=False)
    assert short.tids == ()
    assert "tids" not in short.unknown


def test_a_signal_of_0_dbm_counts_as_not_given():
    found = parse_station(station((7, b"\x00"), (13, b"\xc4")), AT, "wlan0")
    assert found.rssi_dbm is None
    assert found.unknown["rssi_dbm"] is Unknown.UNSUPPORTED
    assert found.rssi_avg_dbm == -60


def test_chains_keep_their_order_and_sign():
    found = parse_station(station((25, pack(0, b"\xc0") + pack(1, b"\xba"))), AT, "wlan0")
    assert found.rssi_chain_dbm == (-64, -70)


def test_64_bit_byte_counters_come_before_32_bit_ones_whatever_the_order():
    for values in (((23, struct.pack("=Q", 1 << 40)), (2, u32(7))), ((2, u32(7)), (23, struct.pack("=Q", 1 << 40)))):
        assert parse_station(station(*values), AT, "wlan0").rx_bytes == 1 << 40
    assert parse_station(station((2, u32(7))), AT, "wlan0").rx_bytes == 7


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        (((5, u32(60)),), Bitrate(rate_bps=6_000_000, mode="legacy")),
        (((1, b"\x3c\x00"),), Bitrate(rate_bps=6_000_000, mode="legacy")),
        (
            ((5, u32(3000)), (2, b"\x0f"), (3, b""), (4, b"")),
            Bitrate(rate_bps=300_000_000, mode="ht", mcs=15, nss=2, width_mhz=40, guard_interval_ns=400),
        ),
        (
            ((5, u32(8667)), (6, b"\x09"), (7, b"\x02"), (8, b""), (4, b"")),
            Bitrate(rate_bps=866_700_000, mode="vht", mcs=9, nss=2, width_mhz=80, guard_interval_ns=400),
        ),
        (
            ((5, u32(24019)), (13, b"\x0b"), (14, b"\x02"), (15, b"\x00"), (10, b"")),
            Bitrate(rate_bps=2_401_900_000, mode="he", mcs=11, nss=2, width_mhz=160, guard_interval_ns=800),
        ),
        (
            ((5, u32(1000)), (13, b"\x03"), (14, b"\x01"), (15, b"\x02")),
            Bitrate(rate_bps=100_000_000, mode="he", mcs=3, nss=1, width_mhz=20, guard_interval_ns=3200),
        ),
        (
            ((5, u32(57646)), (19, b"\x0d"), (20, b"\x02"), (21, b"\x01"), (18, b"")),
            Bitrate(rate_bps=5_764_600_000, mode="eht", mcs=13, nss=2, width_mhz=320, guard_interval_ns=1600),
        ),
        ((), Bitrate(mode="legacy")),
    ],
)
def test_a_bitrate_of_every_generation(attributes: tuple[tuple[int, bytes], ...], expected: Bitrate):
    assert parse_bitrate(b"".join(pack(*one) for one in attributes)) == expected


def test_unknown_attributes_of_later_kernels_are_skipped():
    payload = captured("ht", "station", "station") + pack(900, b"new") + pack(0x8000 | 901, pack(1, b"nested"))
    assert parse_station(payload, AT, "wlan0").rssi_dbm == -47
    assert parse_station(station((300, b"later"), (7, b"\xc4")), AT, "wlan0").rssi_dbm == -60


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x13",
        bytes(4),
        bytes(4) + pack(6, MAC),
        bytes(4) + pack(21, b""),
        bytes(4) + pack(6, b"\x02") + pack(21, b""),
        station((1, b"\x00")),
        station((7, b"")),
        station((2, b"\x01")),
        station((17, b"\x01")),
        station((23, bytes(4))),
        station((27, b"")),
        station((8, b"\x08\x00\x05\x00")),
        station((14, pack(6, b""))),
        station((31, pack(1, pack(1, b"\x01")))),
        station((25, pack(0, b""))),
        bytes(4) + pack(6, MAC) + pack(21, b"\xff\xff\x07\x00"),
    ],
)
def test_a_damaged_station_is_a_parse_error(payload: bytes):
    with pytest.raises(ParseError):
        parse_station(payload, AT, "wlan0")


PARSERS = {
    "station": lambda data: parse_station(data, AT, "wlan0"),
    "interface": parse_interface,
    "survey": lambda data: parse_survey(data, AT, "wlan0"),
    "power_save": parse_power_save,
    "regulatory": parse_regulatory,
}


@pytest.mark.parametrize("what", list(PARSERS))
@given(data=st.data())
@settings(max_examples=120, deadline=None)
def test_a_real_dump_with_any_damage_is_a_record_or_a_parse_error(what: str, data: st.DataObject):
    whole = captured("ht", "robot", what)
    cut = data.draw(st.integers(0, len(whole)))
    damaged = bytearray(whole[:cut])
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=6)):
        if place < len(damaged):
            damaged[place] = data.draw(st.integers(0, 255))
    try:
        PARSERS[what](bytes(damaged))
    except ParseError:
        return


@pytest.mark.parametrize("what", list(PARSERS))
@given(tail=st.binary(max_size=200))
@settings(max_examples=80, deadline=None)
def test_any_bytes_are_a_record_or_a_parse_error(what: str, tail: bytes):
    for data in (tail, bytes(4) + tail, bytes(4) + pack(6, MAC) + pack(21, tail), bytes(4) + pack(84, tail)):
        try:
            PARSERS[what](data)
        except ParseError:
            continue


@pytest.mark.parametrize("kind", KINDS)
def test_a_real_interface_reads_as_iw_printed_it(kind: str):
    for end in ENDS:
        found = parse_interface(captured(kind, end, "interface"))
        text = CAPTURED[kind][end]["iw_info"]
        assert f"Interface {found.name}" in text
        assert f"ifindex {found.ifindex}" in text
        assert f"addr {found.mac}" in text
        assert f"wiphy {found.wiphy}" in text
        ht = " (no HT)" if kind == "legacy" else ""
        assert f"({found.frequency_mhz} MHz), width: {found.width_mhz} MHz{ht}, center1: {found.center_mhz} MHz" in text
        assert f"txpower {found.tx_power_dbm:.2f} dBm" in text
    assert (found.mode, found.ssid) == ("station", None)


def test_an_interface_without_a_name_is_a_p2p_device():
    found = parse_interface(bytes(4) + pack(1, u32(0)) + pack(5, u32(10)) + pack(153, bytes(8)))
    assert (found.name, found.ifindex, found.mode) == (None, None, "p2p-device")


def test_tx_power_may_be_negative():
    assert parse_interface(bytes(4) + pack(1, u32(0)) + pack(98, struct.pack("=i", -300))).tx_power_dbm == -3


def test_a_real_survey_has_a_signed_noise():
    found = [
        parse_survey(bytes.fromhex(one), AT, "wlan0") for kind in KINDS for one in CAPTURED[kind]["robot"]["survey"]
    ]
    assert {one.noise_dbm for one in found} == {-92.0}
    assert all(one.unknown["tx_ms"] is Unknown.UNSUPPORTED for one in found)
    assert all(one.busy_ms <= one.active_ms for one in found)


def test_a_survey_of_no_channel_is_none_and_a_noise_of_0_is_not_given():
    assert parse_survey(bytes(4) + pack(84, pack(4, struct.pack("=Q", 5))), AT, "wlan0") is None
    found = parse_survey(bytes(4) + pack(84, pack(1, u32(2412)) + pack(2, b"\x00") + pack(3, b"")), AT, "wlan0")
    assert found.noise_dbm is None
    assert found.in_use


def test_power_save_and_country_of_a_real_kernel():
    assert parse_power_save(captured("ht", "station", "power_save")) is False
    assert parse_regulatory(captured("ht", "station", "regulatory")).alpha2 == "US"
    assert parse_regulatory(captured("ht", "station", "regulatory")).dfs_region == "FCC"


def test_an_ssid_of_any_bytes_is_text():
    assert ssid_text("Füchse".encode()) == "Füchse"
    assert ssid_text(b"\xff\x00a") == "\\xff\\x00a"


def test_an_empty_dump_is_no_link_and_says_why():
    client = link_settings(parse_interface(captured("ht", "station", "interface")), -92.0, False, "US")
    (link,) = links(client, "wlan1", AT, [])
    assert link.connected is False
    assert link.rssi_dbm is None
    assert link.unknown["rssi_dbm"] is Unknown.NOT_CONNECTED
    assert link.unknown["ssid"] is Unknown.NOT_CONNECTED
    host = link_settings(parse_interface(captured("ht", "robot", "interface")), None, None, "US")
    (idle,) = links(host, "wlan0", AT, [])
    assert (idle.connected, idle.mode, idle.ssid, idle.bssid) == (False, "ap", "rate ht", "02:00:00:00:00:00")
    assert idle.unknown["noise_dbm"] is Unknown.UNSUPPORTED


def test_an_access_point_has_a_link_per_peer():
    host = link_settings(parse_interface(captured("ht", "robot", "interface")), -92.0, None, "US")
    first = parse_station(captured("ht", "robot", "station"), AT, "wlan0")
    second = parse_station(station((7, b"\xb0")), AT, "wlan0")
    found = links(host, "wlan0", AT, [first, second])
    assert [one.rssi_dbm for one in found] == [-61, -80]
    assert [one.link_quality for one in found] == [49, 30]
    assert all(one.peer is not None and one.bssid == "02:00:00:00:00:00" for one in found)


def test_a_station_that_is_not_yet_associated_is_no_link():
    client = link_settings(parse_interface(captured("ht", "station", "interface")), -92.0, False, "US")
    joining = parse_station(station((7, b"\xb0"), (17, struct.pack("=II", 1 << 7, 0))), AT, "wlan1")
    assert joining.associated is False
    assert links(client, "wlan1", AT, [joining])[0].connected is False

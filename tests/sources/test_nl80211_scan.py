"""Scan results of a real kernel, overlap of channels, and damage."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Neighbour, Now, Overlap
from linkrover.sources.netlink import pack, u32
from linkrover.sources.nl80211_interface import WirelessInterface
from linkrover.sources.nl80211_scan import channel_mhz, elements, heard_within, overlap, parse_bss, snapshot

CAPTURED: dict[str, Any] = json.loads((Path(__file__).parent / "captured" / "nl80211.json").read_text())
SCAN = [bytes.fromhex(one) for one in CAPTURED["he"]["station"]["scan"]]
BSSID = bytes.fromhex("0a0b0c0d0e0f")


def bss(frequency_mhz: int, *found: tuple[int, bytes]) -> bytes:
    body = b"".join(bytes([kind, len(value)]) + value for kind, value in found)
    return bytes(4) + pack(47, pack(1, BSSID) + pack(2, u32(frequency_mhz)) + pack(6, body))


def ours(frequency_mhz: int | None, width_mhz: int = 20, center_mhz: int | None = None) -> WirelessInterface:
    return WirelessInterface(
        "wlan0", 3, 0, "02:00:00:00:00:01", "station", None, frequency_mhz, width_mhz, center_mhz or frequency_mhz, 20.0
    )


def test_a_real_scan_has_each_name_and_the_width_of_its_channel():
    found = {one.ssid: one for one in map(parse_bss, SCAN) if one is not None}
    assert {name: (one.center_mhz, one.width_mhz) for name, one in found.items()} == {
        "rate legacy": (5180, 20),
        "rate ht": (5190, 40),
        "rate vht": (5210, 80),
        "rate he": (5210, 80),
    }
    assert [one.ssid for one in found.values() if one.associated] == ["rate he"]
    assert {one.rssi_dbm for one in found.values()} == {-47}
    for one in found.values():
        assert f"BSS {one.bssid}" in CAPTURED["he"]["station"]["iw_scan"]


def test_the_load_of_a_cell_is_stations_and_busy_share():
    found = parse_bss(bss(2412, (0, b"hall"), (11, b"\x03\x00\x80\x00\x00")))
    assert found.load_stations == 3
    assert found.load_utilization == pytest.approx(128 / 255)
    assert parse_bss(bss(2412, (0, b"hall"))).load_stations is None


def test_a_hidden_name_is_unknown():
    assert parse_bss(bss(2412, (0, b""))).ssid is None
    assert parse_bss(bss(2412, (0, bytes(8)))).ssid is None


@pytest.mark.parametrize(
    ("frequency", "found", "center", "width"),
    [
        (2437, ((61, b"\x06\x01"),), 2447, 40),
        (2437, ((61, b"\x06\x03"),), 2427, 40),
        (5180, ((61, b"\x24\x01"), (192, b"\x01\x2a\x00")), 5210, 80),
        (5180, ((61, b"\x24\x01"), (192, b"\x01\x2a\x32")), 5250, 160),
        (5180, ((61, b"\x24\x01"), (192, b"\x00\x00\x00")), 5190, 40),
        (5180, (), 5180, 20),
    ],
)
def test_the_operation_elements_place_the_whole_channel(
    frequency: int, found: tuple[tuple[int, bytes], ...], center: int, width: int
):
    one = parse_bss(bss(frequency, *found))
    assert (one.center_mhz, one.width_mhz) == (center, width)


@pytest.mark.parametrize(
    ("mine", "other", "width", "expected"),
    [
        (ours(2412), 2412, 20, Overlap.CO_CHANNEL),
        (ours(2412), 2417, 20, Overlap.ADJACENT),
        (ours(2412), 2432, 20, Overlap.ADJACENT),  # channels 1 and 5: the masks still touch
        (ours(2412), 2437, 20, Overlap.NONE),
        (ours(5180), 5200, 20, Overlap.NONE),
        (ours(5180, 80, 5210), 5240, 20, Overlap.ADJACENT),
        (ours(5180, 80, 5210), 5260, 20, Overlap.NONE),
        (ours(None), 5260, 20, None),
    ],
)
def test_how_channels_lie_to_each_other(mine: WirelessInterface, other: int, width: int, expected: Overlap | None):
    near = Neighbour(bssid="x", frequency_mhz=other, center_mhz=float(other), width_mhz=width)
    assert overlap(mine, near) is expected


def test_a_snapshot_counts_the_others_and_not_our_own_cell():
    found = [
        Neighbour(bssid="a", frequency_mhz=2412, center_mhz=2412.0, width_mhz=20, associated=True),
        Neighbour(bssid="b", frequency_mhz=2412, center_mhz=2412.0, width_mhz=20),
        Neighbour(bssid="c", frequency_mhz=2422, center_mhz=2422.0, width_mhz=20),
        Neighbour(bssid="02:00:00:00:00:01", frequency_mhz=2412, center_mhz=2412.0, width_mhz=20),
    ]
    taken = snapshot("wlan0", ours(2412), found, Now(1, 2), 5)
    assert (taken.co_channel, taken.adjacent, taken.triggered) == (1, 1, True)
    blind = snapshot("wlan0", ours(None), found, Now(1, 2))
    assert (blind.co_channel, blind.adjacent, blind.triggered) == (None, None, False)


def test_what_was_heard_before_the_scan_is_no_finding_of_it():
    found = [
        Neighbour(bssid="now", frequency_mhz=2412, seen_ms_ago=150),
        Neighbour(bssid="before", frequency_mhz=2412, seen_ms_ago=900),
        Neighbour(bssid="ours", frequency_mhz=2412, seen_ms_ago=900, associated=True),
        Neighbour(bssid="untold", frequency_mhz=2412),
    ]
    assert [one.bssid for one in heard_within(found, 300)] == ["now", "ours", "untold"]


def test_channel_numbers_of_three_bands():
    assert (channel_mhz(14, 2412), channel_mhz(6, 2412), channel_mhz(36, 5180), channel_mhz(37, 6135)) == (
        2484,
        2437,
        5180,
        6135,
    )


@given(st.binary(max_size=80))
@settings(max_examples=150)
def test_elements_off_the_air_never_fail(data: bytes):
    assert sum(2 + len(body) for _, body in elements(data)) <= len(data)


@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_a_damaged_scan_is_a_neighbour_or_a_parse_error(data: st.DataObject):
    whole = SCAN[-1]
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=6)):
        if place < len(damaged):
            damaged[place] = data.draw(st.integers(0, 255))
    try:
        parse_bss(bytes(damaged))
    except ParseError:
        return


def test_a_scan_message_without_a_cell_is_none_and_a_short_bssid_a_parse_error():
    assert parse_bss(bytes(4)) is None
    with pytest.raises(ParseError, match="BSSID"):
        parse_bss(bytes(4) + pack(47, pack(1, b"\x01") + pack(2, u32(2412))))

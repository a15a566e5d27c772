from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.sources.wext_ioctl import (
    WirelessIoctls,
    WirelessSettings,
    decode_address,
    decode_frequency_mhz,
    decode_ssid,
    decode_tx_power_dbm,
)


@pytest.mark.parametrize(
    ("mantissa", "exponent", "mhz"), [(2412, 6, 2412), (241200000, 1, 2412), (5180000, 3, 5180), (11, 0, None)]
)
def test_a_frequency_is_mantissa_times_ten_to_the_exponent_and_a_channel_is_none(mantissa, exponent, mhz):
    assert decode_frequency_mhz(struct.pack("ih2B", mantissa, exponent, 0, 0)) == mhz


@pytest.mark.parametrize(
    ("value", "disabled", "flags", "dbm"),
    [(20, 0, 0, 20.0), (100, 0, 1, 20.0), (20, 1, 0, None), (3, 0, 2, None), (0, 0, 1, None)],
)
def test_tx_power_is_dbm_whatever_the_driver_counts_in(value, disabled, flags, dbm):
    assert decode_tx_power_dbm(struct.pack("iBBH", value, 1, disabled, flags)) == dbm


def test_an_unassociated_station_has_no_bssid():
    assert decode_address(struct.pack("H6s8x", 1, b"\x02\x00\x00\x00\x01\x00")) == "02:00:00:00:01:00"
    for nobody in (b"\0" * 6, b"\xff" * 6, b"\x44" * 6):
        assert decode_address(struct.pack("H6s8x", 1, nobody)) is None


def test_an_ssid_is_text_whatever_its_octets():
    assert decode_ssid(b"robots") == "robots"
    assert decode_ssid("Größe".encode()) == "Größe"
    assert decode_ssid(b"\xff\x00a") == "\\xff\x00a"
    assert decode_ssid(b"") is None
    assert decode_ssid(b"\0\0") is None


@given(st.binary(max_size=40))
@settings(max_examples=200)
def test_any_bytes_give_a_value_or_a_parse_error(data):
    for decode in (decode_address, decode_frequency_mhz, decode_tx_power_dbm, decode_ssid):
        with contextlib.suppress(ParseError):
            decode(data)


def test_a_wired_interface_is_not_wireless_and_gives_nothing():
    ioctls = WirelessIoctls()
    assert not ioctls.is_wireless("lo")
    assert ioctls.read("lo") == WirelessSettings()
    ioctls.close()

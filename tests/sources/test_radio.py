"""The radio source on a machine without one: nothing is invented, nothing fails."""

from __future__ import annotations

import pytest

from linkrover.records import Unknown, WirelessLink
from linkrover.sources.genetlink import FamilyAbsentError, Genetlink
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch
from linkrover.sources.nl80211_events import RadioEvents
from linkrover.sources.radio import RadioSource, driver_name


def has_nl80211() -> bool:
    try:
        Genetlink("nl80211").close()
    except FamilyAbsentError:
        return False
    return True


def test_a_wired_interface_has_no_wireless_record():
    sockets = InterfaceSocket()
    source = RadioSource(InterfaceWatch("lo", sockets=sockets), sockets=sockets)
    assert source.sample() == []
    assert source.last_error is None
    source.refresh()
    assert source.sample() == []
    source.close()


def test_an_absent_interface_has_no_wireless_record_that_claims_a_signal():
    sockets = InterfaceSocket()
    source = RadioSource(InterfaceWatch("nobody0", sockets=sockets), sockets=sockets)
    for record in source.sample():
        assert isinstance(record, WirelessLink)
        assert record.rssi_dbm is None
        assert record.unknown["rssi_dbm"] is Unknown.ABSENT
    source.close()


def test_a_kernel_without_wireless_says_so_for_events():
    if has_nl80211():
        pytest.skip("this kernel has nl80211; tests/wifi has events")
    with pytest.raises(FamilyAbsentError, match="nl80211: not in this kernel"):
        RadioEvents("wlan0")


def test_a_device_without_a_driver_has_no_driver_name():
    assert driver_name("lo") is None
    assert driver_name("nobody0") is None

"""The radio source on a machine without one: nothing is invented, nothing fails."""

from __future__ import annotations

import errno

import pytest

from linkrover.records import Unknown, WirelessLink
from linkrover.sources.genetlink import FamilyAbsentError, Genetlink
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch
from linkrover.sources.netlink import NetlinkError
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


class Refusing:
    """A kernel whose driver answers with an error; no simulated driver does."""

    def __init__(self, code: int) -> None:
        self.code = code
        self.asked = 0

    def read_index(self, *_: object) -> None:
        self.asked += 1
        raise NetlinkError(self.code, "stations of lo")

    def close(self) -> None:
        """Nothing to give back."""


def refused(code: int) -> tuple[RadioSource, Refusing]:
    sockets = InterfaceSocket()
    source = RadioSource(InterfaceWatch("lo", sockets=sockets), sockets=sockets)
    kernel = Refusing(code)
    source._nl = kernel
    return source, kernel


@pytest.mark.parametrize(
    ("code", "reason"),
    [(errno.ETIMEDOUT, Unknown.TIMED_OUT), (errno.EPERM, Unknown.NOT_PERMITTED), (errno.EIO, Unknown.UNSUPPORTED)],
)
def test_a_refusal_is_a_record_with_its_reason_and_the_error_is_kept(code: int, reason: Unknown):
    source, kernel = refused(code)
    (link,) = source.sample()
    assert link.rssi_dbm is None
    assert link.unknown["rssi_dbm"] is reason
    assert source.last_error.code == code
    source.sample()
    assert kernel.asked == 2  # it may work the next time
    source.close()


@pytest.mark.parametrize("code", [errno.ENODEV, errno.EOPNOTSUPP])
def test_a_device_that_nl80211_does_not_know_is_asked_by_wireless_extensions_from_then_on(code: int):
    source, kernel = refused(code)
    assert source.sample() == []  # lo is not wireless by those either
    assert source.last_error is None
    source.sample()
    assert kernel.asked == 1
    source.close()


def test_a_kernel_without_wireless_says_so_for_events():
    if has_nl80211():
        pytest.skip("this kernel has nl80211; tests/wifi has events")
    with pytest.raises(FamilyAbsentError, match="nl80211: not in this kernel"):
        RadioEvents("wlan0")


def test_a_device_without_a_driver_has_no_driver_name():
    assert driver_name("lo") is None
    assert driver_name("nobody0") is None

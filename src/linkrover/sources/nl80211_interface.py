"""nl80211: interface, channel survey, power save, regulatory domain, driver; bytes -> values.

Numbers and meanings: linux/nl80211.h.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from ..errors import ParseError
from ..records import ChannelSurvey, Now, Unknown
from .genetlink import GENL_HEADER, number, text
from .netlink import attributes
from .nl80211_station import mac_text

ATTR_WIPHY, ATTR_WIPHY_NAME, ATTR_IFINDEX, ATTR_IFNAME, ATTR_IFTYPE, ATTR_MAC = 1, 2, 3, 4, 5, 6
ATTR_REG_ALPHA2, ATTR_WIPHY_FREQ, ATTR_SSID, ATTR_SURVEY_INFO, ATTR_PS_STATE = 33, 38, 52, 84, 93
ATTR_TX_POWER, ATTR_DFS_REGION, ATTR_WDEV = 98, 146, 153
ATTR_CHANNEL_WIDTH, ATTR_CENTER_FREQ1, ATTR_CENTER_FREQ2 = 159, 160, 161

MODES = {
    1: "ibss",
    2: "station",
    3: "ap",
    4: "ap-vlan",
    5: "wds",
    6: "monitor",
    7: "mesh",
    8: "p2p-client",
    9: "p2p-go",
    10: "p2p-device",
    11: "ocb",
    12: "nan",
}
CLIENT_MODES = ("station", "p2p-client")
ACCESS_POINT_MODES = ("ap", "ap-vlan", "p2p-go")
WIDTHS_MHZ = {0: 20, 1: 20, 2: 40, 3: 80, 4: 160, 5: 160, 6: 5, 7: 10, 8: 1, 9: 2, 10: 4, 11: 8, 12: 16, 13: 320}
DFS_REGIONS = {0: "unset", 1: "FCC", 2: "ETSI", 3: "JP"}


class WirelessInterface(NamedTuple):
    """A wireless interface as NL80211_CMD_GET_INTERFACE gives it. name None: a P2P device without one."""

    name: str | None
    ifindex: int | None
    wiphy: int
    mac: str | None
    mode: str | None
    ssid: str | None
    frequency_mhz: int | None
    width_mhz: int | None
    center_mhz: int | None
    tx_power_dbm: float | None


class Regulatory(NamedTuple):
    """A regulatory domain. alpha2 "00" = the world domain: nobody set a country."""

    alpha2: str
    dfs_region: str
    wiphy: int | None  # None: the global one


def _start(payload: bytes, file: str) -> dict[int, bytes]:
    if len(payload) < GENL_HEADER:
        raise ParseError(file, "start", "a generic netlink header of 4 bytes", f"{len(payload)} bytes")
    return attributes(payload, file, GENL_HEADER)


def ssid_text(value: bytes) -> str:
    """An SSID for a reader: UTF-8 where it is that, other bytes escaped (IEEE 802.11 allows any 32 bytes)."""
    return value.decode(errors="backslashreplace").replace("\0", "\\x00")


def parse_interface(payload: bytes, file: str = "nl80211 interface") -> WirelessInterface:
    """One message of the interface dump, from its genlmsghdr on.

    Raises:
        ParseError: an attribute points outside the message or is too short, or there is no wiphy.
    """
    found = _start(payload, file)
    power = found.get(ATTR_TX_POWER)
    ssid = found.get(ATTR_SSID)
    mac = found.get(ATTR_MAC)
    width = number(found, ATTR_CHANNEL_WIDTH, "=I", file) if ATTR_CHANNEL_WIDTH in found else None
    if power is not None and len(power) < 4:
        raise ParseError(file, f"attribute {ATTR_TX_POWER}", "4 bytes", f"{len(power)} bytes")
    return WirelessInterface(
        name=text(found[ATTR_IFNAME]) if ATTR_IFNAME in found else None,
        ifindex=number(found, ATTR_IFINDEX, "=I", file) if ATTR_IFINDEX in found else None,
        wiphy=number(found, ATTR_WIPHY, "=I", file),
        mac=mac_text(mac) if mac is not None and len(mac) >= 6 else None,
        mode=MODES.get(number(found, ATTR_IFTYPE, "=I", file)) if ATTR_IFTYPE in found else None,
        ssid=ssid_text(ssid) if ssid else None,
        frequency_mhz=number(found, ATTR_WIPHY_FREQ, "=I", file) if ATTR_WIPHY_FREQ in found else None,
        width_mhz=None if width is None else WIDTHS_MHZ.get(width),
        center_mhz=number(found, ATTR_CENTER_FREQ1, "=I", file) if ATTR_CENTER_FREQ1 in found else None,
        tx_power_dbm=None if power is None else struct.unpack_from("=i", power)[0] / 100,
    )


def parse_survey(payload: bytes, at: Now, iface: str, file: str = "nl80211 survey") -> ChannelSurvey | None:
    """One message of the survey dump, from its genlmsghdr on; None where it is about no channel (radio totals).

    Noise is signed; 0 dBm counts as not given.

    Raises:
        ParseError: an attribute points outside the message or is too short.
    """
    info = attributes(_start(payload, file).get(ATTR_SURVEY_INFO, b""), file)
    if 1 not in info:
        return None
    noise = info.get(2)
    if noise is not None and not noise:
        raise ParseError(file, "noise", "1 byte", "nothing")
    noise_dbm = float(struct.unpack_from("=b", noise)[0]) or None if noise else None
    times = {
        name: number(info, kind, "=Q", file) if kind in info else None
        for name, kind in (("active_ms", 4), ("busy_ms", 5), ("rx_ms", 7), ("tx_ms", 8))
    }
    unknown = {name: Unknown.UNSUPPORTED for name, value in times.items() if value is None}
    if noise_dbm is None:
        unknown["noise_dbm"] = Unknown.UNSUPPORTED
    return ChannelSurvey(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        frequency_mhz=number(info, 1, "=I", file),
        in_use=3 in info,
        noise_dbm=noise_dbm,
        unknown=unknown,
        **times,
    )


def parse_power_save(payload: bytes, file: str = "nl80211 power save") -> bool:
    """The answer to NL80211_CMD_GET_POWER_SAVE.

    Raises:
        ParseError: it does not hold the state.
    """
    return number(_start(payload, file), ATTR_PS_STATE, "=I", file) == 1


def parse_regulatory(payload: bytes, file: str = "nl80211 regulatory") -> Regulatory:
    """One message of the answer to NL80211_CMD_GET_REG.

    Raises:
        ParseError: it does not hold a country.
    """
    found = _start(payload, file)
    alpha2 = text(found.get(ATTR_REG_ALPHA2, b""))
    if len(alpha2) != 2:
        raise ParseError(file, f"attribute {ATTR_REG_ALPHA2}", "a country of two letters", repr(alpha2))
    region = found.get(ATTR_DFS_REGION)
    return Regulatory(
        alpha2=alpha2,
        dfs_region=DFS_REGIONS.get(region[0], "unset") if region else "unset",
        wiphy=number(found, ATTR_WIPHY, "=I", file) if ATTR_WIPHY in found else None,
    )

"""Who else is on the air, and what a driver tells of itself."""

from __future__ import annotations

import enum

import msgspec

from .base import Record


class Overlap(enum.Enum):
    """How a neighbour's channel lies to the one in use."""

    CO_CHANNEL = "co-channel"  # same primary channel: the two share the airtime
    ADJACENT = "adjacent"  # the spectra overlap without the same primary channel: the two disturb each other
    NONE = "none"


class Neighbour(msgspec.Struct, frozen=True, kw_only=True):
    """One BSS of a scan (NL80211_BSS_*, IEEE 802.11 beacon elements)."""

    bssid: str
    ssid: str | None = None
    frequency_mhz: int
    center_mhz: float | None = None  # middle of the whole channel, of which frequency_mhz is the primary
    width_mhz: int | None = None
    rssi_dbm: float | None = None
    seen_ms_ago: int | None = None
    beacon_interval_tu: int | None = None
    associated: bool = False
    overlap: Overlap | None = None  # None: the channel in use is not known
    load_stations: int | None = None  # BSS Load element: stations on that access point
    load_utilization: float | None = None  # BSS Load element: busy share of its channel, 0..1


class ScanSnapshot(Record, frozen=True, kw_only=True):
    """What one scan found. A scan leaves the channel: it disturbs, so its duration is part of the record."""

    iface: str
    frequency_mhz: int | None = None  # the channel in use
    width_mhz: int | None = None
    duration_ns: int | None = None
    triggered: bool = False  # False: the kernel's list as it was, no scan of ours
    neighbours: tuple[Neighbour, ...] = ()
    co_channel: int | None = None
    adjacent: int | None = None


class RadioCapability(Record, frozen=True, kw_only=True):
    """Which values a driver gives, by record and field: "not given by this driver" is not zero.

    given and not_given hold names such as "station_link.tx_retries". undecided: nothing has come yet that could
    show it (no peer, no channel in use).
    """

    iface: str
    driver: str | None = None
    given: tuple[str, ...] = ()
    not_given: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()

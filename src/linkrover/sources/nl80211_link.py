"""A wireless link as a record: from a station of the dump and what seldom changes of the interface."""

from __future__ import annotations

from typing import NamedTuple

from ..records import Now, StationLink, Unknown, WirelessLink
from .nl80211_interface import ACCESS_POINT_MODES, CLIENT_MODES, WirelessInterface

_PEER_FIELDS = (
    "rssi_dbm",
    "rssi_avg_dbm",
    "link_quality",
    "tx_bitrate",
    "rx_bitrate",
    "tx_failed",
    "missed_beacons",
    "inactive_ms",
)
ALL_FIELDS = tuple(
    name
    for name in WirelessLink.__struct_fields__
    if name not in ("wall_ns", "mono_ns", "unknown", "iface", "source", "connected", "peer")
)
QUALITY_MAX = 70.0  # cfg80211's scale in /proc/net/wireless: rssi + 110, from 0 to 70 (net/wireless/wext-compat.c)


class Settings(NamedTuple):
    """What seldom changes of an interface, and why a part of it is not known."""

    info: WirelessInterface
    noise_dbm: float | None
    power_save: bool | None
    alpha2: str | None
    unknown: dict[str, Unknown]


def settings(info: WirelessInterface, noise_dbm: float | None, power_save: bool | None, alpha2: str | None) -> Settings:
    """With the reason of each value that the driver did not give."""
    values = {
        "ssid": info.ssid,
        "frequency_mhz": info.frequency_mhz,
        "width_mhz": info.width_mhz,
        "tx_power_dbm": info.tx_power_dbm,
        "noise_dbm": noise_dbm,
        "power_save": power_save,
        "regulatory_domain": alpha2,
    }
    unknown = {name: Unknown.UNSUPPORTED for name, value in values.items() if value is None}
    return Settings(info, noise_dbm, power_save, alpha2, unknown)


def links(state: Settings, iface: str, at: Now, stations: list[StationLink]) -> tuple[WirelessLink, ...]:
    """One link per associated station; one without a peer where there is none."""
    client = state.info.mode in CLIENT_MODES
    if client:
        stations = [one for one in stations if one.associated is not False]
    if not stations:
        return (_idle(state, iface, at),)
    return tuple(_link(state, iface, at, one, client) for one in stations)


def _idle(state: Settings, iface: str, at: Now) -> WirelessLink:
    info = state.info
    unknown = {**state.unknown, **dict.fromkeys(_PEER_FIELDS, Unknown.NOT_CONNECTED)}
    client = info.mode in CLIENT_MODES
    if client:
        for name in ("ssid", "bssid", "frequency_mhz", "width_mhz"):
            unknown[name] = Unknown.NOT_CONNECTED
    return WirelessLink(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        source="nl80211",
        connected=False,
        mode=info.mode,
        ssid=None if client else info.ssid,
        bssid=info.mac if info.mode in ACCESS_POINT_MODES else None,
        frequency_mhz=None if client else info.frequency_mhz,
        width_mhz=None if client else info.width_mhz,
        tx_power_dbm=info.tx_power_dbm,
        noise_dbm=state.noise_dbm,
        power_save=state.power_save,
        regulatory_domain=state.alpha2,
        unknown=unknown,
    )


def _link(state: Settings, iface: str, at: Now, station: StationLink, client: bool) -> WirelessLink:
    info = state.info
    rssi_dbm = station.rssi_dbm
    unknown = state.unknown
    if station.unknown:
        more = {name: station.unknown[name] for name in _PEER_FIELDS if name in station.unknown}
        if "beacon_loss" in station.unknown:
            more["missed_beacons"] = Unknown.UNSUPPORTED
        if rssi_dbm is None:
            more["link_quality"] = Unknown.UNSUPPORTED
        if more:
            unknown = {**unknown, **more}
    return WirelessLink(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        source="nl80211",
        connected=True,
        mode=info.mode,
        peer=None if client else station.peer,
        ssid=info.ssid,
        bssid=station.peer if client else info.mac if info.mode in ACCESS_POINT_MODES else None,
        frequency_mhz=info.frequency_mhz,
        width_mhz=info.width_mhz,
        tx_power_dbm=info.tx_power_dbm,
        rssi_dbm=rssi_dbm,
        rssi_avg_dbm=station.rssi_avg_dbm,
        noise_dbm=state.noise_dbm,
        link_quality=None if rssi_dbm is None else max(0.0, min(QUALITY_MAX, rssi_dbm + 110.0)),
        link_quality_max=QUALITY_MAX,
        tx_bitrate=station.tx_bitrate,
        rx_bitrate=station.rx_bitrate,
        tx_failed=station.tx_failed,
        missed_beacons=station.beacon_loss,
        inactive_ms=station.inactive_ms,
        power_save=state.power_save,
        rssi_stale=station.rssi_stale,
        regulatory_domain=state.alpha2,
        unknown=unknown,
    )

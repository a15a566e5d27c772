"""What the kernel knows of an interface and its link."""

from __future__ import annotations

import enum

import msgspec

from .base import Record


class Bitrate(msgspec.Struct, frozen=True, kw_only=True):
    """A PHY rate as nl80211 gives it (NL80211_RATE_INFO_*)."""

    rate_bps: int | None = None
    mode: str | None = None  # legacy, ht, vht, he, eht
    mcs: int | None = None
    nss: int | None = None
    width_mhz: int | None = None
    guard_interval_ns: int | None = None


class Continuity(enum.Enum):
    """How a counter sample relates to the one before it."""

    FIRST = "first"
    STEADY = "steady"
    WRAPPED = "wrapped"  # a 32-bit counter went round; the increment is corrected
    RESET = "reset"  # counters fell: no rate over this interval
    GONE = "gone"  # the interface is not there now
    BACK = "back"  # there again after it was gone, or under another index: no rate over this interval


class WirelessLink(Record, frozen=True, kw_only=True):
    """Signal and link state of one interface; on an access point, of one associated peer."""

    iface: str
    source: str  # "nl80211" or "wext"
    connected: bool | None = None
    mode: str | None = None  # station, ap, mesh, p2p-client, p2p-go, monitor, ibss
    peer: str | None = None  # MAC of the peer, where the value belongs to one peer of an access point
    ssid: str | None = None
    bssid: str | None = None
    frequency_mhz: int | None = None
    width_mhz: int | None = None
    tx_power_dbm: float | None = None
    rssi_dbm: float | None = None
    rssi_avg_dbm: float | None = None
    noise_dbm: float | None = None
    link_quality: float | None = None  # the driver's own scale
    link_quality_max: float | None = None
    tx_bitrate: Bitrate | None = None
    rx_bitrate: Bitrate | None = None
    tx_failed: int | None = None  # frames given up after all retries
    missed_beacons: int | None = None
    inactive_ms: int | None = None  # age of the last frame from the peer: an old RSSI is old by this much
    power_save: bool | None = None
    rssi_stale: bool | None = None  # True: inactive_ms is so large that rssi_dbm is of the past, not of now
    regulatory_domain: str | None = None  # ISO 3166 code, "00" = world (unset)


class LinkUtilization(Record, frozen=True, kw_only=True):
    """Traffic of one interface (/proc/net/dev) and of the whole machine's TCP and UDP (/proc/net/snmp).

    Totals are the kernel's raw counters. Rates are per measured interval. The tcp_* and udp_* figures belong to
    the whole network namespace by the kernel's nature, not to the interface.
    """

    iface: str
    continuity: Continuity = Continuity.STEADY
    interval_ns: int | None = None
    rx_bytes: int | None = None
    tx_bytes: int | None = None
    rx_packets: int | None = None
    tx_packets: int | None = None
    rx_rate_bps: float | None = None
    tx_rate_bps: float | None = None
    tcp_tx_segments: int | None = None
    tcp_rx_segments: int | None = None
    tcp_tx_segments_per_s: float | None = None
    tcp_rx_segments_per_s: float | None = None
    udp_tx_datagrams: int | None = None
    udp_rx_datagrams: int | None = None
    udp_tx_datagrams_per_s: float | None = None
    udp_rx_datagrams_per_s: float | None = None


class NetworkErrors(Record, frozen=True, kw_only=True):
    """Error counters at every layer, raw and cumulative; increments belong to the analysis.

    tcp_* and udp_* are of the whole network namespace, mac_* and nic_* of the interface.
    """

    iface: str
    continuity: Continuity = Continuity.STEADY
    tcp_retransmits: int | None = None
    tcp_bad_segments: int | None = None
    tcp_lost_retransmits: int | None = None
    tcp_timeouts: int | None = None
    udp_errors: int | None = None
    udp_buffer_errors: int | None = None
    mac_tx_retries: int | None = None
    mac_rx_dropped: int | None = None
    nic_tx_errors: int | None = None
    nic_rx_errors: int | None = None
    nic_tx_dropped: int | None = None
    nic_rx_dropped: int | None = None


class TidCounters(msgspec.Struct, frozen=True, kw_only=True):
    """Frames of one traffic identifier (NL80211_TID_STATS_*); raw counters. tid 16 = without QoS."""

    tid: int
    rx_frames: int | None = None
    tx_frames: int | None = None
    tx_retries: int | None = None
    tx_failed: int | None = None


class StationLink(Record, frozen=True, kw_only=True):
    """One peer of a wireless interface as the nl80211 station dump gives it (NL80211_STA_INFO_*)."""

    iface: str
    peer: str
    rssi_dbm: float | None = None
    rssi_avg_dbm: float | None = None
    rssi_chain_dbm: tuple[float, ...] = ()
    beacon_rssi_avg_dbm: float | None = None
    ack_rssi_dbm: float | None = None
    tx_bitrate: Bitrate | None = None
    rx_bitrate: Bitrate | None = None
    tx_packets: int | None = None
    rx_packets: int | None = None
    tx_bytes: int | None = None
    rx_bytes: int | None = None
    tx_retries: int | None = None
    tx_failed: int | None = None
    rx_dropped: int | None = None
    beacon_loss: int | None = None
    inactive_ms: int | None = None
    connected_s: int | None = None
    expected_throughput_bps: int | None = None
    tx_airtime_us: int | None = None
    rx_airtime_us: int | None = None
    rssi_stale: bool | None = None  # True: inactive_ms is so large that rssi_dbm is of the past, not of now
    rssi_chain_avg_dbm: tuple[float, ...] = ()
    ack_rssi_avg_dbm: float | None = None
    rx_beacons: int | None = None
    associated: bool | None = None
    authorized: bool | None = None
    tids: tuple[TidCounters, ...] = ()


class ChannelSurvey(Record, frozen=True, kw_only=True):
    """How busy a channel is (NL80211_SURVEY_INFO_*). Times are the driver's raw running counters."""

    iface: str
    frequency_mhz: int
    in_use: bool = False
    noise_dbm: float | None = None
    active_ms: int | None = None
    busy_ms: int | None = None
    rx_ms: int | None = None
    tx_ms: int | None = None
    utilization: float | None = None  # busy share of the last interval, 0..1

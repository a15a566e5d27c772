"""Records to columns: one table per record type and interface, `None` as NaN."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from linkrover.records import Bitrate, LinkEvent, Manifest, Record, ScanSnapshot

if TYPE_CHECKING:
    from .run import Columns

# What the figures need of each record type; the first group is the key under which its tables are kept apart.
KEYS: dict[str, tuple[str, ...]] = {
    "LinkUtilization": ("iface",),
    "NetworkErrors": ("iface",),
    "WirelessLink": ("iface",),
    "StationLink": ("iface",),
    "ProbeResult": (),
    "NetworkDelay": ("method",),
    "ClockOffset": (),
    "Pose": (),
    "VelocityCommand": (),
    "SelfAccount": (),
    "ChannelSurvey": ("iface", "frequency_mhz"),
    "TcpConnection": ("iface",),
    "TopicTraffic": ("topic", "direction", "peer", "node"),
    "LinkTruth": ("hop",),
    "ProbeTruth": ("direction",),
}
INTEGERS = frozenset({"wall_ns", "mono_ns"})
FIELDS: dict[str, tuple[str, ...]] = {
    "LinkUtilization": ("interval_ns", "rx_bytes", "tx_bytes", "rx_rate_bps", "tx_rate_bps", "continuity"),
    "NetworkErrors": (
        "tcp_retransmits",
        "tcp_bad_segments",
        "tcp_lost_retransmits",
        "tcp_timeouts",
        "udp_errors",
        "udp_buffer_errors",
        "mac_tx_retries",
        "mac_rx_dropped",
        "nic_tx_errors",
        "nic_rx_errors",
        "nic_tx_dropped",
        "nic_rx_dropped",
    ),
    "WirelessLink": (
        "source",
        "connected",
        "mode",
        "peer",
        "rssi_dbm",
        "link_quality",
        "inactive_ms",
    ),
    "StationLink": (
        "peer",
        "rssi_dbm",
        "inactive_ms",
        "tx_bitrate.rate_bps",
        "tx_bitrate.mode",
        "tx_bitrate.mcs",
        "tx_bitrate.nss",
        "rx_bitrate.rate_bps",
        "rx_bitrate.mcs",
        "tx_packets",
        "tx_bytes",
        "rx_bytes",
        "tx_retries",
        "tx_failed",
        "beacon_loss",
        "connected_s",
    ),
    "ProbeResult": (
        "peer",
        "session",
        "sequence",
        "reflector_sequence",
        "state",
        "rtt_ns",
        "t1_ns",
        "t2_ns",
        "t3_ns",
        "t4_ns",
        "duplicates",
        "reordered",
    ),
    "NetworkDelay": ("delay_ns", "deadline_ns", "late"),
    "ClockOffset": ("offset_ns", "error_bound_ns", "drift_ppb"),
    "Pose": ("x_m", "y_m", "heading_rad", "forward_m_per_s", "turn_rad_per_s"),
    "VelocityCommand": ("forward_m_per_s", "sideways_m_per_s", "turn_rad_per_s"),
    "SelfAccount": (
        "interval_ns",
        "cpu_ns",
        "rss_bytes",
        "samples",
        "missed_slots",
        "lateness_median_ns",
        "lateness_max_ns",
        "records_written",
        "records_lost",
        "bytes_written",
    ),
    "ChannelSurvey": ("in_use", "noise_dbm", "active_ms", "busy_ms", "rx_ms", "tx_ms", "utilization"),
    "TcpConnection": (
        "local",
        "remote",
        "process",
        "congestion_control",
        "rtt_us",
        "min_rtt_us",
        "retransmits",
        "congestion_window",
        "delivery_rate_bps",
        "bytes_sent",
        "bytes_acked",
        "bytes_received",
        "bytes_retransmitted",
        "busy_us",
        "receive_window_limited_us",
        "send_buffer_limited_us",
    ),
    "TopicTraffic": ("transport", "local", "remote", "bytes_total", "messages_total", "rate_bps", "messages_per_s"),
    "LinkTruth": (
        "interval_ns",
        "distance_m",
        "rssi_dbm",
        "associated",
        "offered_packets",
        "offered_bytes",
        "delivered_packets",
        "delivered_bytes",
        "airtime_ns",
        "queue_bytes",
    ),
    "ProbeTruth": ("session", "sequence", "delay_ns", "dropped"),
}
TEXTS = frozenset(
    {
        "continuity",
        "source",
        "mode",
        "peer",
        "state",
        "dropped",
        "local",
        "remote",
        "process",
        "congestion_control",
        "transport",
        "tx_bitrate.mode",
    }
)
# What a driver gives in steps no finer than a single holds: half the memory of a week's readings.
SINGLES = frozenset(
    {
        "connected",
        "rssi_dbm",
        "link_quality",
        "inactive_ms",
        "duplicates",
        "reordered",
        "tx_bitrate.rate_bps",
        "tx_bitrate.mcs",
        "tx_bitrate.nss",
        "rx_bitrate.rate_bps",
        "rx_bitrate.mcs",
        "noise_dbm",
        "in_use",
    }
)


@dataclass(slots=True)
class RawEnd:
    """The tables of one recording by record type, each by its key; and what is no table."""

    tables: dict[str, dict[tuple[str, ...], Columns]] = field(default_factory=dict)
    manifest: Manifest | None = None
    events: list[LinkEvent] = field(default_factory=list)
    scans: list[ScanSnapshot] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    published_2021: bool = False  # messages of the 2021 package as its nodes published them

    def table(self, kind: str, *key: str) -> Columns | None:
        """One table, `None` where nothing of it was recorded."""
        return self.tables.get(kind, {}).get(key)


def from_records(records: Iterable[Record]) -> RawEnd:
    """Collect any stream of records; types without figures are passed over."""
    raw = RawEnd()
    rows: dict[str, dict[tuple[str, ...], list[Record]]] = {}
    for record in records:
        kind = type(record).__name__
        keys = KEYS.get(kind)
        if keys is None:
            if isinstance(record, LinkEvent):
                raw.events.append(record)
            elif isinstance(record, ScanSnapshot):
                raw.scans.append(record)
            elif isinstance(record, Manifest):
                raw.manifest = raw.manifest or record
            continue
        key = tuple(str(getattr(record, name)) for name in keys)
        rows.setdefault(kind, {}).setdefault(key, []).append(record)
    raw.tables = {kind: {key: _columns(kind, found) for key, found in groups.items()} for kind, groups in rows.items()}
    return raw


def _columns(kind: str, records: list[Record]) -> Columns:
    import numpy as np

    out: Columns = {name: np.array([getattr(r, name) for r in records], np.int64) for name in ("wall_ns", "mono_ns")}
    for name in FIELDS[kind]:
        values = [_member(r, name) for r in records]
        out[name] = np.array([_text(v) for v in values], object) if name in TEXTS else numbers(values)
    return out


def _member(record: Record, name: str) -> Any:
    """A field, or with a dot a field of the struct in it."""
    outer, _, inner = name.partition(".")
    value = getattr(record, outer)
    return getattr(value, inner, None) if inner else value


def _text(value: Any) -> str | None:
    if value is None:
        return None
    return str(value.value if isinstance(value, enum.Enum) else value)


def numbers(values: list[Any]) -> Any:
    """Any mixture of numbers, bools, bit rates and `None` as float64."""
    import numpy as np

    try:
        return np.array(values, np.float64)  # None becomes NaN
    except TypeError:
        plain = [(v.rate_bps if isinstance(v, Bitrate) else v) for v in values]
        return np.array([np.nan if v is None else float(v) for v in plain], np.float64)

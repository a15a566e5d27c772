"""Each peer of a wireless interface apart: at an access point one a robot, never mixed; at a robot its access point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from .addresses import owner_of_mac
from .group import by_names, quantile, rise, usual_word
from .link import signal_steps
from .run import Run
from .stats import weighted_mean_std, weighted_quantiles

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns


class StationFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One peer as the driver counts it (nl80211 station dump). Rates are those of the PHY, Mbit/s, not throughput.

    rssi_*: dBm, time-weighted, of fresh readings. retries_percent: tries again per 100 frames sent.
    """

    end: str
    iface: str
    peer: str
    peer_is: str | None = None  # "robot wlan0" where it is an interface of the other end
    seen_s: float
    rssi_mean: float | None = None
    rssi_std: float | None = None
    rssi_p5: float | None = None
    tx_rate_median_mbps: float | None = None
    tx_rate_p5_mbps: float | None = None
    tx_mode: str | None = None  # legacy, ht, vht, he, eht: what an MCS number means depends on it
    tx_mcs_median: float | None = None
    tx_mcs_p5: float | None = None
    tx_streams: float | None = None
    rx_rate_median_mbps: float | None = None
    rx_mcs_median: float | None = None
    sent_mb: float | None = None
    received_mb: float | None = None
    frames_sent: float | None = None
    retries: float | None = None
    retries_percent: float | None = None
    failed: float | None = None  # frames given up after all retries
    beacon_losses: float | None = None
    associations: int = 1  # how often it began anew: the driver counts from zero then
    reason: str | None = None


def station_figures(run: Run) -> list[StationFigures]:
    """All peers of all interfaces of both ends, longest seen first."""
    found = [
        _station(run, role, iface, peer, table)
        for role, end in run.ends.items()
        for iface, every in end.stations.items()
        for (peer,), table in by_names(every, "peer").items()
    ]
    return sorted(found, key=lambda s: (s.end, s.iface, -s.seen_s))


def peer_signals(run: Run, role: str) -> list[tuple[str, str, Columns]]:
    """(interface, peer, its table with t_s and rssi_dbm) of interfaces with more than one peer."""
    return [
        (iface, peer, table)
        for iface, every in run.ends[role].stations.items()
        if len(parts := by_names(every, "peer")) > 1
        for (peer,), table in parts.items()
    ]


def _station(run: Run, role: str, iface: str, peer: str, table: Columns) -> StationFigures:
    import numpy as np

    nothing = np.full(len(table["t_s"]), np.nan)
    starts, stops, valid, _ = signal_steps({"connected": np.ones(len(nothing)), **table}, published_2021=False)
    held = np.minimum(stops, float(run.span.ends[-1]) if len(run.span.ends) else np.inf) - starts
    weights = np.where(valid, np.maximum(held, 0.0), 0.0)
    rssi = np.where(valid, table["rssi_dbm"], 0.0).astype(np.float64)
    mean, std = weighted_mean_std(rssi, weights)
    (low,) = weighted_quantiles(rssi, weights, (0.05,))
    again = _restarts(table)
    sent, retries = (rise(table.get(name), again) for name in ("tx_packets", "tx_retries"))
    moved = {name: rise(table.get(f"{name}_bytes"), again) for name in ("tx", "rx")}
    tx_rate, rx_rate = (table.get(f"{way}_bitrate.rate_bps", nothing) / 1e6 for way in ("tx", "rx"))
    mcs = table.get("tx_bitrate.mcs", nothing)
    return StationFigures(
        end=role,
        iface=iface,
        peer=peer,
        peer_is=owner_of_mac(run, peer),
        seen_s=float(np.maximum(held, 0.0).sum()),
        rssi_mean=mean,
        rssi_std=std,
        rssi_p5=low,
        tx_rate_median_mbps=quantile(tx_rate, 0.5),
        tx_rate_p5_mbps=quantile(tx_rate, 0.05),
        tx_mode=usual_word(table.get("tx_bitrate.mode")),
        tx_mcs_median=quantile(mcs, 0.5),
        tx_mcs_p5=quantile(mcs, 0.05),
        tx_streams=quantile(table.get("tx_bitrate.nss", nothing), 0.5),
        rx_rate_median_mbps=quantile(rx_rate, 0.5),
        rx_mcs_median=quantile(table.get("rx_bitrate.mcs", nothing), 0.5),
        sent_mb=_mega(moved["tx"]),
        received_mb=_mega(moved["rx"]),
        frames_sent=sent,
        retries=retries,
        retries_percent=100.0 * retries / sent if sent and retries is not None else None,
        failed=rise(table.get("tx_failed"), again),
        beacon_losses=rise(table.get("beacon_loss"), again),
        associations=1 + int(again.sum()),
    )


def _restarts(table: Columns) -> NDArray[np.bool_]:
    """Samples before which the peer associated anew: its time since association fell."""
    import numpy as np

    since = table.get("connected_s")
    if since is None:
        return np.zeros(len(table["t_s"]), bool)
    return np.asarray(np.diff(since, prepend=since[:1]) < 0, dtype=np.bool_)


def _mega(octets: float | None) -> float | None:
    return None if octets is None else octets / 1e6

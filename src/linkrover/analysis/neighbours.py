"""Who else is on the air: the networks that scans found, and how their channels lie to the one in use."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from linkrover.records import Neighbour, Overlap, ScanSnapshot

from .channel import channel_number
from .run import Run

MOST_NEIGHBOURS = 40
# Above this a radio holds back from sending (IEEE 802.11-2020, 17.3.10.6: start of a valid 20 MHz frame).
DEFER_DBM = -82.0


class NeighbourFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One network over all scans. load_percent: how busy its access point says its channel is (BSS Load element)."""

    bssid: str
    ssid: str | None = None
    frequency_mhz: int
    channel: int | None = None
    width_mhz: int | None = None
    overlap: str | None = None  # co-channel, adjacent or none, to the channel in use
    own: bool = False  # the end's own access point
    scans: int = 0
    rssi_median_dbm: float | None = None
    rssi_max_dbm: float | None = None
    load_percent: float | None = None
    load_stations: float | None = None
    reason: str | None = None


class NeighbourhoodFigures(msgspec.Struct, frozen=True, kw_only=True):
    """What one interface found around it. The end's own access point does not count among the networks."""

    end: str
    iface: str
    frequency_mhz: int | None = None
    channel: int | None = None
    width_mhz: int | None = None
    scans: int = 0
    scans_triggered: int = 0  # scans of our own: each left the channel for scan_median_s
    scan_median_s: float | None = None
    networks: int = 0
    co_channel: int = 0  # networks found on the same primary channel in any scan: they share the airtime
    co_channel_heard: int = 0  # of those, strong enough (-82 dBm) for a radio to wait for them
    adjacent: int = 0  # networks overlapping without the same primary channel: they disturb as noise
    co_channel_mean: float | None = None  # by scan
    adjacent_mean: float | None = None
    strongest_co_channel_dbm: float | None = None
    strongest_adjacent_dbm: float | None = None
    neighbours: list[NeighbourFigures] = []  # strongest first, at most 40
    reason: str | None = None


def neighbourhoods(run: Run) -> list[NeighbourhoodFigures]:
    """One for every interface with scans."""
    found = []
    for role, end in run.ends.items():
        by_iface: dict[str, list[ScanSnapshot]] = {}
        for _, scan in end.scans:
            by_iface.setdefault(scan.iface, []).append(scan)
        found += [_neighbourhood(role, iface, scans) for iface, scans in sorted(by_iface.items())]
    return found


def _neighbourhood(role: str, iface: str, scans: Sequence[ScanSnapshot]) -> NeighbourhoodFigures:
    import statistics

    seen: dict[str, list[Neighbour]] = {}
    for scan in scans:
        for one in scan.neighbours:
            seen.setdefault(one.bssid, []).append(one)
    every = [_neighbour(bssid, found) for bssid, found in seen.items()]
    every.sort(key=lambda n: -(n.rssi_max_dbm if n.rssi_max_dbm is not None else -999.0))
    others = [n for n in every if not n.own]
    same, near = ([n for n in others if n.overlap == kind.value] for kind in (Overlap.CO_CHANNEL, Overlap.ADJACENT))
    used = [scan.frequency_mhz for scan in scans if scan.frequency_mhz is not None]
    frequency = max(set(used), key=used.count) if used else None
    took = [scan.duration_ns / 1e9 for scan in scans if scan.duration_ns is not None]
    co_means = [scan.co_channel for scan in scans if scan.co_channel is not None]
    adjacent_means = [scan.adjacent for scan in scans if scan.adjacent is not None]
    return NeighbourhoodFigures(
        end=role,
        iface=iface,
        frequency_mhz=frequency,
        channel=channel_number(frequency) if frequency is not None else None,
        width_mhz=next((scan.width_mhz for scan in reversed(scans) if scan.width_mhz is not None), None),
        scans=len(scans),
        scans_triggered=sum(scan.triggered for scan in scans),
        scan_median_s=statistics.median(took) if took else None,
        networks=len(others),
        co_channel=len(same),
        co_channel_heard=sum(n.rssi_max_dbm is not None and n.rssi_max_dbm >= DEFER_DBM for n in same),
        adjacent=len(near),
        co_channel_mean=statistics.fmean(co_means) if co_means else None,
        adjacent_mean=statistics.fmean(adjacent_means) if adjacent_means else None,
        strongest_co_channel_dbm=_strongest(same),
        strongest_adjacent_dbm=_strongest(near),
        neighbours=every[:MOST_NEIGHBOURS],
        reason=None if used else "co_channel, adjacent: the channel in use was not known",
    )


def _neighbour(bssid: str, found: Sequence[Neighbour]) -> NeighbourFigures:
    import statistics

    rssi = [one.rssi_dbm for one in found if one.rssi_dbm is not None]
    load = [one.load_utilization for one in found if one.load_utilization is not None]
    stations = [one.load_stations for one in found if one.load_stations is not None]
    # a robot that changes its channel meets the same network in more than one way: the worst counts
    overlaps = [one.overlap for one in found if one.overlap is not None]
    worst = next((k for k in (Overlap.CO_CHANNEL, Overlap.ADJACENT, Overlap.NONE) if k in overlaps), None)
    last = found[-1]
    return NeighbourFigures(
        bssid=bssid,
        ssid=next((one.ssid for one in reversed(found) if one.ssid), None),
        frequency_mhz=last.frequency_mhz,
        channel=channel_number(last.frequency_mhz),
        width_mhz=last.width_mhz,
        overlap=worst.value if worst is not None else None,
        own=any(one.associated for one in found),
        scans=len(found),
        rssi_median_dbm=statistics.median(rssi) if rssi else None,
        rssi_max_dbm=max(rssi, default=None),
        load_percent=100.0 * statistics.fmean(load) if load else None,
        load_stations=statistics.fmean(stations) if stations else None,
    )


def _strongest(found: Sequence[NeighbourFigures]) -> float | None:
    return max((n.rssi_max_dbm for n in found if n.rssi_max_dbm is not None), default=None)

"""The radio in detail: each peer apart, how busy the channel was, who else is on it."""

from __future__ import annotations

from linkrover.analysis.channel import ChannelFigures
from linkrover.analysis.neighbours import NeighbourFigures, NeighbourhoodFigures
from linkrover.analysis.stations import StationFigures
from linkrover.analysis.summary import RunSummary

from .section import Section
from .table import Column, Table, without_unknown

MOST_LISTED = 20


def air_section(summary: RunSummary) -> Section:
    """Stations, channels and neighbours, as far as they were recorded."""
    section = Section("On the air")
    for hood in summary.neighbourhoods:
        section.words += hood_words(hood)
    if summary.stations:
        section.tables.append(station_table(summary))
    if any(_tells(channel) for channel in summary.channels):
        section.tables.append(channel_table(summary))
    if any(hood.neighbours for hood in summary.neighbourhoods):
        section.tables.append(neighbour_table(summary))
    return section


def station_table(summary: RunSummary) -> Table:
    """Each peer of each wireless interface: at an access point one robot a row."""
    columns = (
        Column("seen by"),
        Column("peer"),
        Column("RSSI (dBm)", 1, short="dBm"),
        Column("std", 1),
        Column("PHY rate to it, median (Mbit/s)", 1, short="to it Mbit/s"),
        Column("MCS to it", short="MCS", spare=True),
        Column("PHY rate from it, median (Mbit/s)", 1, short="from it Mbit/s"),
        Column("retries per 100 frames", 1, short="retries %"),
        Column("frames given up", 0, short="given up"),
        Column("sent to it (MB)", 2, short="to it MB", spare=True),
        Column("received from it (MB)", 2, short="from it MB", spare=True),
        Column("associations", 0, short="assoc.", spare=True),
    )
    table = Table("Each wireless peer apart", columns, name=f"stations-{summary.run}")
    for s in summary.stations:
        row: list[str | float | int | None] = [f"{s.end} {s.iface}", peer_name(s), s.rssi_mean, s.rssi_std]
        row += [s.tx_rate_median_mbps, mcs_words(s), s.rx_rate_median_mbps, s.retries_percent, s.failed]
        table.rows.append([*row, s.sent_mb, s.received_mb, s.associations])
    table.notes.append(
        "As the driver of the end that sees it counts; PHY rates are those of single frames, not throughput. "
        f"An MCS number's meaning depends on its mode. Unknown ({'–'}) is what the driver does not give, not zero."
    )
    return without_unknown(table)


def peer_name(station: StationFigures) -> str:
    """The other end's interface, where it is one, else the hardware address."""
    return f"{station.peer_is} ({station.peer})" if station.peer_is else station.peer


def mcs_words(station: StationFigures) -> str | None:
    """For example "ht 7 (5 % below 4)"; `None` where no rate has an MCS."""
    if station.tx_mcs_median is None:
        return station.tx_mode
    words = f"{station.tx_mode or ''} {station.tx_mcs_median:g}".strip()
    low = station.tx_mcs_p5
    return f"{words} (5 % at {low:g} or below)" if low is not None and low < station.tx_mcs_median else words


def channel_table(summary: RunSummary) -> Table:
    """How busy and how noisy each surveyed channel was."""
    columns = (
        Column("seen by"),
        Column("channel"),
        Column("busy (%)", 1, short="busy %"),
        Column("busy, 95th percentile (%)", 1, short="95th %", spare=True),
        Column("own receiving (%)", 1, short="rx %"),
        Column("own sending (%)", 1, short="tx %"),
        Column("noise, median (dBm)", 0, short="noise dBm"),
        Column("noise, worst (dBm)", 0, short="worst dBm", spare=True),
        Column("listened (s)", 1, short="listened s", spare=True),
    )
    table = Table("How busy the channel was", columns, name=f"channels-{summary.run}")
    for c in summary.channels:
        if not _tells(c):
            continue
        name = f"{channel_name(c.channel, c.frequency_mhz)}{', in use' if c.in_use else ''}"
        row: list[str | float | int | None] = [f"{c.end} {c.iface}", name, c.busy_percent, c.busy_p95_percent]
        row += [c.receiving_percent, c.sending_percent, c.noise_dbm, c.noise_max_dbm]
        table.rows.append([*row, c.listened_s])
    table.notes.append(
        "Shares of the time the radio listened to the channel. Busy less receiving and sending is what it heard but "
        "could not decode: other networks and interference."
    )
    return without_unknown(table)


def _tells(channel: ChannelFigures) -> bool:
    return channel.busy_percent is not None or channel.noise_dbm is not None


def channel_name(channel: int | None, frequency_mhz: int | None) -> str:
    """For example "6 (2437 MHz)"."""
    if frequency_mhz is None:
        return "unknown"
    return f"{channel} ({frequency_mhz} MHz)" if channel is not None else f"{frequency_mhz} MHz"


def neighbour_table(summary: RunSummary) -> Table:
    """The networks found, strongest first."""
    columns = (
        Column("seen by"),
        Column("network"),
        Column("BSSID", spare=True),
        Column("channel"),
        Column("width (MHz)", 0, short="MHz", spare=True),
        Column("to ours"),
        Column("RSSI median (dBm)", 0, short="dBm", spare=True),
        Column("strongest (dBm)", 0, short="best dBm"),
        Column("its channel load (%)", 0, short="load %"),
        Column("its stations", 1, short="stations", spare=True),
        Column("in scans", 0, short="scans", spare=True),
    )
    table = Table("Networks in reach", columns, name=f"neighbours-{summary.run}")
    left_out = 0
    for hood in summary.neighbourhoods:
        for n in hood.neighbours[:MOST_LISTED]:
            where = channel_name(n.channel, n.frequency_mhz)
            row: list[str | float | int | None] = [f"{hood.end} {hood.iface}", n.ssid or "(hidden)", n.bssid, where]
            row += [n.width_mhz, overlap_words(n), n.rssi_median_dbm, n.rssi_max_dbm, n.load_percent, n.load_stations]
            table.rows.append([*row, n.scans])
        left_out += max(0, hood.networks - MOST_LISTED)
    if left_out:
        table.notes.append(f"{left_out} weaker ones are not listed.")
    table.notes.append("Load and stations are what the access point announces of its channel (BSS Load element).")
    return without_unknown(table)


def overlap_words(neighbour: NeighbourFigures) -> str | None:
    """How its channel lies to the one in use."""
    if neighbour.own:
        return "our own"
    return {"none": "apart"}.get(neighbour.overlap or "", neighbour.overlap)


def hood_words(hood: NeighbourhoodFigures) -> list[str]:
    """Interference on the same and on overlapping channels, and what the scans disturbed."""
    where = f"{hood.end} {hood.iface} on channel {channel_name(hood.channel, hood.frequency_mhz)}"
    words = []
    if hood.frequency_mhz is None:
        words.append(f"{hood.end} {hood.iface}: {hood.networks} networks found; which channel was in use is unknown.")
    elif hood.co_channel or hood.adjacent:
        parts = []
        if hood.co_channel:
            waits = f", {hood.co_channel_heard} of them so strong that the radio waits for them (-82 dBm)"
            parts.append(
                f"{_networks(hood.co_channel)} on the same channel, which share its airtime (strongest "
                f"{_level(hood.strongest_co_channel_dbm)}{waits})"
            )
        if hood.adjacent:
            parts.append(
                f"{_networks(hood.adjacent)} overlapping it without sharing it, which disturb like noise (strongest "
                f"{_level(hood.strongest_adjacent_dbm)})"
            )
        words.append(f"Interference: {where}: {'; '.join(parts)}.")
        loads = [n.load_percent for n in hood.neighbours if n.load_percent is not None and n.overlap == "co-channel"]
        if loads:
            words.append(f"An access point on that channel announces it to be busy {max(loads):.0f} % of the time.")
    else:
        words.append(f"No interference found: {where}: no other network on it or overlapping it.")
    if hood.scans_triggered:
        took = f", {hood.scan_median_s:.2f} s each at the median" if hood.scan_median_s is not None else ""
        words.append(
            f"{hood.scans_triggered} of {hood.scans} scans at the {hood.end} were the agent's own{took}: the radio "
            "left its channel meanwhile, and what was sent then waited."
        )
    return words


def _networks(count: int) -> str:
    return f"{count} other network{'s' if count > 1 else ''}"


def _level(dbm: float | None) -> str:
    return "unknown" if dbm is None else f"{dbm:.0f} dBm"

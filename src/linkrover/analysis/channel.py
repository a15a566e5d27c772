"""How busy a channel was and how noisy, from the driver's survey."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from .group import quantile, steps
from .run import Run

if TYPE_CHECKING:
    from .run import Columns, Floats


class ChannelFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One channel at one interface. Shares are in percent of the time the radio listened to it (`listened_s`).

    busy is everything the radio found the channel busy with, its own sending included; receiving and sending are the
    radio's own part of it, so that busy less both is others' traffic it could not decode, and interference.
    """

    end: str
    iface: str
    frequency_mhz: int
    channel: int | None = None
    in_use: bool = False
    samples: int = 0
    listened_s: float | None = None
    busy_percent: float | None = None
    busy_p95_percent: float | None = None  # of the intervals between samples
    receiving_percent: float | None = None
    sending_percent: float | None = None
    noise_dbm: float | None = None  # median
    noise_max_dbm: float | None = None
    reason: str | None = None


def channel_figures(run: Run) -> list[ChannelFigures]:
    """All channels surveyed, those in use first."""
    found = [
        _channel(role, iface, mhz, table)
        for role, end in run.ends.items()
        for (iface, mhz), table in end.surveys.items()
    ]
    return sorted(found, key=lambda c: (c.end, c.iface, not c.in_use, c.frequency_mhz))


def busy_shares(table: Columns) -> tuple[Floats, Floats]:
    """(share 0..1, listened ms) of the interval that ends at each sample; NaN and 0 where the counters do not tell.

    From the raw counters where both samples have them and they ran on; else the recorded share, for as long as the
    usual interval.
    """
    import numpy as np

    t = table["t_s"]
    nothing = np.full(len(t), np.nan)
    active, busy = table.get("active_ms", nothing), table.get("busy_ms", nothing)
    ran = np.diff(active, prepend=np.nan) > 0
    ran &= np.diff(busy, prepend=np.nan) >= 0
    listened = np.where(ran, steps(active), 0.0)
    share = np.where(ran, steps(busy) / np.maximum(listened, 1e-9), np.nan)
    said = table.get("utilization", nothing)
    only_said = ~ran & np.isfinite(said)
    usual = float(np.median(np.diff(t))) * 1e3 if len(t) > 1 else 1e3
    share = np.where(only_said, said, share)
    listened = np.where(only_said, usual, listened)
    return np.clip(share, 0.0, 1.0), listened


def channel_number(frequency_mhz: int) -> int | None:
    """IEEE 802.11-2020, 17.3.8.4.2 and annex E; `None` outside the bands at 2.4, 5 and 6 GHz."""
    if frequency_mhz == 2484:
        return 14
    for low, high, base in ((2412, 2472, 2407), (5160, 5885, 5000), (5955, 7115, 5950)):
        if low <= frequency_mhz <= high:
            return (frequency_mhz - base) // 5
    return None


def _channel(role: str, iface: str, mhz: int, table: Columns) -> ChannelFigures:
    import numpy as np

    share, listened = busy_shares(table)
    known = np.isfinite(share) & (listened > 0)
    total = float(listened[known].sum())
    noise = table["noise_dbm"] if "noise_dbm" in table else np.full(len(share), np.nan)
    why = None
    if total <= 0:
        why = "busy_percent, busy_p95_percent, listened_s: needs counters that ran on between two samples; none did"
    return ChannelFigures(
        end=role,
        iface=iface,
        frequency_mhz=mhz,
        channel=channel_number(mhz),
        in_use=bool((table["in_use"] == 1).any()) if "in_use" in table else False,
        samples=len(share),
        listened_s=total / 1e3 if total > 0 else None,
        busy_percent=100.0 * float((share[known] * listened[known]).sum()) / total if total > 0 else None,
        busy_p95_percent=_percent(quantile(share[known], 0.95)),
        receiving_percent=_part(table, "rx_ms"),
        sending_percent=_part(table, "tx_ms"),
        noise_dbm=quantile(noise, 0.5),
        noise_max_dbm=quantile(noise, 1.0),
        reason=why,
    )


def _part(table: Columns, name: str) -> float | None:
    """Share of one of the radio's own counters over the intervals in which it and the clock of listening ran on."""
    import numpy as np

    if name not in table or "active_ms" not in table:
        return None
    active, own = np.diff(table["active_ms"], prepend=np.nan), np.diff(table[name], prepend=np.nan)
    ran = (active > 0) & (own >= 0)
    total = float(active[ran].sum())
    return 100.0 * float(own[ran].sum()) / total if total > 0 else None


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share

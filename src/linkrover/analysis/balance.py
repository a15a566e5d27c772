"""Which end receives more than it sends, and why: seen on the roscore's side, but not made by the roscore."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from urllib.parse import urlparse

import msgspec

from .addresses import own_addresses
from .link import ThroughputFigures
from .run import End, Run
from .topics import TopicFigures


class BalanceFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Sent and received of one end's primary interface, and what the topics on the air account for, Mbit/s."""

    iface: str
    sent_mbps: float
    received_mbps: float
    received_to_sent: float | None = None
    topics_out_mbps: float | None = None  # published here for the other machine
    topics_in_mbps: float | None = None  # subscribed to here
    runs_roscore: bool | None = None
    reason: str | None = None


def balance_figures(
    run: Run, throughputs: Mapping[str, ThroughputFigures], topics: Sequence[TopicFigures]
) -> dict[str, BalanceFigures]:
    """By end. throughputs: of each end's primary interface; an end without is left out."""
    return {
        role: _balance(run, role, throughput, topics)
        for role, throughput in throughputs.items()
        if throughput.tx_mean is not None and throughput.rx_mean is not None
    }


def _balance(run: Run, role: str, throughput: ThroughputFigures, topics: Sequence[TopicFigures]) -> BalanceFigures:
    end = run.ends[role]
    sent, received = throughput.tx_mean or 0.0, throughput.rx_mean or 0.0
    mine = [t for t in topics if t.end == role and t.on_host is not True and t.rate_mbps is not None]
    sums = {way: sum(t.rate_mbps or 0.0 for t in mine if t.direction == way) for way in ("out", "in")}
    recorded = any(t.end == role for t in topics)
    roscore = _runs_roscore(run, end)
    why = []
    if not recorded:
        why.append("topics_out_mbps, topics_in_mbps: no topic statistics were recorded at this end")
    if roscore is None:
        why.append("runs_roscore: no ROS 1 master is named in the recordings")
    return BalanceFigures(
        iface=end.primary or "",
        sent_mbps=sent,
        received_mbps=received,
        received_to_sent=received / sent if sent > 0 else None,
        topics_out_mbps=sums["out"] if recorded else None,
        topics_in_mbps=sums["in"] if recorded else None,
        runs_roscore=roscore,
        reason="; ".join(why) or None,
    )


def _runs_roscore(run: Run, end: End) -> bool | None:
    """Whether the master's address, as the manifests name it, is this end's."""
    for each in run.ends.values():
        words = each.manifest.middleware if each.manifest is not None else None
        uri = next((w for w in (words or "").split() if w.startswith("http://")), None)
        place = urlparse(uri).hostname if uri else None
        if place is None:
            continue
        if place in ("localhost", "127.0.0.1", "::1"):
            return each is end
        if end.manifest is None:
            return None
        return place in own_addresses(end) or place == end.manifest.host.lower()
    return None

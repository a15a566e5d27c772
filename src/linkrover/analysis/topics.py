"""Which topic fills the air: bytes and messages of each topic by connection, joined with the kernel's TCP figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from .addresses import interface_of, stays_inside
from .connections import ConnectionFigures
from .group import last_word, rise
from .run import End, Run

if TYPE_CHECKING:
    from .run import Columns


class TopicFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One topic between one node and one peer, by the node's own statistics, between its first and last sample.

    share_percent: of all bits the interface carried in that direction meanwhile (the interface counts headers,
    acknowledgements and repeats too, so that shares need not add up to 100). retransmits and rtt_* are of its TCP
    connection as the sending end's kernel counts them; a connection carries one topic.
    """

    end: str
    topic: str
    direction: str  # "out": this end's node published it; "in": it was received
    node: str
    peer: str
    transport: str | None = None
    local: str | None = None
    remote: str | None = None
    on_host: bool | None = None  # between two nodes of this machine: nothing of it is on the air
    seen_s: float
    mb: float | None = None
    rate_mbps: float | None = None
    messages_per_s: float | None = None
    message_kb: float | None = None
    share_percent: float | None = None
    retransmits: float | None = None
    retransmitted_percent: float | None = None
    rtt_median_ms: float | None = None
    rtt_p95_ms: float | None = None
    reason: str | None = None


def topic_figures(run: Run, connections: Sequence[ConnectionFigures]) -> list[TopicFigures]:
    """All topics of both ends, those on the air first, the busiest first."""
    by_place = {(c.local, c.remote): c for c in connections}
    found = [
        _topic(end, key, table, by_place) for end in run.ends.values() for key, table in sorted(end.traffic.items())
    ]
    return sorted(found, key=lambda t: (t.on_host is True, -(t.rate_mbps or 0.0), t.end, t.topic))


def _topic(
    end: End,
    key: tuple[str, str, str, str],
    table: Columns,
    connections: dict[tuple[str, str], ConnectionFigures],
) -> TopicFigures:
    topic, direction, peer, node = key
    local, remote = last_word(table.get("local")), last_word(table.get("remote"))
    seconds = float(table["t_s"][-1] - table["t_s"][0])
    octets, messages = (rise(table.get(name)) for name in ("bytes_total", "messages_total"))
    rate = octets * 8e-6 / seconds if octets is not None and seconds > 0 else None
    inside = stays_inside(end, local, remote)
    here, there = (local or "", remote or ""), (remote or "", local or "")
    tcp = connections.get(here if direction == "out" else there)
    why = []
    if octets is None:
        why.append("mb, rate_mbps: the node gave no statistics of it")
    elif rate is None:
        why.append("rate_mbps: one sample only")
    if tcp is None:
        why.append(
            "retransmits, retransmitted_percent, rtt_median_ms, rtt_p95_ms: the sending end's connection was not "
            "recorded under these addresses"
        )
    if inside:
        why.append("share_percent: not on the air")
    return TopicFigures(
        end=end.role,
        topic=topic,
        direction=direction,
        node=node,
        peer=peer,
        transport=last_word(table.get("transport")),
        local=local,
        remote=remote,
        on_host=inside,
        seen_s=seconds,
        mb=octets / 1e6 if octets is not None else None,
        rate_mbps=rate,
        messages_per_s=messages / seconds if messages is not None and seconds > 0 else None,
        message_kb=octets / messages / 1e3 if octets is not None and messages else None,
        share_percent=None if inside else _share(end, table, direction, local, octets),
        retransmits=tcp.retransmits if tcp else None,
        retransmitted_percent=tcp.retransmitted_percent if tcp else None,
        rtt_median_ms=tcp.rtt_median_ms if tcp else None,
        rtt_p95_ms=tcp.rtt_p95_ms if tcp else None,
        reason="; ".join(why) or None,
    )


def _share(end: End, table: Columns, direction: str, local: str | None, octets: float | None) -> float | None:
    """Of what the interface carried that way while the topic was watched."""
    import numpy as np

    iface = interface_of(end, local)
    moved = end.utilization.get(iface) if iface is not None else None
    if moved is None or octets is None:
        return None
    begin, stop = float(table["t_s"][0]), float(table["t_s"][-1])
    length = np.maximum(moved["t_s"] - moved["begin_s"], 1e-9)
    inside = np.clip(np.minimum(moved["t_s"], stop) - np.maximum(moved["begin_s"], begin), 0.0, None) / length
    total = float((moved["tx_bits" if direction == "out" else "rx_bits"] * inside).sum())
    return 100.0 * octets * 8 / total if total > 0 else None

"""Each TCP connection apart: which one retransmits, which one waits, and for what."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from .addresses import stays_inside
from .group import by_names, last_word, quantile, rise, usual_word
from .run import End, Run

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns, Floats


class ConnectionFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One connection as the kernel of this end counts it (struct tcp_info), over the time it was seen.

    sent_mb counts retransmitted bytes too; retransmits are segments, retransmitted_percent is bytes sent again of
    bytes sent. rtt_*: the kernel's smoothed round trip while data was sent: it holds the wait of delayed
    acknowledgements, and of the queue before the radio. limited_*: share of the time in which there was something to
    send.
    """

    end: str
    iface: str
    local: str
    remote: str
    process: str | None = None
    on_host: bool | None = None  # both ends on this machine: nothing of it is on the air
    seen_s: float
    sent_mb: float | None = None
    received_mb: float | None = None
    retransmits: float | None = None
    retransmitted_percent: float | None = None
    rtt_median_ms: float | None = None
    rtt_p95_ms: float | None = None
    rtt_min_ms: float | None = None
    congestion_window_median: float | None = None  # segments, while data was sent
    congestion_control: str | None = None
    delivery_rate_max_mbps: float | None = None
    busy_s: float | None = None  # had something to send
    receiver_limited_percent: float | None = None  # the peer's window was full
    buffer_limited_percent: float | None = None  # the program's send buffer was too small
    reason: str | None = None


_NOTHING_SENT = (
    "rtt_median_ms, rtt_p95_ms, rtt_min_ms, congestion_window_median, delivery_rate_max_mbps: it sent nothing while it "
    "was seen"
)


def connection_figures(run: Run) -> list[ConnectionFigures]:
    """All connections of both ends, those that retransmit most first, then by bytes."""
    found = [one for role, end in run.ends.items() for one in _of_end(role, end)]
    return sorted(found, key=lambda c: (-(c.retransmits or 0.0), -(c.sent_mb or 0.0) - (c.received_mb or 0.0)))


def _of_end(role: str, end: End) -> list[ConnectionFigures]:
    found: dict[tuple[str, str], ConnectionFigures] = {}
    for iface, every in end.connections.items():
        first = _first_look(end, every)
        for (local, remote), table in by_names(every, "local", "remote").items():
            one = _connection(role, end, iface, local, remote, table, first)
            if (local, remote) not in found:  # a wildcard view of two interfaces may show one connection twice
                found[local, remote] = one
    return list(found.values())


def _first_look(end: End, every: Columns) -> float:
    """Until when a connection that was there from the start must have been seen: a look that finds none leaves no
    record, so the end's other samples say when looking began.
    """
    import numpy as np

    looks = np.unique(every["t_s"])
    period = float(np.median(np.diff(looks))) if len(looks) > 1 else 1.0
    began = [float(table["t_s"][0]) for table in (*end.utilization.values(), *end.errors.values())]
    return min([float(looks[0]), *(start + 0.9 * period for start in began)])


def _connection(
    role: str, end: End, iface: str, local: str, remote: str, table: Columns, first_s: float
) -> ConnectionFigures:
    import numpy as np

    t = table["t_s"]
    nothing = np.full(len(t), np.nan)
    inside = stays_inside(end, local, remote)
    # not there at the first look: it began while it was watched, so its counters began at zero
    born = bool(t[0] > first_s)

    def risen(name: str) -> float | None:
        return rise(table.get(name), from_zero=born)

    sent, acked = risen("bytes_sent"), risen("bytes_acked")
    sent = acked if sent is None else sent
    again, busy = risen("bytes_retransmitted"), risen("busy_us")
    moving = _sending(table, nothing)
    rtt = np.where(moving, table.get("rtt_us", nothing), np.nan) / 1e3
    smallest = table.get("min_rtt_us", nothing)
    rate = table.get("delivery_rate_bps", nothing)
    return ConnectionFigures(
        end=role,
        iface=iface,
        local=local,
        remote=remote,
        process=last_word(table.get("process")),
        on_host=inside,
        seen_s=float(t[-1] - t[0]),
        sent_mb=_mega(sent),
        received_mb=_mega(risen("bytes_received")),
        retransmits=risen("retransmits"),
        retransmitted_percent=100.0 * again / sent if sent and again is not None else None,
        rtt_median_ms=quantile(rtt, 0.5),
        rtt_p95_ms=quantile(rtt, 0.95),
        rtt_min_ms=_milli(quantile(np.where(moving, smallest, np.nan), 0.0)),
        congestion_window_median=quantile(np.where(moving, table.get("congestion_window", nothing), np.nan), 0.5),
        congestion_control=usual_word(table.get("congestion_control")),
        delivery_rate_max_mbps=_mega(quantile(np.where(moving, rate, np.nan), 1.0)),
        busy_s=_mega(busy),
        receiver_limited_percent=_share(risen("receive_window_limited_us"), busy),
        buffer_limited_percent=_share(risen("send_buffer_limited_us"), busy),
        reason=None if moving.any() else _NOTHING_SENT,
    )


def _sending(table: Columns, nothing: Floats) -> NDArray[np.bool_]:
    """Samples before which bytes were sent or acknowledged; the first one if any had been by then."""
    import numpy as np

    moving = np.zeros(len(nothing), bool)
    for name in ("bytes_sent", "bytes_acked"):
        counter = table.get(name, nothing)
        moving |= np.nan_to_num(np.diff(counter, prepend=0.0)) > 0
    return moving


def _share(part_us: float | None, busy_us: float | None) -> float | None:
    return 100.0 * part_us / busy_us if part_us is not None and busy_us else None


def _mega(value: float | None) -> float | None:
    return None if value is None else value / 1e6


def _milli(value: float | None) -> float | None:
    return None if value is None else value / 1e3

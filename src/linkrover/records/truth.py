"""What the emulator knows to be so."""

from __future__ import annotations

from .base import Record, Role


class LinkTruth(Record, frozen=True, kw_only=True):
    """True state of one directed hop of the emulated radio over the interval that ends at wall_ns.

    Counters are cumulative. `hop` is "sender>receiver" in node names.
    """

    hop: str
    interval_ns: int
    distance_m: float
    walls: int = 0
    rssi_dbm: float | None = None
    snr_db: float | None = None
    mcs: int | None = None
    associated: bool = True
    offered_packets: int = 0
    offered_bytes: int = 0
    delivered_packets: int = 0
    delivered_bytes: int = 0
    dropped_queue: int = 0
    dropped_retries: int = 0
    dropped_unassociated: int = 0
    retries: int = 0
    airtime_ns: int = 0
    queue_packets: int = 0
    queue_bytes: int = 0
    delay_median_ns: int | None = None
    delay_max_ns: int | None = None
    release_error_median_ns: int | None = None  # how late the relay released packets against the model
    release_error_max_ns: int | None = None
    behind: bool = False  # the relay could not keep up during this interval


class ProbeTruth(Record, frozen=True, kw_only=True):
    """What the emulated link did to one STAMP packet: the true one-way delay of the hop, or its drop."""

    session: int
    sequence: int
    direction: str  # "forward" (robot to station) or "back"
    end: Role
    delay_ns: int | None = None
    dropped: str | None = None  # cause, None = delivered

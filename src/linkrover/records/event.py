"""Things that happen to a link, as a timeline."""

from __future__ import annotations

import enum

from .base import Record


class EventKind(enum.Enum):
    """What happened."""

    ASSOCIATED = "associated"
    DISCONNECTED = "disconnected"
    ROAMED = "roamed"
    CQM_LOW = "cqm rssi low"
    CQM_HIGH = "cqm rssi high"
    BEACON_LOSS = "beacon loss"
    CHANNEL_SWITCH = "channel switch"
    REGULATORY = "regulatory change"
    PEER_JOINED = "peer joined"
    PEER_LEFT = "peer left"
    INTERFACE_GONE = "interface gone"
    INTERFACE_BACK = "interface back"
    INTERFACE_RENAMED = "interface renamed"
    OUTAGE_BEGAN = "outage began"
    OUTAGE_ENDED = "outage ended"
    SCAN = "scan"
    RECORDING = "recording"  # disk full, recovered, ...
    CLOCK_STEP = "clock step"


class LinkEvent(Record, frozen=True, kw_only=True):
    """One event. `detail` is a sentence for a reader; the other fields are for a program."""

    iface: str
    kind: EventKind
    detail: str = ""
    peer: str | None = None
    bssid: str | None = None
    previous_bssid: str | None = None
    reason_code: int | None = None  # IEEE 802.11 reason code
    locally_generated: bool | None = None
    frequency_mhz: int | None = None
    rssi_dbm: float | None = None
    gap_ns: int | None = None  # how long the link was away, where the event ends such a time

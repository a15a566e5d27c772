"""What the probes found."""

from __future__ import annotations

import enum

from .base import Record


class ProbeState(enum.Enum):
    """What became of a probe. Loss has a direction because the reflector counts what reached it."""

    ANSWERED = "answered"
    LOST = "lost"  # no answer by the deadline, direction not known
    LOST_FORWARD = "lost forward"  # never reached the reflector
    LOST_BACK = "lost back"  # reached the reflector; its answer did not come
    LATE = "late"  # answered after the deadline
    NOT_SENT = "not sent"  # the local stack refused it


class ClockSource(enum.Enum):
    """Which clock a timestamp came from."""

    KERNEL = "kernel"
    USER = "user"


class ProbeResult(Record, frozen=True, kw_only=True):
    """One STAMP probe (RFC 8762). Recorded when its fate is known; wall_ns and mono_ns are the time of sending.

    A later record of the same peer, session and sequence supersedes this one (late answer, duplicate, direction of a
    loss known once the peer is back): count each (peer, session, sequence) once, by its last record.

    t1..t4 are CLOCK_REALTIME nanoseconds: sent and received here (t1, t4), received and sent by the reflector
    (t2, t3, its clock). rtt_ns = (t4 - t1) - (t3 - t2).
    """

    peer: str
    session: int
    sequence: int
    state: ProbeState
    reflector_sequence: int | None = None
    rtt_ns: int | None = None
    t1_ns: int | None = None
    t2_ns: int | None = None
    t3_ns: int | None = None
    t4_ns: int | None = None
    send_clock: ClockSource = ClockSource.USER
    receive_clock: ClockSource = ClockSource.USER
    lateness_ns: int = 0  # how long after its slot the probe was sent
    duplicates: int = 0
    reordered: bool = False
    packet_bytes: int = 44


class ClockOffset(Record, frozen=True, kw_only=True):
    """Peer clock minus local clock at wall_ns, with the bound the four timestamps allow.

    offset_ns(t) = offset_ns + drift_ppb * 1e-9 * (t - wall_ns); the true offset lies within error_bound_ns.
    """

    peer: str
    offset_ns: int
    error_bound_ns: int
    drift_ppb: float | None = None
    samples: int = 0
    window_ns: int = 0


class NetworkDelay(Record, frozen=True, kw_only=True):
    """One application-level round trip; wall_ns and mono_ns are the time of sending. delay_ns None = no answer."""

    iface: str
    peer: str
    method: str  # "stamp", "ros1 action", "ros1 topic", ...
    sequence: int = 0
    delay_ns: int | None = None
    alive: bool = False
    late: bool = False  # an answer did come, after the deadline
    deadline_ns: int = 2_000_000_000
    lateness_ns: int = 0
    middleware_ns: int | None = None  # delay_ns minus the nearest STAMP rtt_ns over the same path

"""What a series of probe results says: round trip, loss by direction, delay variation, order, punctuality."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import msgspec

from linkrover.records import ClockOffset, ProbeResult, ProbeState

from .clock import fit_offset


class Distribution(msgspec.Struct, frozen=True, kw_only=True):
    """Of a figure in nanoseconds. std: of the sample (n - 1). Percentiles by linear interpolation."""

    count: int
    min_ns: float
    mean_ns: float
    median_ns: float
    p95_ns: float
    p99_ns: float
    max_ns: float
    std_ns: float | None


class Direction(msgspec.Struct, frozen=True, kw_only=True):
    """One way. `sent` and `lost` count packets of this direction.

    delay: one-way delay (RFC 7679); true to within delay_bound_ns, None where the clock offset is not known.
    pdv: delay minus the smallest delay of the series (RFC 5481, 4.2), which needs no offset.
    ipdv: |delay minus that of the probe sent before it| (RFC 3393, RFC 5481, 4.1), consecutive probes only.
    jitter_ns: RFC 3550, 6.4.1, at the end of the series, in order of arrival.
    """

    sent: int | None
    lost: int | None
    loss: float | None
    delay: Distribution | None
    delay_bound_ns: int | None
    pdv: Distribution | None
    ipdv: Distribution | None
    jitter_ns: float | None


class ProbeSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Of one series. loss: share of all probes due that had no answer by their deadline, whatever the reason.

    lost counts probes never answered, late those answered after the deadline, not_sent those the local stack refused
    (no route, full queue); loss = (lost + late + not_sent) / (sent + not_sent). reordered: answers that came after one
    to a later probe (RFC 4737). clocks: how many send and receive times are the kernel's and the user clock's.
    """

    peer: str
    began_wall_ns: int | None
    duration_ns: int
    sent: int
    answered: int
    late: int
    lost: int
    lost_forward: int
    lost_back: int
    lost_unknown: int
    not_sent: int
    loss: float | None
    duplicates: int
    reordered: int
    rtt: Distribution | None
    forward: Direction
    back: Direction
    offset: ClockOffset | None
    lateness: Distribution | None
    send_clocks: dict[str, int]
    receive_clocks: dict[str, int]


def settled(results: Iterable[ProbeResult]) -> list[ProbeResult]:
    """Each probe once, by its last record, in order of sending."""
    last = {(r.peer, r.session, r.sequence): r for r in results}
    return sorted(last.values(), key=lambda r: (r.mono_ns, r.sequence))


def distribution(values: Iterable[float]) -> Distribution | None:
    """Of any number of values; None of none."""
    ordered = sorted(values)
    if not ordered:
        return None
    n = len(ordered)
    mean = math.fsum(ordered) / n
    std = math.sqrt(math.fsum((v - mean) ** 2 for v in ordered) / (n - 1)) if n > 1 else None
    return Distribution(
        count=n,
        min_ns=ordered[0],
        mean_ns=mean,
        median_ns=quantile(ordered, 0.5),
        p95_ns=quantile(ordered, 0.95),
        p99_ns=quantile(ordered, 0.99),
        max_ns=ordered[-1],
        std_ns=std,
    )


def quantile(ordered: Sequence[float], q: float) -> float:
    """Of sorted values, linear between neighbours (type 7)."""
    at = q * (len(ordered) - 1)
    below = int(at)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (at - below)


def jitter_ns(delays: Iterable[float]) -> float | None:
    """RFC 3550 interarrival jitter of one-way delays (any constant offset) in order of arrival; None of none."""
    jitter = 0.0
    previous: float | None = None
    for delay in delays:
        if previous is not None:
            jitter += (abs(delay - previous) - jitter) / 16
        previous = delay
    return None if previous is None else jitter


def summarise(results: Iterable[ProbeResult], *, offset: ClockOffset | None = None) -> ProbeSummary:
    """Figures of a series to one peer. Without an offset, the series' own timestamps give one (clock.fit_offset)."""
    probes = settled(results)
    sent = [p for p in probes if p.state is not ProbeState.NOT_SENT]
    came = [p for p in sent if p.rtt_ns is not None]
    in_time = [p for p in came if p.state is ProbeState.ANSWERED]
    lost = len(sent) - len(came)
    forward, back = _lost_by_direction(sent)
    offset = offset or fit_offset(came)
    known = lost == forward + back
    return ProbeSummary(
        peer=probes[0].peer if probes else "",
        began_wall_ns=probes[0].wall_ns if probes else None,
        duration_ns=probes[-1].mono_ns - probes[0].mono_ns if probes else 0,
        sent=len(sent),
        answered=len(in_time),
        late=len(came) - len(in_time),
        lost=lost,
        lost_forward=forward,
        lost_back=back,
        lost_unknown=lost - forward - back,
        not_sent=len(probes) - len(sent),
        loss=(len(probes) - len(in_time)) / len(probes) if probes else None,
        duplicates=sum(p.duplicates for p in came),
        reordered=sum(p.reordered for p in came),
        rtt=distribution(p.rtt_ns for p in came if p.rtt_ns is not None),
        forward=_way(came, offset, forward=True, sent=len(sent), lost=forward if known else None),
        back=_way(came, offset, forward=False, sent=len(sent) - forward if known else None, lost=back),
        offset=offset,
        lateness=distribution(p.lateness_ns for p in probes),
        send_clocks=dict(Counter(p.send_clock.value for p in came)),
        receive_clocks=dict(Counter(p.receive_clock.value for p in came)),
    )


def _way(
    came: list[ProbeResult], offset: ClockOffset | None, *, forward: bool, sent: int | None, lost: int | None
) -> Direction:
    raw: dict[tuple[int, int], float] = {}
    true: list[float] = []
    arrivals: list[tuple[int, float]] = []
    for p in came:
        if p.t1_ns is None or p.t2_ns is None or p.t3_ns is None or p.t4_ns is None:
            continue
        delay = p.t2_ns - p.t1_ns if forward else p.t4_ns - p.t3_ns
        raw[(p.session, p.sequence)] = delay
        arrivals.append((p.t2_ns if forward else p.t4_ns, delay))
        if offset is not None:
            peer_ahead = offset.offset_ns + (offset.drift_ppb or 0.0) * 1e-9 * (p.t1_ns - offset.wall_ns)
            true.append(delay - peer_ahead if forward else delay + peer_ahead)
    least = min(raw.values(), default=0.0)
    steps = [abs(d - raw[(s, n - 1)]) for (s, n), d in raw.items() if (s, n - 1) in raw]
    return Direction(
        sent=sent,
        lost=lost if sent is not None else None,
        loss=lost / sent if sent and lost is not None else None,
        delay=distribution(true),
        delay_bound_ns=offset.error_bound_ns if offset is not None and true else None,
        pdv=distribution(d - least for d in raw.values()),
        ipdv=distribution(steps),
        jitter_ns=jitter_ns(d for _, d in sorted(arrivals)),
    )


def _lost_by_direction(sent: list[ProbeResult]) -> tuple[int, int]:
    """Losses forward and back. Where both ways lost within one gap, the reflector's numbers say how many each."""
    forward = sum(p.state is ProbeState.LOST_FORWARD for p in sent)
    back = sum(p.state is ProbeState.LOST_BACK for p in sent)
    answered = [p for p in sent if p.reflector_sequence is not None]
    if not answered or all(p.reflector_sequence == p.sequence for p in answered):
        return forward, back  # a stateless reflector: its numbers are ours
    seen = {(p.session, p.reflector_sequence) for p in answered}
    lower: ProbeResult | None = None
    gap = 0
    for p in sent:
        if p.state is ProbeState.LOST:
            gap += 1
        if p.reflector_sequence is None:
            continue
        if gap and lower is not None and lower.reflector_sequence is not None and lower.session == p.session:
            between = range(lower.reflector_sequence + 1, p.reflector_sequence)
            missing = sum((p.session, n) not in seen for n in between)
            if p.reflector_sequence > lower.reflector_sequence and missing <= gap:
                back += missing
                forward += gap - missing
        lower, gap = p, 0
    return forward, back

"""Round trips, their loss and variation, and the outages they show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from .directions import UNANSWERED
from .stats import autocorrelation_time, mean_ci95, quantile_ci95
from .window import Window

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns, End, Run

    Floats = NDArray[np.float64]

OUTAGE_THRESHOLD_S = 1.0
PROBE_DEADLINE_S = 2.0


class OneWay(msgspec.Struct, frozen=True, kw_only=True):
    """One direction's delay. Only as good as the clock offset: every value may be off by `error_bound_ms`."""

    median: float | None = None
    p95: float | None = None
    error_bound_ms: float | None = None
    reason: str | None = None


class DelayFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Round-trip delay in ms and loss in percent. Mean to p99 are of answered probes only; see docs/analysis.md."""

    source: str | None = None
    answered: int = 0
    lost: int = 0
    mean: float | None = None
    std: float | None = None
    min: float | None = None
    median: float | None = None
    p95: float | None = None
    p99: float | None = None
    max: float | None = None
    mean_ci95: tuple[float, float] | None = None
    median_ci95: tuple[float, float] | None = None
    p95_ci95: tuple[float, float] | None = None
    p99_ci95: tuple[float, float] | None = None
    ess: float | None = None
    autocorrelation_probes: float | None = None
    loss_percent: float | None = None
    loss_ci95: tuple[float, float] | None = None
    loss_forward_percent: float | None = None
    loss_back_percent: float | None = None
    time_out_percent: float | None = None
    censored_mean: float | None = None
    deadline_ms: float | None = None
    jitter: float | None = None
    ipdv_p95: float | None = None
    pdv_p95: float | None = None
    pdv_p99: float | None = None
    duplicates: int | None = None
    reordered: int | None = None
    forward: OneWay | None = None
    back: OneWay | None = None
    reason: str | None = None


class Outage(msgspec.Struct, frozen=True, kw_only=True):
    """A stretch without an answered probe longer than the threshold, and where the robot was when it began."""

    start_s: float
    end_s: float
    duration_s: float
    ended: bool  # False = still out when the recording ended
    x_m: float | None = None
    y_m: float | None = None
    distance_m: float | None = None
    rssi_dbm: float | None = None
    reason: str | None = None


@dataclass(slots=True)
class Probes:
    """Delay samples of one method in the order of sending. `known_s`: when the fate of each was known."""

    source: str
    sent_s: Floats
    delay_ms: Floats  # NaN = lost
    deadline_ms: Floats
    known_s: Floats
    serial: bool  # each ping waited for the last one (2021)
    state: NDArray[np.object_] | None = None
    table: Columns | None = None

    def begins(self) -> Floats:
        """From when on a sample speaks for the link: pings in a row when known, scheduled probes when sent."""
        return self.known_s if self.serial else self.sent_s

    def slice(self, window: Window) -> Probes:
        """The probes whose time of speaking lies in the window."""
        kept = window.contains(self.begins())
        return Probes(
            self.source,
            self.sent_s[kept],
            self.delay_ms[kept],
            self.deadline_ms[kept],
            self.known_s[kept],
            self.serial,
            self.state[kept] if self.state is not None else None,
            {name: column[kept] for name, column in self.table.items()} if self.table is not None else None,
        )


def find_probes(run: Run, *, application: bool = False) -> Probes | None:
    """The run's delay samples: STAMP probes where there are any, else the application's round trips.

    `application=True` prefers the application's (the paper's way of measuring).
    """
    orders = ("delays", "probe") if application else ("probe", "delays")
    for what in orders:
        for end in (run.robot, run.station):
            if end is None:
                continue
            if what == "probe" and end.probe is not None and (found := _stamp(end)) is not None:
                return found
            if what == "delays" and end.delays:
                method = max(end.delays, key=lambda m: len(end.delays[m]["t_s"]))
                return application_probes(end, method, run.published_2021)
    return None


def _stamp(end: End) -> Probes | None:
    import numpy as np

    table = end.probe
    assert table is not None
    state = table["state"]  # whatever is not "answered" had no answer in time: lost, late, or refused by the stack
    answered = state == "answered"
    delay = np.where(answered, table["rtt_ns"] / 1e6, np.nan)
    deadline = np.full(len(delay), PROBE_DEADLINE_S * 1e3)
    known = table["t_s"] + np.where(answered, np.nan_to_num(delay), deadline) / 1e3
    return Probes("stamp", table["t_s"], delay, deadline, known, serial=False, state=state, table=table)


def application_probes(end: End, method: str, serial: bool = False) -> Probes:
    """Application-level round trips of one method."""
    import numpy as np

    table = end.delays[method]
    deadline = np.nan_to_num(table["deadline_ns"], nan=2e9) / 1e6
    delay = table["delay_ns"] / 1e6
    if not serial:
        delay = np.where(delay > deadline, np.nan, delay)
    known = table["t_s"] + np.where(np.isnan(delay), deadline, delay) / 1e3
    if serial:
        order = np.argsort(known, kind="stable")
        return Probes(method, table["t_s"][order], delay[order], deadline[order], known[order], serial)
    return Probes(method, table["t_s"], delay, deadline, known, serial)


def hold_weights(probes: Probes, window: Window) -> Floats:
    """Seconds of the window each sample stands for: until the next one, at most a deadline where none follows."""
    import numpy as np

    begins = probes.begins()
    if not len(begins):
        return np.zeros(0)
    last = float(window.ends[-1]) if len(window.ends) else float(begins[-1])
    ends = np.append(begins[1:], max(last, begins[-1]))
    if not probes.serial and len(begins) > 1:
        usual = float(np.median(np.diff(begins)))
        ends = np.minimum(ends, begins + max(5 * usual, 1.0))  # a hole in the recording is not a measurement
    return window.measure(begins, ends)


def delay_figures(probes: Probes | None, window: Window, run: Run, *, details: bool = True) -> DelayFigures:
    """All figures of one set of probes over a window. Time-weighted figures follow `Probes.begins`."""
    import numpy as np

    if probes is None:
        return DelayFigures(reason="delay: neither probe nor application delay was recorded")
    weights = hold_weights(probes, window)
    part = probes.slice(window)
    answered = part.delay_ms[np.isfinite(part.delay_ms)]
    sent, lost = len(part.delay_ms), int(np.isnan(part.delay_ms).sum())
    reasons: list[str] = []
    if sent == 0:
        return DelayFigures(source=probes.source, reason="delay: no probe was sent in this part of the run")
    total = float(weights.sum())
    out = np.isnan(probes.delay_ms)
    censored = np.where(out, probes.deadline_ms, probes.delay_ms)
    loss_interval, loss_ess, _ = mean_ci95(np.isnan(part.delay_ms).astype(np.float64) * 100)
    common = {
        "source": probes.source,
        "answered": len(answered),
        "lost": lost,
        "loss_percent": 100.0 * lost / sent,
        "loss_ci95": loss_interval if lost else _rule_of_three(loss_ess),
        "time_out_percent": 100.0 * float(weights[out].sum()) / total if total > 0 else None,
        "censored_mean": float((weights * censored).sum() / total) if total > 0 else None,
        "deadline_ms": float(np.median(part.deadline_ms)),
    }
    if not len(answered):
        return DelayFigures(**common, reason="mean to max: no probe was answered")  # type: ignore[arg-type]
    ordered = np.sort(answered)
    interval, ess, tau = mean_ci95(answered)
    if interval is None:
        reasons.append("mean_ci95: fewer than 8 answered probes")
    p50, p95, p99 = (float(v) for v in np.quantile(ordered, (0.5, 0.95, 0.99)))
    extra: dict[str, object] = {}
    if details:
        extra = _variation(part)
        if part.state is not None:
            extra |= _directions(part, run, reasons)
    return DelayFigures(
        **common,  # type: ignore[arg-type]
        mean=float(answered.mean()),
        std=float(answered.std(ddof=1)) if len(answered) > 1 else None,
        min=float(ordered[0]),
        median=p50,
        p95=p95,
        p99=p99,
        max=float(ordered[-1]),
        mean_ci95=interval,
        median_ci95=quantile_ci95(answered, 0.5),
        p95_ci95=quantile_ci95(answered, 0.95),
        p99_ci95=quantile_ci95(answered, 0.99),
        ess=ess,
        autocorrelation_probes=tau,
        **extra,  # type: ignore[arg-type]
        reason="; ".join(reasons) or None,
    )


def _rule_of_three(ess: float) -> tuple[float, float] | None:
    """No loss among n independent probes: at most 3/n with 95 % confidence."""
    return (0.0, min(100.0, 300.0 / ess)) if ess >= 1 else None


def _variation(part: Probes) -> dict[str, object]:
    """Jitter (RFC 3550 6.4.1 on round trips), IPDV (RFC 3393) and PDV (RFC 5481) of answered probes."""
    import numpy as np

    delay = part.delay_ms
    answered = delay[np.isfinite(delay)]
    pairs = np.diff(delay)
    pairs = np.abs(pairs[np.isfinite(pairs)])  # IPDV is defined between successive packets that both arrived
    if not len(pairs):
        return {}
    pdv = answered - answered.min()
    return {
        "jitter": smoothed_jitter(pairs),
        "ipdv_p95": float(np.quantile(pairs, 0.95)),
        "pdv_p95": float(np.quantile(pdv, 0.95)),
        "pdv_p99": float(np.quantile(pdv, 0.99)),
    }


def smoothed_jitter(differences: Floats) -> float:
    """J += (|D| - J) / 16, RFC 3550 section 6.4.1: its mean over the run."""
    jitter, total = 0.0, 0.0
    for begin in range(0, len(differences), 65536):
        for d in differences[begin : begin + 65536].tolist():
            jitter += (d - jitter) / 16
            total += jitter
    return total / len(differences)


def _directions(part: Probes, run: Run, reasons: list[str]) -> dict[str, object]:
    """Loss per direction, duplicates, reordering, one-way delays with their bound."""
    import numpy as np

    assert part.state is not None
    assert part.table is not None
    sent = len(part.state)
    out: dict[str, object] = {
        "duplicates": int(np.nansum(part.table["duplicates"])),
        "reordered": int(np.nansum(part.table["reordered"])),
    }
    share = part.table["share_lost_back"][np.isin(part.state, UNANSWERED)]
    back, unknown = float(np.nansum(share)), int(np.isnan(share).sum())
    forward = len(share) - unknown - back
    out["loss_forward_percent"], out["loss_back_percent"] = 100.0 * forward / sent, 100.0 * back / sent
    if unknown:
        reasons.append(f"the direction of {unknown} losses is not known; they are in neither direction's share")
    if late := int((part.state == "late").sum()):
        reasons.append(f"{late} answers came after the deadline; they count as lost, in neither direction's share")
    robot_sends = run.robot is not None and run.robot.probe is not None
    offset = _offset(part, run.robot if robot_sends else run.station)
    if offset is None:
        reasons.append("forward, back: no clock offset was measured, so one-way delay is unknown")
        return out
    t1, t2, t3, t4 = (part.table[f"t{i}_ns"] for i in (1, 2, 3, 4))
    shift, bound = offset
    for name, delay in (("forward", (t2 - t1 - shift) / 1e6), ("back", (t4 - t3 + shift) / 1e6)):
        known = delay[np.isfinite(delay)]
        if len(known):
            median, p95 = np.quantile(known, (0.5, 0.95))
            out[name] = OneWay(median=float(median), p95=float(p95), error_bound_ms=bound / 1e6)
    return out


def _offset(part: Probes, end: End | None) -> tuple[Floats, float] | None:
    """Peer minus local clock at each probe, and the largest bound used."""
    import numpy as np

    if end is None or end.offset is None or part.table is None:
        return None
    table = end.offset
    if not np.isfinite(table["error_bound_ns"]).any():
        return None
    known = table["error_bound_ns"] <= 1.5 * np.nanmin(table["error_bound_ns"])  # wide bounds say little
    wall = table["wall_ns"][known].astype(np.float64)
    return np.interp(part.table["wall_ns"], wall, table["offset_ns"][known]), float(
        table["error_bound_ns"][known].max()
    )


def outage_window(probes: Probes | None, span: Window, threshold_s: float = OUTAGE_THRESHOLD_S) -> tuple[Window, bool]:
    """The outages of a run, and whether the last one was still on at its end.

    An outage begins with the first probe that got no answer and ends with the next one that did (by time of sending;
    for pings sent one after the other by the time each was known), and is longer than the threshold.
    """
    import numpy as np

    nothing = Window(np.zeros(0), np.zeros(0))
    if probes is None or not len(probes.delay_ms) or not len(span.ends):
        return nothing, False
    lost = np.isnan(probes.delay_ms)
    end = float(span.ends[-1])
    found = Window.from_flags(probes.begins(), lost, end)
    kept = found.ends - found.begins > threshold_s
    kept &= found.begins < end
    out = Window(found.begins[kept], np.minimum(found.ends[kept], end))
    return out, bool(len(out.ends) and lost[-1] and out.ends[-1] >= end)


__all__ = [
    "DelayFigures",
    "OneWay",
    "Outage",
    "Probes",
    "application_probes",
    "autocorrelation_time",
    "delay_figures",
    "find_probes",
    "hold_weights",
    "outage_window",
    "smoothed_jitter",
]

"""Measured against true: does what the agents recorded agree with what the emulated link really did?

Both sides are taken over the same stretches of time and the same probes. Limits are those the project holds itself
to: throughput within 1 %, loss within 0.5 points, median round trip within 0.5 ms, RSSI exactly as written.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

import msgspec

from linkrover.emulator.driver import level_dbm
from linkrover.records import (
    LinkTruth,
    LinkUtilization,
    ProbeResult,
    ProbeState,
    ProbeTruth,
    Record,
    WirelessLink,
)

THROUGHPUT_LIMIT = 0.01
LOSS_LIMIT_POINTS = 0.5
DELAY_LIMIT_MS = 0.5
RSSI_LIMIT = 0.0
QUIET_BPS = 250_000.0
"""A direction that carries less (acknowledgements, commands) is compared with 1 % of this: a packet or two more."""
WRITTEN_LATE_NS = 10_000_000
READ_LATE_NS = 50_000_000
"""A sample is stamped, then read; the driver's text is stamped, then written. On a busy machine either comes late by
this much, and the sample may show any level of that stretch; it must show one of them to the dBm."""
LOST = (ProbeState.LOST, ProbeState.LOST_FORWARD, ProbeState.LOST_BACK, ProbeState.LATE)


class Figure(msgspec.Struct, frozen=True):
    """One figure both ways. difference and limit are in `difference_unit`; agrees None = nothing to compare."""

    what: str
    unit: str
    measured: float | None
    true: float | None
    difference: float | None
    difference_unit: str
    limit: float
    samples: int
    note: str = ""

    @property
    def agrees(self) -> bool | None:
        """Whether the difference is within the limit."""
        return None if self.difference is None else abs(self.difference) <= self.limit


class Agreement(msgspec.Struct, frozen=True):
    """All figures of a run. behind: share of time in which the relay could not keep up with the model."""

    figures: tuple[Figure, ...]
    behind: float
    release_error_median_ms: float | None
    release_error_max_ms: float | None

    @property
    def agrees(self) -> bool:
        """Whether every figure that can be compared is within its limit, and there is one."""
        verdicts = [figure.agrees for figure in self.figures if figure.agrees is not None]
        return bool(verdicts) and all(verdicts)


class _Truth:
    """The truth of a run, ready to be asked."""

    def __init__(self, records: Iterable[Record]) -> None:
        self.hops: dict[str, list[LinkTruth]] = {}
        self.probes: dict[tuple[str, int, int, str], ProbeTruth] = {}
        for record in records:
            if isinstance(record, LinkTruth):
                self.hops.setdefault(record.hop, []).append(record)
            elif isinstance(record, ProbeTruth):
                self.probes[record.end.value, record.session, record.sequence, record.direction] = record
        for ticks in self.hops.values():
            ticks.sort(key=lambda tick: tick.wall_ns)

    def octets(self, end: str, direction: str, wall_ns: int) -> float | None:
        """Octets the end had sent or received by wall_ns, between ticks by straight line; None outside them."""
        total, found = 0.0, False
        for name, ticks in self.hops.items():
            sender, _, receiver = name.partition(">")
            if (sender if direction == "tx" else receiver) != end:
                continue
            index = bisect_right(ticks, wall_ns, key=lambda tick: tick.wall_ns)
            if not 0 < index < len(ticks):
                return None
            before, after = ticks[index - 1], ticks[index]
            share = (wall_ns - before.wall_ns) / max(1, after.wall_ns - before.wall_ns)
            low, high = (
                (before.offered_bytes, after.offered_bytes)
                if direction == "tx"
                else (before.delivered_bytes, after.delivered_bytes)
            )
            total += low + share * (high - low)
            found = True
        return total if found else None

    def levels(self, end: str, wall_ns: int) -> set[int | None]:
        """What the end's driver text may have shown at wall_ns: whole dBm, or None for not associated."""
        ticks = next((ticks for name, ticks in self.hops.items() if name.endswith(">" + end)), [])
        first = max(0, bisect_right(ticks, wall_ns - WRITTEN_LATE_NS, key=lambda tick: tick.wall_ns) - 1)
        last = bisect_right(ticks, wall_ns + READ_LATE_NS, key=lambda tick: tick.wall_ns)
        return {
            level_dbm(tick.rssi_dbm) if tick.associated and tick.rssi_dbm is not None else None
            for tick in ticks[first:last]
        }


def compare(
    ends: Mapping[str, Sequence[Record]], truth: Iterable[Record], deadline_ns: int = 2_000_000_000
) -> Agreement:
    """Compare the recordings of the ends ("robot", "station") with the emulator's truth."""
    known = _Truth(truth)
    figures: list[Figure] = []
    for end, records in ends.items():
        figures += [_throughput(end, direction, records, known) for direction in ("tx", "rx")]
    for end, records in ends.items():
        # a later record of the same probe supersedes the earlier
        last = {(r.peer, r.session, r.sequence): r for r in records if isinstance(r, ProbeResult)}
        probes = [probe for probe in last.values() if probe.state is not ProbeState.NOT_SENT]
        if probes:
            figures += _probes(end, probes, known, deadline_ns)
    figures += [_rssi(end, records, known) for end, records in ends.items()]
    ticks = [tick for hop in known.hops.values() for tick in hop]
    medians = [t.release_error_median_ns for t in ticks if t.release_error_median_ns is not None]
    worst = [t.release_error_max_ns for t in ticks if t.release_error_max_ns is not None]
    return Agreement(
        tuple(figures),
        sum(t.behind for t in ticks) / max(1, len(ticks)),
        median(medians) / 1e6 if medians else None,
        max(worst) / 1e6 if worst else None,
    )


def _throughput(end: str, direction: str, records: Sequence[Record], truth: _Truth) -> Figure:
    what = f"{end} {'sends' if direction == 'tx' else 'receives'}"
    field = f"{direction}_bytes"
    samples = sorted(
        (r for r in records if isinstance(r, LinkUtilization) and getattr(r, field) is not None),
        key=lambda r: r.wall_ns,
    )
    inside = [(r, octets) for r in samples if (octets := truth.octets(end, direction, r.wall_ns)) is not None]
    if len(inside) < 2:
        return Figure(what, "Mbit/s", None, None, None, "%", THROUGHPUT_LIMIT * 100, len(inside), "too few samples")
    (first, true_first), (last, true_last) = inside[0], inside[-1]
    seconds = (last.mono_ns - first.mono_ns) / 1e9
    measured = (getattr(last, field) - getattr(first, field)) * 8 / seconds
    true = (true_last - true_first) * 8 / seconds
    difference = (measured - true) / max(true, QUIET_BPS)
    return Figure(
        what, "Mbit/s", measured / 1e6, true / 1e6, difference * 100, "%", THROUGHPUT_LIMIT * 100, len(inside)
    )


def _probes(end: str, probes: Sequence[ProbeResult], truth: _Truth, deadline_ns: int) -> list[Figure]:
    there, back = ("forward", "back") if end == "robot" else ("back", "forward")
    whose = "" if end == "robot" else f" (from {end})"
    lost = lost_truly = unseen = known = 0
    rtts, true_rtts = [], []
    for probe in probes:
        out = truth.probes.get((end, probe.session, probe.sequence, there))
        home = truth.probes.get((end, probe.session, probe.sequence, back))
        if out is None:
            unseen += 1  # it never reached the link: no truth about it
            continue
        known += 1
        lost += probe.state in LOST
        travelled = None
        if out.delay_ns is not None and home is not None and home.delay_ns is not None:
            travelled = out.delay_ns + home.delay_ns
        lost_truly += travelled is None or travelled > deadline_ns
        if probe.rtt_ns is not None and probe.state is ProbeState.ANSWERED and travelled is not None:
            rtts.append(probe.rtt_ns)
            true_rtts.append(travelled)
    note = f"{unseen} probes never reached the link" if unseen else ""
    figures = []
    if known:
        share, true_share = 100 * lost / known, 100 * lost_truly / known
        figures.append(
            Figure(f"probes lost{whose}", "%", share, true_share, share - true_share, "points",
                   LOSS_LIMIT_POINTS, known, note)
        )  # fmt: skip
    if rtts:
        value, true_value = median(rtts) / 1e6, median(true_rtts) / 1e6
        figures.append(
            Figure(f"median round trip{whose}", "ms", value, true_value, value - true_value, "ms",
                   DELAY_LIMIT_MS, len(rtts))
        )  # fmt: skip
    return figures


def _rssi(end: str, records: Sequence[Record], truth: _Truth) -> Figure:
    what = f"RSSI at {end}"
    samples = [r for r in records if isinstance(r, WirelessLink)]
    shown = [(r, levels) for r in samples if (levels := truth.levels(end, r.wall_ns))]
    if not any(r.rssi_dbm is not None for r, _ in shown):
        return Figure(what, "dBm", None, None, None, "samples", RSSI_LIMIT, 0, "an access point shows none")
    wrong = sum((None if r.rssi_dbm is None else round(r.rssi_dbm)) not in levels for r, levels in shown)
    with_level = [(r.rssi_dbm, levels) for r, levels in shown if r.rssi_dbm is not None]
    mean = sum(value for value, _ in with_level) / len(with_level)
    true_mean = sum(
        value if round(value) in levels else next((x for x in levels if x is not None), value)
        for value, levels in with_level
    ) / len(with_level)
    return Figure(what, "mean dBm", mean, true_mean, float(wrong), "samples", RSSI_LIMIT, len(shown),
                  "samples that differ from the driver's text")  # fmt: skip

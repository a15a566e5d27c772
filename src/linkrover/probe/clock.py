"""The peer's clock minus ours, with a bound that holds (set membership over four-timestamp samples).

A packet cannot arrive before it was sent, whatever the queue: t2 - t1 is never below the offset and t3 - t4 never
above it. Each answered probe so confines the offset to an interval as wide as its round trip; between probes the
interval grows by what the clocks may drift. The tightest probes (smallest round trip) decide; slow ones add nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import msgspec

from linkrover.records import ClockOffset, ProbeResult

DRIFT_MOST = 500e-6
"""Assumed before a drift is estimated: Linux disciplines a clock by at most 500 ppm."""
WANDER = 1e-6
"""How much a drift estimate may change within the window (temperature)."""
BUCKET_NS = 4_000_000_000
WINDOW_NS = 120_000_000_000
DRIFT_SPAN_NS = 20_000_000_000
STRIKES = 3
_RESOLUTION_NS = 500


class _Sample(msgspec.Struct, frozen=True):
    mono_ns: int
    wall_ns: int
    low_ns: float
    high_ns: float

    @property
    def width_ns(self) -> float:
        return self.high_ns - self.low_ns


def _sample(result: ProbeResult) -> _Sample | None:
    if result.t1_ns is None or result.t2_ns is None or result.t3_ns is None or result.t4_ns is None:
        return None
    low, high = result.t3_ns - result.t4_ns, result.t2_ns - result.t1_ns
    if high < low:
        return None  # a negative round trip: one of the four was not what it says
    return _Sample(result.mono_ns, result.wall_ns, low - _RESOLUTION_NS, high + _RESOLUTION_NS)


class ClockTracker:
    """Follows the offset to one peer, a few microseconds of work per probe.

    A step of either clock shows as three samples in a row outside what drift allows; tracking then begins anew and
    `steps` counts it.
    """

    def __init__(self, peer: str = "") -> None:
        self.steps = 0
        self._peer = peer
        self._samples = 0
        self._strikes: list[_Sample] = []
        self._buckets: deque[_Sample] = deque()  # the tightest sample of each bucket
        self._last: _Sample | None = None
        self._first_ns = 0
        self._low = self._high = 0.0
        self._drift, self._drift_error = 0.0, DRIFT_MOST

    def add(self, result: ProbeResult) -> None:
        """Take an answered probe; others are passed over. Probes may come slightly out of order."""
        sample = _sample(result)
        if sample is None:
            return
        self._peer = self._peer or result.peer
        last = self._last
        if last is None:
            self._begin([sample])
            return
        age = sample.mono_ns - last.mono_ns
        if age < 0:
            return
        spread = self._drift_error * age
        low = max(self._low + self._drift * age - spread, sample.low_ns)
        high = min(self._high + self._drift * age + spread, sample.high_ns)
        if low > high:
            self._strikes.append(sample)
            if len(self._strikes) >= STRIKES:
                self.steps += 1
                self._begin(self._strikes)
            return
        self._strikes.clear()
        self._low, self._high, self._last = low, high, sample
        self._samples += 1
        self._file(sample)

    def offset(self) -> ClockOffset | None:
        """The offset as of the last sample; None before the first."""
        last = self._last
        if last is None:
            return None
        known = self._drift_error < DRIFT_MOST
        return ClockOffset(
            wall_ns=last.wall_ns,
            mono_ns=last.mono_ns,
            peer=self._peer,
            offset_ns=round((self._low + self._high) / 2),
            error_bound_ns=max(1, round((self._high - self._low) / 2 + 0.5)),
            drift_ppb=self._drift * 1e9 if known else None,
            samples=self._samples,
            window_ns=min(WINDOW_NS, last.mono_ns - self._first_ns),
        )

    def _begin(self, samples: list[_Sample]) -> None:
        tightest = min(samples, key=lambda s: s.width_ns)
        self._last = tightest
        self._low, self._high = tightest.low_ns, tightest.high_ns
        self._samples = 1
        self._first_ns = tightest.mono_ns
        self._drift, self._drift_error = 0.0, DRIFT_MOST
        self._buckets.clear()
        self._buckets.append(tightest)
        self._strikes = []

    def _file(self, sample: _Sample) -> None:
        newest = self._buckets[-1]
        if sample.mono_ns // BUCKET_NS == newest.mono_ns // BUCKET_NS:
            if sample.width_ns < newest.width_ns:
                self._buckets[-1] = sample
            return
        while self._buckets and sample.mono_ns - self._buckets[0].mono_ns > WINDOW_NS:
            self._buckets.popleft()
        if self._buckets and self._buckets[-1].mono_ns - self._buckets[0].mono_ns >= DRIFT_SPAN_NS:
            found = drift_range(self._buckets)
            if found is None:
                self._drift, self._drift_error = 0.0, DRIFT_MOST
            else:
                self._drift = (found[0] + found[1]) / 2
                self._drift_error = min(DRIFT_MOST, (found[1] - found[0]) / 2 + WANDER)
        self._buckets.append(sample)


def drift_range(samples: Iterable[_Sample]) -> tuple[float, float] | None:
    """The least and greatest constant drift (s/s) that every pair of samples allows; None if no one drift fits."""
    points = list(samples)
    least, greatest = -DRIFT_MOST, DRIFT_MOST
    for i, a in enumerate(points):
        for b in points[i + 1 :]:
            span = b.mono_ns - a.mono_ns
            if span <= 0:
                continue
            least = max(least, (b.low_ns - a.high_ns) / span)
            greatest = min(greatest, (b.high_ns - a.low_ns) / span)
    return (least, greatest) if least <= greatest else None


def fit_offset(results: Iterable[ProbeResult]) -> ClockOffset | None:
    """One offset and drift for a whole series, its bound good at every probe of it.

    Samples are filtered to the tightest of each of at most 60 stretches. None without an answered probe, or where no
    constant drift fits them all (a clock was stepped): use a ClockTracker then.
    """
    results = list(results)
    samples = sorted((s for s in map(_sample, results) if s is not None), key=lambda s: s.mono_ns)
    if not samples:
        return None
    first_ns, span = samples[0].mono_ns, samples[-1].mono_ns - samples[0].mono_ns
    tightest: dict[int, _Sample] = {}
    for sample in samples:
        stretch = (sample.mono_ns - first_ns) * 60 // (span + 1)
        if stretch not in tightest or sample.width_ns < tightest[stretch].width_ns:
            tightest[stretch] = sample
    found = drift_range(tightest.values())
    if found is None:
        return None
    known = span >= DRIFT_SPAN_NS
    drift = (found[0] + found[1]) / 2 if known else 0.0
    drift_error = max(found[1] - drift, drift - found[0]) + WANDER
    middle = min(samples, key=lambda s: abs(s.mono_ns - first_ns - span // 2))
    low, high = -float("inf"), float("inf")
    for sample in tightest.values():
        age = middle.mono_ns - sample.mono_ns
        low = max(low, sample.low_ns + drift * age - drift_error * abs(age))
        high = min(high, sample.high_ns + drift * age + drift_error * abs(age))
    if low > high:
        return None
    farthest = max(middle.mono_ns - first_ns, samples[-1].mono_ns - middle.mono_ns)
    return ClockOffset(
        wall_ns=middle.wall_ns,
        mono_ns=middle.mono_ns,
        peer=results[0].peer,
        offset_ns=round((low + high) / 2),
        error_bound_ns=max(1, round((high - low) / 2 + drift_error * farthest + 0.5)),
        drift_ppb=drift * 1e9 if known else None,
        samples=len(samples),
        window_ns=span,
    )

"""Rate control that learns from failures: after the idea of mac80211's minstrel.

Per scheme it keeps a moving average of the share of frames that came through, sends at the scheme with the highest
expected throughput, falls back along a chain when a frame has to be repeated, and now and then tries another scheme.
It never sees the SNR.
"""

from __future__ import annotations

import random
from collections.abc import Sequence


class RateController:
    """Picks an MCS for each transmission of one directed link.

    rates_bps: PHY rate by MCS. overhead_ns: fixed airtime of a transmission, so that a fast scheme is not overrated
    for short aggregates. update_ns: how often averages are renewed (minstrel: 50 ms). weight: share of the old
    average kept. sample_every: one transmission in so many tries another scheme.
    """

    def __init__(
        self,
        rates_bps: Sequence[float],
        rng: random.Random,
        *,
        overhead_ns: int = 200_000,
        update_ns: int = 50_000_000,
        weight: float = 0.75,
        sample_every: int = 12,
    ) -> None:
        self._rates = tuple(rates_bps)
        self._rng = rng
        self._overhead_ns = overhead_ns
        self._update_ns = update_ns
        self._weight = weight
        self._sample_every = sample_every
        count = len(self._rates)
        self._attempts = [0] * count
        self._successes = [0] * count
        self.probability: list[float | None] = [None] * count
        self._last_tried_ns = [0] * count
        self._due_ns = 0
        self._sent = 0
        self.sampling = False  # the transmission chosen last is a trial: it should be short
        self.best = min(count - 1, 3)
        self.second = max(0, self.best - 1)
        self.safest = 0
        self.last = self.best

    def choose(self, retries: int) -> int:
        """MCS for a transmission whose oldest frame has been repeated `retries` times."""
        self.sampling = False
        if retries == 0:
            self._sent += 1
            if self._sent % self._sample_every == 0:
                self.last = self._sample()
                self.sampling = True
                return self.last
        if retries <= 1:
            self.last = self.best
        elif retries <= 3:
            self.last = self.second
        elif retries <= 5:
            self.last = self.safest
        else:
            self.last = 0
        return self.last

    def _sample(self) -> int:
        """A neighbour that could be better: one below the best or up to two above, those never tried first."""
        top = len(self._rates) - 1
        near = [i for i in (self.best - 1, self.best + 1, self.best + 2) if 0 <= i <= top]
        if not near:
            return self.best
        untried = [index for index in near if self.probability[index] is None]
        return untried[0] if untried else self._rng.choice(near)

    def report(self, now_ns: int, mcs: int, attempts: int, successes: int) -> None:
        """What became of a transmission: frames sent, frames acknowledged."""
        self._attempts[mcs] += attempts
        self._successes[mcs] += successes
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + self._update_ns
            self._renew()

    def _renew(self) -> None:
        weight = self._weight
        for index, tried in enumerate(self._attempts):
            if not tried:
                continue
            now = self._successes[index] / tried
            old = self.probability[index]
            self.probability[index] = now if old is None else weight * old + (1.0 - weight) * now
            self._attempts[index] = self._successes[index] = 0
        expected = [self._expected(index) for index in range(len(self._rates))]
        order = sorted(range(len(expected)), key=expected.__getitem__, reverse=True)
        self.best = order[0]
        self.second = order[1] if len(order) > 1 else order[0]
        if self.probability[self.second] is None:
            self.second = max(0, self.best - 1)
        known = [index for index, p in enumerate(self.probability) if p is not None and p >= 0.95]
        if known:
            self.safest = max(known)
        else:
            self.safest = max(
                (index for index, p in enumerate(self.probability) if p is not None),
                key=lambda index: self.probability[index] or 0.0,
                default=0,
            )
        self.safest = min(self.safest, self.best)
        if self.second > self.best and (self.probability[self.second] or 0.0) < (self.probability[self.best] or 0.0):
            self.second = max(0, self.best - 1)

    def _expected(self, index: int) -> float:
        """Frames of 1,500 octets a nanosecond; minstrel counts a scheme below 10 % as nothing."""
        p = self.probability[index]
        if p is None or p < 0.1:
            # an untried slow scheme must stay in reach when all tried ones fail
            return 1e-12 / (index + 1)
        return min(p, 0.9) / (self._overhead_ns / 16 + 12_000e9 / self._rates[index])

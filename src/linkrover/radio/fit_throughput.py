"""Eq. 4's parameters from throughput against RSSI: the product alpha_T * B, the noise, the cap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from .estimate import Estimate, FitError

if TYPE_CHECKING:
    from collections.abc import Callable

    from .values import Array

NOISE_LOW_DBM, NOISE_HIGH_DBM = -120.0, -40.0


class ThroughputFit(msgspec.Struct, frozen=True, kw_only=True):
    """T = min(cap, alpha_b log2(1 + SNR)). alpha_b_hz: only the product alpha_T * B can be told from such data."""

    alpha_b_hz: Estimate
    noise_dbm: Estimate
    cap_bps: Estimate
    residual_bps: float
    samples: int
    worth: float


def model_bps(rssi_dbm: Array, alpha_b: float, noise_dbm: float, cap: float) -> Array:
    """The curve."""
    out: Array = np.minimum(cap, alpha_b * np.log2(1.0 + 10.0 ** ((rssi_dbm - noise_dbm) / 10.0)))
    return out


def fit_throughput(rssi_dbm: Array, throughput_bps: Array) -> ThroughputFit:
    """Least squares of the capped Shannon share, for saturated traffic (a link that is not full shows its source).

    Samples in order of time. Intervals: profile of the sum of squares with the F limit, widened by the
    autocorrelation of the residuals (first order). The cap counts as found only if the curve with it is better than
    without it by an F test at 5 %; the noise only if its interval is bounded: on a straight stretch of the curve
    (all samples at high SNR) it trades against alpha_b.

    Raises:
        FitError: fewer than 15 samples, or RSSI that varies by less than 3 dB.
    """
    from scipy.stats import f as f_distribution

    rssi = np.asarray(rssi_dbm, float)
    rate = np.asarray(throughput_bps, float)
    good = np.isfinite(rssi) & np.isfinite(rate)
    rssi, rate = rssi[good], rate[good]
    if rssi.size < 15:
        raise FitError(f"only {rssi.size} samples of RSSI with throughput: at least 15 are needed")
    if np.ptp(rssi) < 3.0:
        raise FitError("RSSI varies by less than 3 dB: throughput against it cannot be told")
    scale = float(np.abs(rate).max()) or 1.0
    fit = _Fit(rssi, rate / scale)
    _, rss_free = fit.best(capped=False)
    _, rss_capped = fit.best(capped=True)
    n = rssi.size
    gain = (rss_free - rss_capped) / (rss_capped / (n - 3))
    has_cap = gain > float(f_distribution.ppf(0.95, 1, n - 3))
    best, rss = fit.best(capped=has_cap)
    count = 3 if has_cap else 2
    residual = rate / scale - fit.curve(best)
    worth = n * _worth(residual)
    limit = rss * (1.0 + float(f_distribution.ppf(0.95, 1, max(worth - count, 4))) / max(worth - count, 4))
    alpha_low, alpha_high = fit.bounds(best, limit, 0, has_cap)
    noise_low, noise_high = fit.bounds(best, limit, 1, has_cap)
    noise_known = noise_low is not None and noise_high is not None
    if has_cap:
        cap_low, cap_high = fit.bounds(best, limit, 2, True)
        cap = Estimate(value=best[2] * scale, low=_times(cap_low, scale), high=_times(cap_high, scale), unit="bit/s")
    else:
        reached = float(fit.curve(best).max()) * scale
        cap = Estimate(
            value=None,
            low=reached,
            high=None,
            unit="bit/s",
            identifiable=False,
            note="no cap shows in these data: it lies above the highest throughput, or the link was never that good",
        )
    return ThroughputFit(
        alpha_b_hz=Estimate(
            value=math.exp(best[0]) * scale,
            low=None if alpha_low is None else math.exp(alpha_low) * scale,
            high=None if alpha_high is None else math.exp(alpha_high) * scale,
            unit="Hz",
            identifiable=alpha_low is not None and alpha_high is not None,
            note="the product alpha_T * B; its factors cannot be told apart",
        ),
        noise_dbm=Estimate(
            value=best[1],
            low=noise_low,
            high=noise_high,
            unit="dBm",
            identifiable=noise_known,
            note="" if noise_known else "trades against alpha_T * B here: only both together fit",
        ),
        cap_bps=cap,
        residual_bps=math.sqrt(rss / max(1, n - count)) * scale,
        samples=n,
        worth=float(worth),
    )


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _worth(residual: Array) -> float:
    """Share of independent samples, for residuals of first-order autocorrelation."""
    centred = residual - residual.mean()
    power = float((centred**2).sum())
    rho = 0.0 if power == 0 else float((centred[1:] * centred[:-1]).sum()) / power
    noise = 2.0 / math.sqrt(len(residual))
    if rho < noise:
        return 1.0  # not told from none
    return (1.0 - rho) / (1.0 + rho)


class _Fit:
    """Least squares in (ln alpha_b, noise, cap), throughput scaled to 1."""

    def __init__(self, rssi: Array, rate: Array) -> None:
        self.rssi, self.rate = rssi, rate
        order = np.argsort(rssi, kind="stable")
        self._rssi, self._rate = rssi[order], rate[order]
        n = len(rssi)
        self._k = np.arange(2, n)  # samples under the cap; the rest lie on it
        squares = np.cumsum(self._rate**2)
        self._total = float(squares[-1])
        self._below = squares[self._k - 1]
        self._tail = self._total - self._below
        self._above = np.cumsum(self._rate[::-1])[::-1][self._k]
        self._on_cap = n - self._k
        self.noise = -90.0

    def _shape(self, noise: float) -> Array:
        out: Array = np.log2(1.0 + 10.0 ** ((self._rssi - noise) / 10.0))
        return out

    def curve(self, p: tuple[float, float, float]) -> Array:
        return model_bps(self.rssi, math.exp(p[0]), p[1], p[2])

    def rss(self, p: tuple[float, float, float]) -> float:
        out = self.rate - self.curve(p)
        return float(out @ out)

    def _given(self, noise: float, capped: bool) -> tuple[tuple[float, float, float], float]:
        """Best alpha_b and cap at a noise: for each number of samples under the cap both are closed form."""
        return self._split(self._shape(noise), noise, capped, None)

    def _split(
        self, g: Array, noise: float, capped: bool, alpha: float | None
    ) -> tuple[tuple[float, float, float], float]:
        sgt, sgg = np.cumsum(g * self._rate), np.cumsum(g * g)
        if not capped:
            a = max(sgt[-1] / sgg[-1], 1e-9) if alpha is None else alpha
            return (math.log(a), noise, math.inf), float(self._total - 2 * a * sgt[-1] + a * a * sgg[-1])
        k = self._k
        st, sg = sgt[k - 1], sgg[k - 1]
        a_k = np.maximum(st / sg, 1e-9) if alpha is None else np.full(len(k), alpha)
        # the split must agree with the curve: the cap lies between the last sample below and the first above
        c_k = np.clip(self._above / self._on_cap, a_k * g[k - 1], a_k * g[k])
        rss = self._sum(a_k, c_k, st, sg)
        i = int(np.argmin(rss))
        return (math.log(a_k[i]), noise, float(c_k[i])), float(rss[i])

    def _sum(self, alpha: Array, cap: Any, st: Array, sg: Array) -> Array:
        below = self._below - 2 * alpha * st + alpha**2 * sg
        out: Array = below + self._tail - 2 * cap * self._above + self._on_cap * cap**2
        return out

    def _minimise(self, f: Callable[[float], float], low: float, high: float, grid: int = 41) -> tuple[float, float]:
        from scipy.optimize import minimize_scalar

        xs = np.linspace(low, high, grid)
        values = [f(float(x)) for x in xs]
        i = int(np.argmin(values))
        found: Any = minimize_scalar(
            f, bounds=(xs[max(0, i - 1)], xs[min(grid - 1, i + 1)]), method="bounded", options={"xatol": 1e-4}
        )
        return (float(found.x), float(found.fun)) if found.fun < values[i] else (float(xs[i]), values[i])

    def best(self, capped: bool) -> tuple[tuple[float, float, float], float]:
        self.noise, _ = self._minimise(lambda x: self._given(x, capped)[1], NOISE_LOW_DBM, NOISE_HIGH_DBM)
        return self._given(self.noise, capped)

    def profile(self, which: int, value: float, capped: bool) -> float:
        """Least sum of squares with one parameter held."""
        if which == 1:
            return self._given(value, capped)[1]

        def at(noise: float) -> float:
            g = self._shape(noise)
            return self._split(g, noise, capped, math.exp(value))[1] if which == 0 else self._held_cap(g, value)

        low, high = max(NOISE_LOW_DBM, self.noise - 25.0), min(NOISE_HIGH_DBM, self.noise + 25.0)
        return self._minimise(at, low, high, 13)[1]

    def _held_cap(self, g: Array, cap: float) -> float:
        """Best alpha_b at a held cap: for each split the closed form, held to the split."""
        k = self._k
        st, sg = np.cumsum(g * self._rate)[k - 1], np.cumsum(g * g)[k - 1]
        a_k = np.clip(st / sg, cap / g[k], cap / g[k - 1])
        return float(self._sum(a_k, cap, st, sg).min())

    def bounds(
        self, best: tuple[float, float, float], limit: float, which: int, capped: bool
    ) -> tuple[float | None, float | None]:
        """Where the profile crosses the limit below and above; None = it does not."""
        from scipy.optimize import brentq

        centre = best[which]
        ends: list[float | None] = []
        for sign in (-1, 1):
            step = {0: 0.02, 1: 0.25, 2: 0.01 * best[2] if which == 2 else 0.0}[which]
            inner, outer = centre, centre + sign * step
            found: float | None = None
            for _ in range(30):
                if which == 1 and not NOISE_LOW_DBM < outer < NOISE_HIGH_DBM:
                    break
                if which == 2 and outer <= 0:
                    break
                if self.profile(which, outer, capped) > limit:
                    found = float(brentq(lambda v: self.profile(which, v, capped) - limit, inner, outer, xtol=1e-3))
                    break
                inner, step = outer, step * 1.6
                outer = inner + sign * step
            ends.append(found)
        return ends[0], ends[1]

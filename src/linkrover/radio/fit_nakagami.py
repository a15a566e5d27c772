"""Nakagami m from received power."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from linkrover.errors import ConfigError

from .estimate import Estimate, FitError

if TYPE_CHECKING:
    from .values import Array

M_LOW, M_HIGH = 0.5, 200.0


def fit_nakagami(power: Array, *, independent: float | None = None) -> Estimate:
    """Most likely m of Nakagami-m fading, that is the shape of a gamma distribution of the power.

    power: received power in any linear unit (mW) at a constant mean; along a drive use fit_nakagami_along.
    independent: how many independent samples these are worth, None = all of them. The interval is the profile
    likelihood's with the F limit, and wider where samples are correlated by that much.

    Raises:
        FitError: fewer than 20 independent samples, or no variation.
        ConfigError: a power that is not above 0.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, gammaln

    power = np.asarray(power, float)
    if not (power > 0).all():
        raise ConfigError("power: must be above 0 everywhere")
    count = float(power.size) if independent is None else min(float(independent), float(power.size))
    if count < 20:
        raise FitError(f"worth {count:.0f} independent samples: at least 20 are needed")
    spread = math.log(power.mean()) - float(np.log(power).mean())  # = ln m - digamma(m) at the maximum
    if spread < 1e-6:
        raise FitError("the power does not vary: there is no fading to fit")

    def slope(m: float) -> float:
        return float(math.log(m) - digamma(m) - spread)

    if slope(M_LOW) < 0:
        best = M_LOW
    elif slope(M_HIGH) > 0:
        best = M_HIGH
    else:
        best = float(brentq(slope, M_LOW, M_HIGH))

    def log_likelihood(m: float) -> float:
        # with the mean profiled out, for each sample
        return float(m * math.log(m) - gammaln(m) - m * (1.0 + spread))

    top = log_likelihood(best)
    limit = 3.841 / 2 / count * (1 + 1.5 / count)

    def drop(m: float) -> float:
        return top - log_likelihood(m) - limit

    low = float(brentq(drop, 1e-3, best)) if drop(1e-3) > 0 else None
    high = float(brentq(drop, best, 1e4)) if drop(1e4) > 0 else None
    return Estimate(
        value=best,
        low=low,
        high=high,
        unit="1",
        identifiable=high is not None and high < M_HIGH,
        note="" if high is not None and high < M_HIGH else "fading too weak to bound m above",
    )


LAG_LOW_M, LAG_HIGH_M = 0.1, 0.6
BLOCKS = 12
ROUNDING_DB2 = 1.0 / 12.0  # drivers give whole dBm
DB_PER_NEPER = 10.0 / math.log(10.0)


def fit_nakagami_along(rssi_dbm: Array, along_m: Array) -> Estimate:
    """M from RSSI along a drive, with the shadowing kept out of it.

    Half the mean squared difference of two readings grows with the way between them: multipath is there after half a
    wavelength, shadowing comes in proportion to the way. The straight line over 0.1 to 0.6 m, drawn back to zero, is
    the variance of multipath alone, (10 / ln 10)^2 trigamma(m), and the driver's rounding. Interval: jackknife over
    12 stretches of the drive. Readings while standing still are left out.

    Raises:
        FitError: less than 10 m driven, or readings too far apart.
    """
    from scipy.stats import t as student

    rssi, along = np.asarray(rssi_dbm, float), np.asarray(along_m, float)
    moving = np.concatenate([[True], np.diff(along) > 1e-3])
    rssi, along = rssi[moving], along[moving]
    if not along.size or along[-1] - along[0] < 10.0:
        raise FitError("less than 10 m driven with readings: too little for multipath")
    ways, squares, blocks = [], [], []
    edges = np.linspace(along[0], along[-1], BLOCKS + 1)
    for step in range(1, along.size):
        way = along[step:] - along[:-step]
        if float(way.min()) > LAG_HIGH_M:
            break
        use = (way >= LAG_LOW_M) & (way <= LAG_HIGH_M)
        ways.append(way[use])
        squares.append(0.5 * (rssi[step:] - rssi[:-step])[use] ** 2)
        blocks.append(np.clip(np.searchsorted(edges, along[:-step][use], side="right") - 1, 0, BLOCKS - 1))
    way, square, block = np.concatenate(ways), np.concatenate(squares), np.concatenate(blocks)
    if way.size < 200 or np.unique(block).size < BLOCKS // 2:
        raise FitError("readings are too far apart for multipath: sample at 10 Hz or more, or drive slower")
    sums = np.array(
        [np.bincount(block, weights, BLOCKS) for weights in (np.ones_like(way), way, way**2, square, way * square)]
    )
    full = _multipath_variance(sums.sum(axis=1))
    if full is None:
        raise FitError("no multipath shows: readings vary less than their rounding")
    parts = [_multipath_variance(sums.sum(axis=1) - sums[:, index]) for index in range(BLOCKS)]
    if any(part is None for part in parts):
        raise FitError("multipath is too weak against the rounding to bound m")
    logs = np.log(np.array(parts, float))
    error = math.sqrt((BLOCKS - 1) / BLOCKS * float(((logs - logs.mean()) ** 2).sum()))
    width = float(student.ppf(0.975, BLOCKS - 1)) * error
    centre = math.log(full)
    low, middle, high = (_m_of_variance(math.exp(centre + sign * width)) for sign in (1, 0, -1))
    weak = high >= M_HIGH
    return Estimate(
        value=middle,
        low=low,
        high=None if weak else high,
        unit="1",
        identifiable=not weak,
        note="fading too weak to bound m above" if weak else "",
    )


def _multipath_variance(sums: Array) -> float | None:
    count, x, xx, y, xy = (float(each) for each in sums)
    slope = (count * xy - x * y) / (count * xx - x * x)
    variance = (y - slope * x) / count - ROUNDING_DB2
    return variance if variance > 0 else None


def _m_of_variance(variance_db2: float) -> float:
    """The m whose power in dB has this variance."""
    from scipy.optimize import brentq
    from scipy.special import polygamma

    target = variance_db2 / DB_PER_NEPER**2
    if float(polygamma(1, 0.1)) < target:
        return 0.1
    if float(polygamma(1, M_HIGH)) > target:
        return M_HIGH
    return float(brentq(lambda m: float(polygamma(1, m)) - target, 0.1, M_HIGH))

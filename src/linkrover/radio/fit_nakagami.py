"""Nakagami m from received power."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from linkrover.errors import ConfigError

from .estimate import Estimate, FitError
from .values import require_positive

if TYPE_CHECKING:
    from .values import Array

M_LOW, M_HIGH = 0.5, 200.0


def fit_nakagami(power: Array, *, independent: float | None = None) -> Estimate:
    """Most likely m of Nakagami-m fading, that is the shape of a gamma distribution of the power.

    power: received power in any linear unit (mW), with its local mean taken out (see local_ratio) or constant.
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


def local_ratio(rssi_dbm: Array, along_m: Array, window_m: float = 1.5) -> tuple[Array, float]:
    """(power over its local mean, how many independent samples it is worth), from RSSI along a drive.

    The local mean is taken over window_m (some ten wavelengths) of driven way, which leaves the shadowing in it.
    Samples taken standing still are left out: they repeat one place. The worth counts one sample each half wavelength
    at 2.4 GHz (6 cm), and one less in each window, whose mean is fitted.

    Raises:
        ConfigError: window_m is not above 0.
        FitError: no window holds five samples.
    """
    require_positive("fit", window_m=window_m)
    power = 10.0 ** (np.asarray(rssi_dbm, float) / 10.0)
    along = np.asarray(along_m, float)
    moving = np.concatenate([[True], np.diff(along) > 1e-3])
    power, along = power[moving], along[moving]
    cell = np.floor(along / window_m).astype(int)
    ratios: list[Array] = []
    worth = 0.0
    for each in np.unique(cell):
        part = power[cell == each]
        if part.size < 5:
            continue
        ratios.append(part / part.mean())
        worth += max(0.0, min(part.size, window_m / 0.06) - 1)
    if not ratios:
        raise FitError(f"no stretch of {window_m} m holds five samples: sample faster or drive slower")
    return np.concatenate(ratios), worth

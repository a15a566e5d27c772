"""Path-loss exponent, RSS at 1 m, shadowing sigma and decorrelation distance from RSSI along a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np

from .estimate import Estimate, FitError, SpatialGrid, nugget_weight, thin
from .values import require_positive

if TYPE_CHECKING:
    from .values import Array

DRAWS = 8000


class PathLossFit(msgspec.Struct, frozen=True, kw_only=True):
    """Eq. 2 fitted. residual_sigma_db: what the points scatter about the line in all."""

    rss_1m_dbm: Estimate
    exponent: Estimate
    sigma_db: Estimate
    decorrelation_m: Estimate
    residual_sigma_db: float
    places: int
    samples: int
    distance_low_m: float
    distance_high_m: float


def fit_path_loss(
    positions_m: Array,
    access_point_m: tuple[float, float],
    rssi_dbm: Array,
    *,
    spacing_m: float = 0.5,
    seed: int = 0,
) -> PathLossFit:
    """Fit P = rss_1m - 10 n log10(d) + shadowing, with shadowing correlated as sigma^2 exp(-d / D).

    Correlated shadowing makes neighbouring samples tell the same story, so that ordinary least squares overstates
    its certainty several times. Here the covariance is part of the model: the restricted likelihood on a grid of D
    and nugget. Intervals of the line and of sigma are equal-tailed after integrating over that grid (so they hold
    the doubt about the covariance), with weights D^-1/2 and D^-1; the interval of D is its profile likelihood's. Their
    coverage is measured by `benchmarks fit_coverage`. The line is that of the mean in dB: multipath lowers it against
    the mean power by 10 log10(e) (ln m - digamma(m)) dB. positions_m: (n, 2), one row a sample. spacing_m: samples
    are averaged over it.

    Raises:
        FitError: too few places, or no change of distance.
        ConfigError: spacing_m is not above 0.
    """
    require_positive("fit", spacing_m=spacing_m)
    places, rssi, _ = thin(np.asarray(positions_m, float), np.asarray(rssi_dbm, float), spacing_m)
    distance = np.maximum(np.hypot(places[:, 0] - access_point_m[0], places[:, 1] - access_point_m[1]), 0.1)
    log_distance = 10.0 * np.log10(distance)
    if np.ptp(log_distance) < 2.0:
        raise FitError("the distance to the access point hardly changed: the exponent cannot be told")
    grid = SpatialGrid(places)
    # the pivot in the middle of the data keeps the two coefficients nearly independent
    pivot = float(log_distance.mean())
    regression = grid.regress(rssi, np.column_stack([np.ones_like(rssi), pivot - log_distance]))
    of_nugget = nugget_weight(grid.nugget)[None, :]
    scale = grid.decorrelation_m[:, None]
    rng = np.random.default_rng(seed)
    _, _, beta = regression.draw(scale**-0.5 * of_nugget, DRAWS, rng)
    cells, variance, _ = regression.draw(scale**-1.0 * of_nugget, DRAWS, rng)
    shadow = np.sqrt(variance * (1.0 - grid.nugget[cells[:, 1]]))
    rss_1m = beta[:, 0] + beta[:, 1] * pivot
    return PathLossFit(
        rss_1m_dbm=interval(rss_1m, "dBm"),
        exponent=interval(beta[:, 1], "1"),
        sigma_db=interval(shadow, "dB"),
        decorrelation_m=_profile_interval(grid.decorrelation_m, regression.log_likelihood.max(axis=1)),
        residual_sigma_db=float(np.std(rssi - np.median(rss_1m) + np.median(beta[:, 1]) * log_distance)),
        places=len(rssi),
        samples=len(rssi_dbm),
        distance_low_m=float(distance.min()),
        distance_high_m=float(distance.max()),
    )


def _profile_interval(scale: Array, profile: Array) -> Estimate:
    """Where twice the log likelihood is within 3.84 (chi-squared, one degree) of its greatest."""
    from scipy.interpolate import PchipInterpolator

    x = np.log(scale)
    fine = np.linspace(x[0], x[-1], 600)
    smooth = PchipInterpolator(x, profile)(fine)
    inside = fine[smooth > smooth.max() - 3.841 / 2]
    best = float(np.exp(fine[int(np.argmax(smooth))]))
    below, above = bool(inside[0] <= fine[0]), bool(inside[-1] >= fine[-1])
    notes = ["not bounded below: places are too far apart"] * below
    notes += ["not bounded above: the drive is too short against it"] * above
    return Estimate(
        value=best,
        low=0.0 if below else float(np.exp(inside[0])),
        high=None if above else float(np.exp(inside[-1])),
        unit="m",
        identifiable=not (below or above),
        note="; ".join(notes),
    )


def interval(draws: Array, unit: str, *, identifiable: bool = True, note: str = "") -> Estimate:
    """Median and equal-tailed 95 % interval of draws."""
    low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975])
    return Estimate(
        value=float(middle), low=float(low), high=float(high), unit=unit, identifiable=identifiable, note=note
    )

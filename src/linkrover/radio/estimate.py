"""An estimate with its interval, and the spatial regression that path-loss and position fits share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from linkrover.errors import LinkRoverError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .values import Array


class FitError(LinkRoverError):
    """Data from which the parameters cannot be told; says what is missing."""


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """A figure with its 95 % interval. identifiable False: the data do not bound it; `note` says why."""

    value: float | None
    low: float | None
    high: float | None
    unit: str
    identifiable: bool = True
    note: str = ""


def correlation_distances(positions_m: Array) -> Array:
    """Distances between all pairs of places, (n, 2) -> (n, n)."""
    difference = positions_m[:, None, :] - positions_m[None, :, :]
    out: Array = np.sqrt((difference**2).sum(axis=2))
    return out


def thin(positions_m: Array, values: Array, spacing_m: float) -> tuple[Array, Array, Array]:
    """Means over stretches of `spacing_m` along the drive: places (k, 2), values (k,), samples in each (k,).

    What is nearer than the decorrelation distance tells nothing new of the shadowing, and its mean is less disturbed
    by multipath. Standing still gives one point.
    """
    step = np.hypot(*np.diff(positions_m, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    cell = np.floor(along / spacing_m).astype(int)
    _, index, count = np.unique(cell, return_inverse=True, return_counts=True)
    k = count.size

    def mean(column: Array) -> Array:
        out: Array = np.bincount(index, column, k) / count
        return out

    return np.column_stack([mean(positions_m[:, 0]), mean(positions_m[:, 1])]), mean(values), count.astype(float)


def nugget_weight(nugget: Array) -> Array:
    """Weight of each nugget of a grid: the width of its cell in 0..1."""
    edges = np.concatenate([[0.0], (nugget[1:] + nugget[:-1]) / 2, [1.0]])
    out: Array = np.diff(edges)
    return out


class SpatialGrid:
    """Covariance of residuals: total variance x ((1 - nugget) exp(-d / D) + nugget), on a grid of D and nugget.

    The nugget is what differs from point to point: multipath left after averaging, and the driver's rounding to
    whole dB. One eigen-decomposition for each D serves all nuggets. Refuses (FitError) fewer than 12 places.
    """

    def __init__(self, positions_m: Array, decorrelation_m: Array | None = None, nugget: Array | None = None) -> None:
        count = len(positions_m)
        if count < 12:
            raise FitError(f"only {count} places along the drive: at least 12 are needed; drive farther")
        distances = correlation_distances(positions_m)
        extent = float(distances.max())
        if extent <= 0:
            raise FitError("the robot did not move: path loss and shadowing need a drive")
        near = float(np.median(np.sort(distances + np.eye(count) * 1e9, axis=1)[:, 0]))
        if decorrelation_m is None:
            decorrelation_m = np.geomspace(max(near / 3, extent / 400), extent, 24)
        self.decorrelation_m = decorrelation_m
        self.nugget = np.array([0.0, 0.03, 0.08, 0.16, 0.3, 0.5, 0.75]) if nugget is None else nugget
        self.bases: list[tuple[Array, Array]] = []
        for scale in self.decorrelation_m:
            values, vectors = np.linalg.eigh(np.exp(-distances / scale))
            self.bases.append((np.maximum(values, 1e-10), vectors))

    def regress(self, y: Array, x: Array) -> Regression:
        """Generalised least squares of y on the columns of x for every cell of the grid."""
        cells = [
            (i, j, np.maximum((1.0 - nu) * values + nu, 1e-10), vectors)
            for i, (values, vectors) in enumerate(self.bases)
            for j, nu in enumerate(self.nugget)
        ]
        shape = (len(self.decorrelation_m), len(self.nugget))
        n, p = x.shape
        out = Regression(n - p, shape, p)
        rotated: list[tuple[Array, Array]] = [(v.T @ y, v.T @ x) for _, v in self.bases]
        for i, j, eigenvalues, _ in cells:
            yr, xr = rotated[i]
            weighted = xr / eigenvalues[:, None]
            information = xr.T @ weighted
            inverse = np.linalg.inv(information)
            beta = inverse @ (weighted.T @ yr)
            residual = yr - xr @ beta
            rss = float((residual**2 / eigenvalues).sum())
            out.beta[i, j] = beta
            out.inverse[i, j] = inverse
            out.rss[i, j] = rss
            sign, logdet = np.linalg.slogdet(information)
            out.log_likelihood[i, j] = -0.5 * (
                np.log(eigenvalues).sum() + (logdet if sign > 0 else 1e9) + (n - p) * math.log(max(rss, 1e-300))
            )
        return out


class Regression:
    """Restricted likelihood and coefficients on the grid."""

    def __init__(self, freedom: int, shape: tuple[int, int], columns: int) -> None:
        self.freedom = freedom
        self.beta = np.empty((*shape, columns))
        self.inverse = np.empty((*shape, columns, columns))
        self.rss = np.empty(shape)
        self.log_likelihood = np.empty(shape)

    def best(self) -> tuple[int, int]:
        """Cell of the greatest restricted likelihood."""
        i, j = np.unravel_index(int(np.argmax(self.log_likelihood)), self.log_likelihood.shape)
        return int(i), int(j)

    def draw(self, prior: Array, count: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], Array, Array]:
        """Draws of (cell index pairs (count, 2), total variance, coefficients (count, p)) from the posterior."""
        weight = np.exp(self.log_likelihood - self.log_likelihood.max()) * prior
        flat = rng.choice(weight.size, size=count, p=(weight / weight.sum()).ravel())
        cells = np.column_stack(np.unravel_index(flat, weight.shape))
        i, j = cells.T
        variance = self.rss[i, j] / rng.chisquare(self.freedom, count)
        chol = np.linalg.cholesky(self.inverse[i, j])
        noise = rng.standard_normal((count, chol.shape[-1], 1))
        beta = self.beta[i, j] + np.sqrt(variance)[:, None] * (chol @ noise)[..., 0]
        return cells, variance, beta

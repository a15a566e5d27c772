"""Eq. 2's random parts: log-normal shadowing correlated in space (Gudmundson) and Nakagami-m multipath.

Fields are sums of cosines with random wave vectors (spectral method): deterministic by seed, a pure function of
place and time, so that coming back to a place finds the same shadow, and real time and virtual time agree.
"""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Sequence
from typing import TYPE_CHECKING

from linkrover.errors import ConfigError

from .values import SPEED_OF_LIGHT_M_PER_S, require_not_negative, require_positive

if TYPE_CHECKING:
    import numpy as np

    from .values import Array


class ShadowField:
    """A Gaussian field over the places of both ends, with correlation exp(-d / decorrelation_m).

    Gudmundson's exponential correlation is the characteristic function of a Cauchy distribution, from which the wave
    vectors are drawn. d is the distance between two pairs of places, ((x_a, y_a), (x_b, y_b)), in four dimensions:
    the usual one when one end stands still.

    Raises:
        ConfigError: sigma_db negative or decorrelation_m not above 0.
    """

    def __init__(self, sigma_db: float, decorrelation_m: float, seed: int, terms: int = 96) -> None:
        require_not_negative("shadowing", sigma_db=sigma_db)
        require_positive("shadowing", decorrelation_m=decorrelation_m)
        rng = random.Random(seed)
        self._scale = sigma_db * math.sqrt(2.0 / terms)
        self._terms = []
        for _ in range(terms):
            spread = abs(rng.gauss(0.0, 1.0)) or 1e-9
            wave = [rng.gauss(0.0, 1.0) / (spread * decorrelation_m) for _ in range(4)]
            self._terms.append((*wave, rng.uniform(0.0, 2.0 * math.pi)))

    def at(self, ax: float, ay: float, bx: float, by: float) -> float:
        """Shadowing in dB between two places."""
        cos = math.cos
        return self._scale * sum(
            [cos(k1 * ax + k2 * ay + k3 * bx + k4 * by + phase) for k1, k2, k3, k4, phase in self._terms]
        )


class MultipathField:
    """Nakagami-m power ratio as a function of place and time.

    A Gaussian field with the spatial correlation of isotropic scattering, J0(2 pi d / wavelength), which a robot at
    speed v meets as Doppler v / wavelength; each wave also turns slowly with time (people moving: mean rate
    scene_hz). Its value is carried over to Gamma(m, 1/m) by its rank.

    Raises:
        ConfigError: m below 0.5, or a frequency not above 0.
    """

    def __init__(self, m: float, frequency_mhz: float, seed: int, *, scene_hz: float = 0.2, terms: int = 48) -> None:
        if not 0.5 <= m <= 1000:
            raise ConfigError(f"nakagami_m = {m}: must be 0.5 to 1000")
        require_positive("multipath", frequency_mhz=frequency_mhz)
        require_not_negative("multipath", scene_hz=scene_hz)
        rng = random.Random(seed)
        wave = 2.0 * math.pi * frequency_mhz * 1e6 / SPEED_OF_LIGHT_M_PER_S
        self.m = m
        self._scale = math.sqrt(2.0 / terms)
        self._terms = []
        for index in range(terms):
            angle = 2.0 * math.pi * (index + rng.random()) / terms
            other = rng.uniform(0.0, 2.0 * math.pi)
            self._terms.append(
                (
                    wave * math.cos(angle),
                    wave * math.sin(angle),
                    wave * math.cos(other),
                    wave * math.sin(other),
                    2.0 * math.pi * rng.gauss(0.0, scene_hz),
                    rng.uniform(0.0, 2.0 * math.pi),
                )
            )
        self._quantiles_db = gamma_quantiles_db(m)

    def at(self, time_s: float, ax: float, ay: float, bx: float, by: float) -> float:
        """10 log10 of the power ratio (the paper's Omega in dB)."""
        cos = math.cos
        normal = self._scale * sum(
            [
                cos(k1 * ax + k2 * ay + k3 * bx + k4 * by + rate * time_s + phase)
                for k1, k2, k3, k4, rate, phase in self._terms
            ]
        )
        return _interpolate(self._quantiles_db, normal)


_GRID_LOW, _GRID_HIGH, _GRID_STEP = -4.5, 4.5, 0.05


def _interpolate(table: Sequence[float], normal: float) -> float:
    place = (min(max(normal, _GRID_LOW), _GRID_HIGH) - _GRID_LOW) / _GRID_STEP
    index = min(int(place), len(table) - 2)
    rest = place - index
    return table[index] * (1.0 - rest) + table[index + 1] * rest


@functools.cache
def gamma_quantiles_db(m: float) -> tuple[float, ...]:
    """10 log10 of the Gamma(m, 1/m) quantile at the probability of each standard normal value of the grid."""
    count = round((_GRID_HIGH - _GRID_LOW) / _GRID_STEP) + 1
    out: list[float] = []
    low_db = -400.0
    for index in range(count):
        target = 0.5 * math.erfc(-(_GRID_LOW + index * _GRID_STEP) / math.sqrt(2.0))
        low, high = low_db, 30.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if gamma_cdf(m, m * 10 ** (middle / 10)) < target else (low, middle)
        out.append(low)
        low_db = low
    return tuple(out)


def gamma_cdf(shape: float, x: float) -> float:
    """Regularised lower incomplete gamma function P(shape, x), by its series or continued fraction."""
    if x <= 0:
        return 0.0
    front = math.exp(-x + shape * math.log(x) - math.lgamma(shape))
    if x < shape + 1:
        term = total = 1.0 / shape
        n = shape
        while term > total * 1e-15:
            n += 1
            term *= x / n
            total += term
        return total * front
    b = x + 1 - shape
    c = 1e300
    d = 1 / b
    h = d
    for i in range(1, 1000):
        an = -i * (i - shape)
        b += 2
        d = 1 / (an * d + b)
        c = b + an / c
        h *= d * c
        if abs(d * c - 1) < 1e-15:
            break
    return 1 - front * h


# ---- arrays, for analysis and tests


def gudmundson_path_db(
    distance_along_m: Array, sigma_db: float, decorrelation_m: float, rng: np.random.Generator
) -> Array:
    """Shadowing along a path (metres driven), an exact first-order Gauss-Markov sequence, dB.

    Raises:
        ConfigError: sigma_db negative or decorrelation_m not above 0.
    """
    import numpy as np

    require_not_negative("shadowing", sigma_db=sigma_db)
    require_positive("shadowing", decorrelation_m=decorrelation_m)
    along = np.asarray(distance_along_m, dtype=float)
    rho = np.exp(-np.abs(np.diff(along)) / decorrelation_m)
    noise = rng.standard_normal(along.size) * sigma_db
    out = np.empty(along.size)
    out[0] = noise[0]
    for i, r in enumerate(rho):
        out[i + 1] = r * out[i] + math.sqrt(1.0 - r * r) * noise[i + 1]
    return out


def nakagami_power(m: float, mean_power: float, size: int, rng: np.random.Generator) -> Array:
    """Received power of independent Nakagami-m draws: Gamma(m, P/m), in the unit of mean_power.

    Raises:
        ConfigError: m below 0.5 or mean_power not above 0 (a negative or zero power).
    """
    if not m >= 0.5:
        raise ConfigError(f"nakagami_m = {m}: must be 0.5 or more")
    require_positive("multipath", mean_power=mean_power)
    return rng.gamma(m, mean_power / m, size)

"""Means, spreads and intervals of figures that are correlated in time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

REPLICATES = 1000
SEED = 20210914
MOST = 20_000  # samples a bootstrap or a spectrum works on; longer series are summed over neighbours first


def weighted_mean_std(values: Floats, weights: Floats) -> tuple[float | None, float | None]:
    """Mean and standard deviation with time as weight; `None` where nothing weighs."""
    import numpy as np

    total = float(weights.sum())
    if total <= 0:
        return None, None
    mean = float((values * weights).sum() / total)
    return mean, float(np.sqrt((weights * (values - mean) ** 2).sum() / total))


def weighted_quantiles(values: Floats, weights: Floats, probabilities: tuple[float, ...]) -> list[float | None]:
    """Quantiles of a step function: the value below which the given share of the time lies."""
    import numpy as np

    kept = weights > 0
    if not kept.any():
        return [None] * len(probabilities)
    order = np.argsort(values[kept], kind="stable")
    ordered, share = values[kept][order], np.cumsum(weights[kept][order])
    at = np.searchsorted(share, np.asarray(probabilities) * share[-1])
    return [float(v) for v in ordered[np.minimum(at, len(ordered) - 1)]]


def autocorrelation_time(values: Floats) -> float:
    """Integrated autocorrelation time in samples, 1 + 2 sum(rho), cut by Geyer's initial positive sequence.

    Geyer, "Practical Markov Chain Monte Carlo", Statistical Science 7(4), 1992. At least 1; n for a constant trend.
    """
    import numpy as np

    n = len(values)
    if n < 4:
        return 1.0
    centred = values - values.mean()
    variance = float((centred**2).mean())
    if variance <= 1e-18 * max(1.0, float((values**2).mean())):
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    rho = np.fft.irfft(spectrum * np.conj(spectrum), size)[:n] / (n * variance)
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    last = int(negative[0]) if len(negative) else len(pairs)
    return float(min(max(2 * pairs[:last].sum() - 1, 1.0), n))


def effective_size(values: Floats) -> float:
    """How many independent samples the series is worth: n / autocorrelation time."""
    return len(values) / autocorrelation_time(values) if len(values) else 0.0


def stationary_bootstrap_ratio(
    numerator: Floats, denominator: Floats, block: float, replicates: int = REPLICATES, seed: int = SEED
) -> Floats:
    """Replicates of sum(numerator) / sum(denominator) under the stationary bootstrap (Politis and Romano 1994).

    Blocks of geometric length with mean `block` samples, wrapped round the end. A block's sum is a difference of
    running sums, so a replicate costs as many steps as it has blocks, not samples: the same distribution as
    `arch.bootstrap.StationaryBootstrap` gives, at a small part of its time.
    """
    import numpy as np

    n = len(numerator)
    generator = np.random.default_rng(seed)
    p = 1.0 / min(max(block, 1.0), n)
    out = np.empty((2, replicates))
    running = np.zeros((2, 2 * n + 1))
    running[:, 1:] = np.cumsum(np.tile(np.stack([numerator, denominator]), 2), axis=1)
    count = int(n * p + 4 * np.sqrt(n * p * (1 - p) + 1)) + 2
    batch = max(1, min(replicates, 400_000 // count))
    # a geometric length is a rounded-up exponential one, which is drawn five times faster
    scale = -1 / np.log1p(-p) if p < 1 else 0.0

    def draw(rows: int) -> NDArray[np.int64]:
        lengths = (generator.standard_exponential((rows, count)) * scale).astype(np.int64)
        return np.asarray(np.minimum(lengths + 1, n), dtype=np.int64)

    for begin in range(0, replicates, batch):
        rows = min(batch, replicates - begin)
        ends = np.cumsum(draw(rows), axis=1)
        while ends[:, -1].min() < n:
            ends = np.concatenate([ends, ends[:, -1:] + np.cumsum(draw(rows), axis=1)], axis=1)
        np.minimum(ends, n, out=ends)
        lengths = ends.copy()
        lengths[:, 1:] -= ends[:, :-1]
        starts = generator.integers(0, n, lengths.shape)
        for i in range(2):
            out[i, begin : begin + rows] = (running[i][starts + lengths] - running[i][starts]).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(out[0] / out[1], dtype=np.float64)


def stationary_indices(n: int, block: float, replicates: int, seed: int = SEED) -> Iterator[NDArray[np.intp]]:
    """Sample numbers of each replicate of the stationary bootstrap, for statistics other than sums."""
    import numpy as np

    generator = np.random.default_rng(seed)
    p = 1.0 / min(max(block, 1.0), n)
    steps = np.arange(n)
    for _ in range(replicates):
        fresh = generator.random(n) < p
        fresh[0] = True
        start = np.maximum.accumulate(np.where(fresh, steps, 0))
        yield (generator.integers(0, n, n)[start] + steps - start) % n


def ratio_ci95(numerator: Floats, denominator: Floats) -> tuple[tuple[float, float] | None, float, float]:
    """95 % interval of a ratio of sums, its effective sample size and its autocorrelation time in samples.

    The mean block length is twice the autocorrelation time. No interval from fewer than 8 samples.
    """
    import numpy as np

    used = denominator > 0
    numerator, denominator = numerator[used], denominator[used]
    n = len(numerator)
    if n < 8:
        return None, float(n), 1.0
    tau, numerator, denominator = _grouped(numerator, denominator)
    draws = stationary_bootstrap_ratio(numerator, denominator, 2 * tau * len(numerator) / n)
    draws = draws[np.isfinite(draws)]
    if len(draws) < 100:
        return None, n / tau, tau
    low, high = np.quantile(draws, (0.025, 0.975))
    return (float(low), float(high)), n / tau, tau


def _grouped(numerator: Floats, denominator: Floats) -> tuple[float, Floats, Floats]:
    """Autocorrelation time in samples, and sums over groups of neighbours where the series is very long.

    What matters for the interval of a mean is the spread of sums over long stretches, which grouping keeps.
    """
    import numpy as np

    n = len(numerator)
    step = -(-n // MOST)
    if step == 1:
        return autocorrelation_time(numerator / denominator), numerator, denominator
    kept = n // step * step
    top = numerator[:kept].reshape(-1, step).sum(axis=1)
    bottom = denominator[:kept].reshape(-1, step).sum(axis=1)
    means = top / bottom
    single = float(np.var(numerator / denominator))
    inflation = float(np.var(means)) * step / single if single > 0 else 1.0
    return max(1.0, autocorrelation_time(means) * inflation), top, bottom


def mean_ci95(values: Floats) -> tuple[tuple[float, float] | None, float, float]:
    """The same for a plain mean."""
    import numpy as np

    return ratio_ci95(values, np.ones(len(values)))


def quantile_ci95(values: Floats, probability: float) -> tuple[float, float] | None:
    """95 % interval of a quantile of a correlated series, from order statistics.

    The effective sample size is that of the indicator "below the quantile", whose mean's spread is what moves it.
    """
    import math

    import numpy as np

    n = len(values)
    if n < 8:
        return None
    ordered = np.sort(values)
    below = (values <= np.quantile(ordered, probability)).astype(np.float64)
    ess = n / _grouped(below, np.ones(n))[0]
    if ess < 4:
        return None
    half = 1.96 * math.sqrt(probability * (1 - probability) / ess)
    low, high = probability - half, probability + half
    if low < 0 or high > 1:
        return None
    return float(ordered[int(low * (n - 1))]), float(ordered[min(n - 1, math.ceil(high * (n - 1)))])


def binned(starts: Floats, values: Floats, weights: Floats, width: float) -> tuple[Floats, Floats]:
    """Weighted sums of a step function in bins of `width` (sum of value x weight, sum of weight), by each start."""
    import numpy as np

    if not len(starts):
        return np.zeros(0), np.zeros(0)
    index = ((starts - starts[0]) / width).astype(np.int64)
    n = int(index[-1]) + 1 if len(index) else 0
    value = np.bincount(index, values * weights, n).astype(np.float64)
    return value, np.bincount(index, weights, n).astype(np.float64)

"""What a factor does: effect size with its interval first, the trial as the unit, pairs where cases pair up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import msgspec

from .summary import InterfaceFigures, RunSummary

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PERMUTATIONS = 10_000
ALPHA = 0.05
POWER = 0.8
MAX_TRIALS = 200


class Metric(msgspec.Struct, frozen=True):
    """A figure of a run that set-ups are compared by. `ratio`: effects are ratios, else differences."""

    name: str
    unit: str
    ratio: bool
    better: str  # "high" or "low"
    floor: float = 0.0  # a ratio needs positive values; smaller ones count as this


METRICS: tuple[Metric, ...] = (
    Metric("throughput", "Mbit/s", True, "high", 0.01),
    Metric("throughput while connected", "Mbit/s", True, "high", 0.01),
    Metric("median round trip", "ms", True, "low", 0.001),
    Metric("round trip with time-outs", "ms", True, "low", 0.001),
    Metric("time without answer", "points", False, "low"),
)


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """The effect of a factor's level `high` against `low` on one figure.

    `estimate` is a ratio or a difference in `unit`; the interval is 95 %. `visible` is the smallest ratio or difference
    that trials like these show with 80 % power; `trials_needed` says how many a cell would show the estimate itself.
    """

    factor: str
    low: str
    high: str
    metric: str
    unit: str
    ratio: bool
    better: str
    trials: int
    strata: int
    estimate: float | None = None
    interval: tuple[float, float] | None = None
    p_value: float | None = None
    p_adjusted: float | None = None
    visible: float | None = None
    trials_needed: int | None = None
    matched: str | None = None  # the confounder that was matched
    reason: str | None = None

    @property
    def supported(self) -> bool:
        """Interval and corrected test agree that there is an effect."""
        if self.interval is None or self.p_adjusted is None:
            return False
        zero = 1.0 if self.ratio else 0.0
        return not self.interval[0] <= zero <= self.interval[1] and self.p_adjusted < ALPHA


def metric_value(summary: RunSummary, metric: Metric) -> float | None:
    """One run's value of a metric, at the robot's main interface."""
    robot = main_interface(summary)
    throughput = robot.throughput_mbps if robot is not None else None
    delay = summary.delay_ms
    values: dict[str, float | None] = {
        "throughput": throughput.mean if throughput else None,
        "throughput while connected": throughput.connected_mean if throughput else None,
        "median round trip": delay.median,
        "round trip with time-outs": delay.censored_mean,
        "time without answer": delay.time_out_percent,
    }
    return values[metric.name]


def main_interface(summary: RunSummary, role: str = "robot") -> InterfaceFigures | None:
    """The interface of an end that carried the traffic."""
    end = summary.ends.get(role)
    return end.interfaces.get(end.primary) if end is not None and end.primary is not None else None


def factor_effects(summaries: Sequence[RunSummary]) -> list[Effect]:
    """Every factor with two levels or more, on every metric; p-values corrected over all of them (Holm 1979).

    A factor with three levels gives each pair of levels. Trials of the same other factors form a stratum; the level's
    effect is that within strata (additive model), the test permutes levels within strata only.
    """
    effects: list[Effect] = []
    for factor in sorted({name for s in summaries for name in s.factors}):
        levels = sorted({s.factors[factor] for s in summaries if factor in s.factors})
        for low, high in itertools.combinations(levels, 2):
            effects += [_effect(summaries, factor, low, high, metric) for metric in METRICS]
    return holm(effects)


def holm(effects: Sequence[Effect]) -> list[Effect]:
    """Holm's step-down correction over all effects that have a p-value."""
    order = sorted((e.p_value, i) for i, e in enumerate(effects) if e.p_value is not None)
    out = list(effects)
    worst = 0.0
    for rank, (p, i) in enumerate(order):
        worst = max(worst, min(1.0, p * (len(order) - rank)))
        out[i] = msgspec.structs.replace(out[i], p_adjusted=worst)
    return out


def _effect(summaries: Sequence[RunSummary], factor: str, low: str, high: str, metric: Metric) -> Effect:
    import numpy as np

    rows: list[tuple[tuple[tuple[str, str], ...], bool, float]] = []
    for s in summaries:
        value = metric_value(s, metric)
        level = s.factors.get(factor)
        if value is None or level not in (low, high):
            continue
        stratum = tuple(sorted((k, v) for k, v in s.factors.items() if k != factor))
        rows.append((stratum, level == high, max(value, metric.floor) if metric.ratio else value))
    paired = {st for st, is_high, _ in rows if is_high} & {st for st, is_high, _ in rows if not is_high}
    rows = [row for row in rows if row[0] in paired]
    base = Effect(
        factor=factor,
        low=low,
        high=high,
        metric=metric.name,
        unit=metric.unit,
        ratio=metric.ratio,
        better=metric.better,
        trials=len(rows),
        strata=len(paired),
    )
    if not rows:
        return msgspec.structs.replace(base, reason="no two trials differ in this factor alone")
    names = sorted(paired)
    numbers = np.array([names.index(st) for st, _, _ in rows])
    is_high = np.array([h for _, h, _ in rows], dtype=float)
    y = np.array([v for _, _, v in rows], dtype=float)
    return _fill(base, np.log(y) if metric.ratio else y, is_high, numbers)


def _fill(base: Effect, y: Floats, is_high: Floats, stratum: NDArray[np.intp]) -> Effect:
    """Additive model y = stratum + effect x level; residuals hold both trial noise and what the strata differ by."""
    import numpy as np

    x = within(is_high, stratum)
    yy = within(y, stratum)
    sxx = float((x**2).sum())
    estimate = float((x * yy).sum() / sxx)
    df = len(y) - len(np.unique(stratum)) - 1
    back: Callable[[float], float] = math.exp if base.ratio else float
    if df < 1:
        return msgspec.structs.replace(
            base,
            estimate=back(estimate),
            reason="one trial a set-up: no interval, no test; the difference may be that of any two drives",
        )
    residual = yy - estimate * x
    variance = float((residual**2).sum() / df)
    se = math.sqrt(variance / sxx)
    half = student_quantile(0.975, df) * se
    visible = (student_quantile(0.975, df) + student_quantile(POWER, df)) * se
    return msgspec.structs.replace(
        base,
        estimate=back(estimate),
        interval=(back(estimate - half), back(estimate + half)),
        p_value=permutation_p(yy, is_high, stratum),
        visible=back(visible),
        trials_needed=trials_needed(abs(estimate), variance, len(np.unique(stratum))),
    )


def within(values: Floats, stratum: NDArray[np.intp]) -> Floats:
    """Values less their stratum's mean."""
    import numpy as np

    sums = np.bincount(stratum, values)
    return np.asarray(values - (sums / np.bincount(stratum))[stratum], dtype=np.float64)


def permutation_p(y: Floats, is_high: Floats, stratum: NDArray[np.intp]) -> float:
    """Two-sided p of the level's effect under all (or 10,000 random) exchanges of levels within strata.

    With few trials the smallest possible p is large: two strata of one pair each can never go below 0.5.
    """
    import numpy as np

    groups = [np.flatnonzero(stratum == s) for s in np.unique(stratum)]
    count = math.prod(math.comb(len(g), int(is_high[g].sum())) for g in groups)
    observed = _statistic(y, is_high, stratum)
    if count <= PERMUTATIONS:
        choices = [list(itertools.combinations(g.tolist(), int(is_high[g].sum()))) for g in groups]
        hits = 0
        for combination in itertools.product(*choices):
            levels = np.zeros(len(y))
            levels[[i for chosen in combination for i in chosen]] = 1.0
            hits += _statistic(y, levels, stratum) >= observed - 1e-12
        return hits / count
    generator = np.random.default_rng(1)
    hits = 1
    for _ in range(PERMUTATIONS):
        levels = is_high.copy()
        for g in groups:
            levels[g] = generator.permutation(is_high[g])
        hits += int(_statistic(y, levels, stratum) >= observed - 1e-12)
    return hits / (PERMUTATIONS + 1)


def _statistic(y: Floats, levels: Floats, stratum: NDArray[np.intp]) -> float:
    x = within(levels, stratum)
    return abs(float((x * y).sum() / (x**2).sum()))


def trials_needed(effect: float, variance: float, strata: int) -> int | None:
    """Trials a set-up with which an effect of this size would be seen with 80 % power; `None` above 200."""
    for n in range(2, MAX_TRIALS + 1):
        df = 2 * n * strata - strata - 1
        se = math.sqrt(variance * 2 / (n * strata))
        if effect >= (student_quantile(0.975, df) + student_quantile(POWER, df)) * se:
            return n
    return None


def student_quantile(probability: float, df: float) -> float:
    """Quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(df, probability))


def paired_effect(base: Effect, differences: Sequence[float]) -> Effect:
    """One difference a trial (already of the metric's kind: a difference or a log ratio), against none."""
    import numpy as np

    d = np.asarray(differences, dtype=float)
    n = len(d)
    back: Callable[[float], float] = math.exp if base.ratio else float
    if n == 0:
        return msgspec.structs.replace(base, trials=0, reason="no trial has both")
    estimate = float(d.mean())
    if n < 2:
        return msgspec.structs.replace(base, trials=n, estimate=back(estimate), reason="one trial: no interval")
    se = float(d.std(ddof=1)) / math.sqrt(n)
    half = student_quantile(0.975, n - 1) * se
    if n <= 13:
        signs = itertools.product((1.0, -1.0), repeat=n)
        means = [abs(float((d * np.array(s)).mean())) for s in signs]
        p = sum(m >= abs(estimate) - 1e-12 for m in means) / len(means)
    else:
        flips = np.random.default_rng(1).choice((1.0, -1.0), (PERMUTATIONS, n))
        p = (1 + int((np.abs((flips * d).mean(axis=1)) >= abs(estimate) - 1e-12).sum())) / (PERMUTATIONS + 1)
    visible = (student_quantile(0.975, n - 1) + student_quantile(POWER, n - 1)) * se
    return msgspec.structs.replace(
        base,
        trials=n,
        estimate=back(estimate),
        interval=(back(estimate - half), back(estimate + half)),
        p_value=p,
        visible=back(visible),
    )

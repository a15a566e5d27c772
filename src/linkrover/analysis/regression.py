"""Is a new run worse than a base run, beyond noise? Limits such as "delay.p95 > +20%"."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from linkrover.errors import ConfigError

from .delay import find_probes
from .link import signal_steps
from .run import Run
from .stats import autocorrelation_time, stationary_indices, weighted_quantiles

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

REPLICATES = 500
MAX_SAMPLES = 20_000  # longer series are averaged down first: their interval is far below any limit worth stating
QUANTILES = {"median": 0.5, "p5": 0.05, "p95": 0.95, "p99": 0.99}


class Limit(msgspec.Struct, frozen=True):
    """A stated limit: `metric` above (or below) `value`; relative in percent or absolute change, or absolute level."""

    text: str
    metric: str
    above: bool
    value: float
    kind: str  # "percent", "change" or "level"


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one limit. `change` is new against base in percent; interval 95 %, of noise within the runs."""

    limit: str
    metric: str
    base: float | None
    new: float | None
    change_percent: float | None = None
    tested: float | None = None  # the figure the limit speaks of
    interval: tuple[float, float] | None = None
    broken: bool = False
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class Series:
    """The samples behind a metric, the seconds each stands for, and what is made of them."""

    values: Floats
    weights: Floats
    statistic: str


METRICS = {
    "delay.mean": "mean of answered probes, ms",
    "delay.median": "median, ms",
    "delay.p95": "95th percentile, ms",
    "delay.p99": "99th percentile, ms",
    "loss": "probes lost, %",
    "throughput": "mean at the robot's main interface, Mbit/s",
    "throughput.p5": "5th percentile over time, Mbit/s",
    "throughput.tx": "sent by the robot, Mbit/s",
    "throughput.rx": "received by the robot, Mbit/s",
    "rssi": "mean at the robot, else at the station, dBm",
    "rssi.p5": "5th percentile, dBm",
}
_LIMIT = re.compile(
    r"\s*([a-z][a-z0-9_.]*)\s*(>=|<=|>|<)\s*([+-]?)\s*(\d+(?:\.\d+)?)\s*(%|points|ms|mbit/s|dbm?|db)?\s*", re.IGNORECASE
)


def parse_limit(text: str) -> Limit:
    """`METRIC > +20%` (change), `METRIC > +5` (change in its unit) or `METRIC > 100` (level of the new run).

    A signed number is a change against the base, an unsigned one a level. Raises ConfigError with what is allowed.
    """
    match = _LIMIT.fullmatch(text)
    if match is None:
        raise ConfigError(
            f'limit "{text}" is not understood; write METRIC > LIMIT, for example "delay.p95 > +20%", '
            '"throughput < -10%" or "loss > 2"'
        )
    metric, comparison, sign, number, unit = match.groups()
    name = (
        metric.lower().removesuffix(".mean") if metric.lower() in ("throughput.mean", "rssi.mean") else metric.lower()
    )
    name = {"loss_percent": "loss", "delay.loss": "loss", "delay.loss_percent": "loss"}.get(name, name)
    if name not in METRICS:
        raise ConfigError(f"metric '{metric}' is unknown; there are: {', '.join(METRICS)}")
    value = float(number) * (-1 if sign == "-" else 1)
    relative = unit == "%" and bool(sign)
    if unit == "%" and not sign and name != "loss":
        raise ConfigError(f'limit "{text}": a change in percent needs its sign, "+{number}%" or "-{number}%"')
    return Limit(
        text, name, comparison.startswith(">"), value, "percent" if relative else "change" if sign else "level"
    )


def series_of(run: Run, metric: str) -> Series | None:
    """The samples of a metric; `None` where the run has none of them."""
    import numpy as np

    group, _, statistic = metric.partition(".")
    if group in ("delay", "loss"):
        probes = find_probes(run)
        if probes is None or not len(probes.delay_ms):
            return None
        if group == "loss":
            lost = np.isnan(probes.delay_ms) * 100.0
            return Series(lost, np.ones(len(lost)), "mean")
        answered = probes.delay_ms[np.isfinite(probes.delay_ms)]
        return Series(answered, np.ones(len(answered)), statistic or "mean") if len(answered) else None
    if group == "throughput":
        robot = run.robot
        iface = robot.primary if robot is not None else None
        table = robot.utilization.get(iface) if robot is not None and iface is not None else None
        if table is None or not table["has_base"].any():
            return None
        good = table["has_base"]
        bits = table[{"tx": "tx_bits", "rx": "rx_bits"}.get(statistic, "bits")][good]
        seconds = (table["t_s"] - table["begin_s"])[good]
        return Series(bits / seconds / 1e6, seconds, statistic if statistic in QUANTILES else "mean")
    for end in (run.robot, run.station):
        iface = end.primary if end is not None else None
        table = end.wireless.get(iface) if end is not None and iface is not None else None
        if table is not None:
            starts, stops, valid, _ = signal_steps(table, run.published_2021)
            fresh = run.span.intersect(end.alive) if end is not None and end.alive is not None else run.span
            weights = fresh.measure(starts, stops)
            valid &= weights > 0
            if valid.any():
                return Series(table["rssi_dbm"][valid], weights[valid], statistic or "mean")
    return None


def compare_runs(base: Run, new: Run, limits: list[Limit]) -> list[Verdict]:
    """Each limit against both runs; broken only if the whole 95 % interval lies beyond it."""
    return [_verdict(base, new, limit) for limit in limits]


def _verdict(base: Run, new: Run, limit: Limit) -> Verdict:
    import numpy as np

    first, second = series_of(base, limit.metric), series_of(new, limit.metric)
    if second is None or (limit.kind != "level" and first is None):
        which = "the new run" if second is None else "the base run"
        return Verdict(
            limit=limit.text,
            metric=limit.metric,
            base=None if first is None else point(first),
            new=None if second is None else point(second),
            reason=f"{which} has no samples of {limit.metric}, so the limit cannot be checked",
        )
    new_point, new_draws = point(second), replicates(second, seed=2)
    base_point = point(first) if first is not None else None
    tested, draws = new_point, new_draws
    if limit.kind != "level" and first is not None and base_point is not None:
        base_draws = replicates(first, seed=1)
        if limit.kind == "percent":
            if base_point == 0 or (base_draws == 0).any():
                reason = f"{limit.metric} of the base run is or may be zero: state the change in its unit"
                return Verdict(limit=limit.text, metric=limit.metric, base=base_point, new=new_point, reason=reason)
            tested = 100.0 * (new_point - base_point) / abs(base_point)
            draws = 100.0 * (new_draws - base_draws) / np.abs(base_draws)
        else:
            tested, draws = new_point - base_point, new_draws - base_draws
    low, high = (float(v) for v in np.quantile(draws, (0.025, 0.975)))
    broken = low > limit.value if limit.above else high < limit.value
    beyond = tested > limit.value if limit.above else tested < limit.value
    return Verdict(
        limit=limit.text,
        metric=limit.metric,
        base=base_point,
        new=new_point,
        change_percent=100.0 * (new_point - base_point) / abs(base_point) if base_point else None,
        tested=tested,
        interval=(low, high),
        broken=broken,
        reason="beyond the limit, but within the noise of these runs" if beyond and not broken else None,
    )


def point(series: Series) -> float:
    """The metric itself."""
    return statistic(series.statistic, series.values, series.weights)


def statistic(name: str, values: Floats, weights: Floats) -> float:
    """Weighted mean, or a weighted quantile."""
    import numpy as np

    if name not in QUANTILES:
        return float((values * weights).sum() / weights.sum())
    if (weights == weights[0]).all():
        return float(np.quantile(values, QUANTILES[name]))
    (found,) = weighted_quantiles(values, weights, (QUANTILES[name],))
    return float("nan") if found is None else found


def replicates(series: Series, seed: int) -> Floats:
    """Replicates of the metric under the stationary block bootstrap."""
    import numpy as np

    values, weights = series.values, series.weights
    if len(values) > MAX_SAMPLES and series.statistic == "mean":
        step = -(-len(values) // MAX_SAMPLES)
        kept = len(values) // step * step
        mass = weights[:kept].reshape(-1, step).sum(axis=1)
        values = (values * weights)[:kept].reshape(-1, step).sum(axis=1) / mass
        weights = mass
    if len(values) < 2:
        return np.full(REPLICATES, point(series))
    block = 2 * autocorrelation_time(values)
    count = REPLICATES if len(values) <= MAX_SAMPLES else 100
    indices = stationary_indices(len(values), block, count, seed)
    draws = [statistic(series.statistic, values[i], weights[i]) for i in indices]
    return np.resize(np.array(draws), REPLICATES)

"""Throughput, signal and counters of one interface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from .run import HOLD_S, End
from .stats import binned, ratio_ci95, weighted_mean_std, weighted_quantiles
from .window import Window

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns

    Floats = NDArray[np.float64]

BIN_S = 1.0
# What a wireless-extensions driver prints when it has no reading lies outside this range.
WEXT_READING_DBM = (-98.0, -4.0)


class ThroughputFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Bits over the interface per second of elapsed time, Mbit/s; rx + tx unless said."""

    mean: float | None = None
    std: float | None = None
    tx_mean: float | None = None
    rx_mean: float | None = None
    tx_std: float | None = None
    rx_std: float | None = None
    connected_mean: float | None = None
    mean_ci95: tuple[float, float] | None = None
    p5: float | None = None
    median: float | None = None
    p95: float | None = None
    ess: float | None = None
    autocorrelation_s: float | None = None
    interval_s: float | None = None
    covered_percent: float | None = None
    samples: int = 0
    reason: str | None = None


class SignalFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Received signal strength, dBm, time-weighted over fresh and valid readings."""

    mean: float | None = None
    std: float | None = None
    p5: float | None = None
    median: float | None = None
    p95: float | None = None
    mean_ci95: tuple[float, float] | None = None
    ess: float | None = None
    covered_percent: float | None = None
    stale_percent: float | None = None
    disagreeing: int = 0  # readings whose connection status contradicts them
    samples: int = 0
    reason: str | None = None


class SpreadFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Mean and spread of a quantity without further figures."""

    mean: float | None = None
    std: float | None = None
    reason: str | None = None


class CounterFigures(msgspec.Struct, frozen=True, kw_only=True):
    """By how much a counter rose, robust against resets; `None` with the reason where that cannot be known."""

    increase: float | None = None
    resets: int = 0
    reason: str | None = None


def throughput_figures(table: Columns | None, window: Window, connected: Window) -> ThroughputFigures:
    """Bytes over elapsed time, in the window and in its connected part; intervals without a base do not count."""
    import numpy as np

    if table is None:
        return ThroughputFigures(reason="throughput: no counters of this interface were recorded")
    good = table["has_base"]
    begin, end = table["begin_s"][good], table["t_s"][good]
    if not len(begin):
        return ThroughputFigures(reason="throughput: no two counter samples without a reset between them")
    length = end - begin
    inside = window.measure(begin, end)
    total = float(inside.sum())
    if total <= 0:
        return ThroughputFigures(reason="throughput: no counter interval lies in this part of the run")
    rate = table["bits"][good] / length / 1e6
    tx, rx = table["tx_bits"][good] / length / 1e6, table["rx_bits"][good] / length / 1e6
    mean, std = weighted_mean_std(rate, inside)
    tx_mean, tx_std = weighted_mean_std(tx, inside)
    rx_mean, rx_std = weighted_mean_std(rx, inside)
    up = window.intersect(connected).measure(begin, end)
    connected_mean, _ = weighted_mean_std(rate, up)
    usual = float(np.median(length))
    if usual < BIN_S / 2:  # many samples a second: their correlation is the same story told often
        numerator, denominator = binned(begin, rate, inside, BIN_S)
        step = BIN_S
    else:
        numerator, denominator, step = rate * inside, inside, usual
    interval, ess, tau = ratio_ci95(numerator, denominator)
    p5, median, p95 = weighted_quantiles(rate, inside, (0.05, 0.5, 0.95))
    short = length[length < 1.6 * usual]
    return ThroughputFigures(
        mean=mean,
        std=std,
        tx_mean=tx_mean,
        rx_mean=rx_mean,
        tx_std=tx_std,
        rx_std=rx_std,
        connected_mean=connected_mean,
        mean_ci95=interval,
        p5=p5,
        median=median,
        p95=p95,
        ess=ess,
        autocorrelation_s=tau * step,
        interval_s=float(short.mean()),
        covered_percent=100.0 * total / window.seconds if window.seconds > 0 else None,
        samples=int((inside > 0).sum()),
        reason=_reasons(
            ("connected_mean", connected_mean is None, "the link was never connected in this part of the run"),
            ("mean_ci95", interval is None, "fewer than 8 samples"),
        ),
    )


def signal_figures(end: End, table: Columns | None, window: Window, published_2021: bool) -> SignalFigures:
    """Time-weighted over readings that are there, valid, fresh and not contradicted by the connection status."""
    import numpy as np

    if table is None:
        return SignalFigures(reason="rssi: no wireless link of this interface was recorded")
    starts, stops, valid, disagree = signal_steps(table, published_2021)
    fresh = window
    if published_2021 and end.alive is not None:
        # only changes are known, so a reading stands while anything else of that end still arrives
        fresh = window.intersect(end.alive)
    weights = np.where(valid, fresh.measure(starts, stops), 0.0)
    total = float(weights.sum())
    seen = window.contains(starts)
    disagreeing = int((disagree & seen).sum())
    following = np.append(starts[1:], np.maximum(stops[-1:], window.ends[-1:]))
    stale = float(np.where(valid, window.measure(starts, following), 0.0).sum()) - total
    if total <= 0:
        words = "an access point without readings of its own" if _is_ap(table) else "no valid reading"
        return SignalFigures(
            disagreeing=disagreeing,
            covered_percent=0.0 if window.seconds > 0 else None,
            reason=f"rssi: {words} in this part of the run",
        )
    rssi = np.where(valid, table["rssi_dbm"], 0.0)
    mean, std = weighted_mean_std(rssi, weights)
    p5, median, p95 = weighted_quantiles(rssi, weights, (0.05, 0.5, 0.95))
    interval, ess = signal_interval(starts, stops, rssi, valid, fresh)
    return SignalFigures(
        mean=mean,
        std=std,
        p5=p5,
        median=median,
        p95=p95,
        mean_ci95=interval,
        ess=ess,
        covered_percent=100.0 * total / window.seconds,
        stale_percent=100.0 * stale / window.seconds,
        disagreeing=disagreeing,
        samples=int((valid & seen).sum()),
        reason=_reasons(("mean_ci95", interval is None, "fewer than 8 s of readings")),
    )


def signal_steps(table: Columns, published_2021: bool) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """Begin and end of the time each reading stands for, which readings are valid, which status contradicts them."""
    import numpy as np

    starts = table["t_s"]
    following = np.append(starts[1:], np.inf)
    stops = following if published_2021 else np.minimum(following, starts + HOLD_S)
    rssi, connected = table["rssi_dbm"], table["connected"]
    valid = np.isfinite(rssi)
    source = table.get("source")
    if source is not None:
        wext = source == "wext"
        valid &= ~wext | ((rssi > WEXT_READING_DBM[0]) & (rssi < WEXT_READING_DBM[1]))
    if "inactive_ms" in table:
        valid &= ~(table["inactive_ms"] > HOLD_S * 1e3)
    disagree = (valid & (connected == 0)) | (~np.isfinite(rssi) & (connected == 1))
    return starts, stops, valid & ~(connected == 0), disagree


def signal_interval(
    starts: Floats, stops: Floats, rssi: Floats, valid: NDArray[np.bool_], window: Window
) -> tuple[tuple[float, float] | None, float]:
    """95 % interval of the time-weighted mean from bins of one second, and the effective sample size."""
    import numpy as np

    if not len(starts):
        return None, 0.0
    first, last = float(starts[0]), float(window.ends[-1]) if len(window.ends) else 0.0
    stops = np.minimum(stops, max(last, first))
    edges = np.arange(first, last + BIN_S, BIN_S)
    if len(edges) < 3:
        return None, 0.0
    used = valid & (stops > starts)
    a, b, v = starts[used], stops[used], rssi[used]
    weight = _binned_measure(a, b, np.ones(len(a)), edges)
    value = _binned_measure(a, b, v, edges)
    share = window.measure(edges[:-1], edges[1:]) / BIN_S
    interval, ess, _ = ratio_ci95(value * share, weight * share)
    return interval, ess


def _binned_measure(starts: Floats, stops: Floats, values: Floats, edges: Floats) -> Floats:
    """Integral of a step function with gaps over each bin."""
    import numpy as np

    knots = np.stack([starts, stops], axis=1).ravel()
    area = np.cumsum(np.concatenate(([0.0], values * (stops - starts))))
    level = np.stack([area[:-1], area[1:]], axis=1).ravel()
    return np.asarray(np.diff(np.interp(edges, knots, level)), dtype=np.float64)


def counter_figures(table: Columns | None, name: str, window: Window) -> CounterFigures:
    """Increase of a raw counter over a window: a fall is a restart from zero, unless two counters interleave."""
    import numpy as np

    if table is None or name not in table:
        return CounterFigures(reason=f"{name}: not recorded")
    known = np.isfinite(table[name])
    raw, times = table[name][known], table["t_s"][known]
    if not len(raw):
        return CounterFigures(reason=f"{name}: this kernel or driver does not give it")
    if len(raw) < 2:
        return CounterFigures(reason=f"{name}: fewer than two samples")
    steps = np.diff(raw)
    falls = np.flatnonzero(steps < 0)
    if len(falls) > 1 and (chains := interleaved(raw)) is not None:
        rises = " and ".join(f"{chain[-1] - chain[0]:+.0f}" for chain in chains)
        return CounterFigures(
            resets=0,
            reason=f"{name}: counters of two publishers interleave ({len(falls)} falls; they rise by {rises}); which "
            "of them is this interface's is not in the data",
        )
    steps = np.where(steps < 0, raw[1:], steps)
    inside = window.contains((times[:-1] + times[1:]) / 2)
    return CounterFigures(increase=float(steps[inside].sum()), resets=int(inside[falls].sum()))


def interleaved(raw: Floats) -> tuple[list[float], list[float]] | None:
    """Split a falling sequence into two that never fall, where the falls are of that kind; `None` for real resets.

    A reset restarts near zero and stays below what was; two publishers alternate between two nearby levels.
    """
    first: list[float] = [float(raw[0])]
    second: list[float] = []
    for value in raw[1:].tolist():
        fits_first = value >= first[-1]
        fits_second = bool(second) and value >= second[-1]
        if fits_first and fits_second:
            (first if value - first[-1] <= value - second[-1] else second).append(value)
        elif fits_first:
            first.append(value)
        elif fits_second or not second:
            second.append(value)
        else:
            return None
    changes = int((raw[1:] < raw[:-1]).sum())
    return (first, second) if second and changes > 1 and len(second) > 1 else None


def _is_ap(table: Columns) -> bool:
    import numpy as np

    mode = table.get("mode")
    return (mode is not None and any(m == "ap" for m in mode.tolist())) or not np.isfinite(table["rssi_dbm"]).any()


def _reasons(*rows: tuple[str, bool, str]) -> str | None:
    return "; ".join(f"{name}: {why}" for name, missing, why in rows if missing) or None

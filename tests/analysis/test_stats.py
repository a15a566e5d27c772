from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.analysis.link import counter_figures, interleaved
from linkrover.analysis.stats import (
    autocorrelation_time,
    mean_ci95,
    quantile_ci95,
    ratio_ci95,
    stationary_bootstrap_ratio,
    stationary_indices,
    weighted_mean_std,
    weighted_quantiles,
)
from linkrover.analysis.window import Window


def correlated(n: int, memory: float, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(n)
    out = np.empty(n)
    out[0] = noise[0]
    for i in range(1, n):
        out[i] = memory * out[i - 1] + np.sqrt(1 - memory**2) * noise[i]
    return out


def test_autocorrelation_time_of_a_known_process_is_found() -> None:
    memory = 0.9
    found = autocorrelation_time(correlated(40_000, memory))
    assert found == pytest.approx((1 + memory) / (1 - memory), rel=0.15)
    assert autocorrelation_time(correlated(4000, 0.0)) == pytest.approx(1, abs=0.2)
    assert autocorrelation_time(np.ones(100)) == 1


@pytest.mark.parametrize("block", [1.0, 5.0, 40.0])
def test_our_stationary_bootstrap_agrees_with_archs(block: float) -> None:
    arch = pytest.importorskip("arch.bootstrap", reason="the yardstick arch is not installed")
    values = correlated(300, 0.8) + 10
    theirs = arch.StationaryBootstrap(block, values, seed=3).apply(np.mean, 2000).ravel()
    ours = stationary_bootstrap_ratio(values, np.ones(300), block, 2000)
    by_index = np.array([values[i].mean() for i in stationary_indices(300, block, 2000, seed=5)])
    for found in (ours, by_index):
        assert found.mean() == pytest.approx(theirs.mean(), abs=0.03)
        assert found.std() == pytest.approx(theirs.std(), rel=0.1)


def test_intervals_cover_the_mean_of_correlated_series_about_as_often_as_stated() -> None:
    hits = 0
    for seed in range(100):
        interval, _, _ = mean_ci95(correlated(600, 0.8, seed))
        assert interval is not None
        hits += interval[0] <= 0 <= interval[1]
    assert hits >= 82  # a naive interval of such a series covers it about half of the time


def test_a_long_series_has_the_interval_of_its_neighbour_sums() -> None:
    values = correlated(60_000, 0.9)
    interval, ess, tau = mean_ci95(values)
    assert interval is not None
    assert tau == pytest.approx(19, rel=0.3)
    assert ess == pytest.approx(60_000 / 19, rel=0.3)
    assert interval[1] - interval[0] == pytest.approx(2 * 1.96 * np.sqrt(19 / 60_000), rel=0.3)


def test_too_few_samples_give_no_interval() -> None:
    assert mean_ci95(np.arange(5.0))[0] is None
    assert quantile_ci95(np.arange(5.0), 0.5) is None
    assert quantile_ci95(np.arange(500.0), 0.999) is None


def test_weights_of_zero_do_not_count() -> None:
    values, weights = np.array([1.0, 100.0, 3.0]), np.array([1.0, 0.0, 1.0])
    assert weighted_mean_std(values, weights) == (2.0, 1.0)
    assert weighted_quantiles(values, weights, (0.5, 1.0)) == [1.0, 3.0]
    assert weighted_mean_std(values, np.zeros(3)) == (None, None)
    interval, _, _ = ratio_ci95(np.tile(values, 5), np.tile(weights, 5))
    assert interval is not None


WINDOWS = st.lists(st.tuples(st.integers(0, 50), st.integers(1, 9)), max_size=6)


def window_of(pairs: list[tuple[int, int]]) -> Window:
    at, begins, ends = 0, [], []
    for gap, length in pairs:
        begins.append(float(at + gap))
        at += gap + length
        ends.append(float(at))
        at += 1
    return Window(np.array(begins), np.array(ends))


@settings(max_examples=60, deadline=None)
@given(WINDOWS, WINDOWS)
def test_windows_obey_set_arithmetic(a: list[tuple[int, int]], b: list[tuple[int, int]]) -> None:
    first, second = window_of(a), window_of(b)
    both, rest = first.intersect(second), first.without(second)
    assert both.seconds + rest.seconds == pytest.approx(first.seconds)
    assert both.seconds == pytest.approx(second.intersect(first).seconds)
    if len(first.begins):
        assert second.measure(first.begins, first.ends).sum() == pytest.approx(both.seconds)


def counter(values: list[float]) -> dict[str, np.ndarray]:
    return {"t_s": np.arange(float(len(values))), "c": np.array(values)}


ALL = Window.of(0.0, 100.0)


def test_a_counter_that_restarts_goes_on_from_zero() -> None:
    found = counter_figures(counter([100, 110, 130, 4, 9]), "c", ALL)
    assert (found.increase, found.resets) == (39, 1)


def test_two_interleaved_counters_are_unknown_with_both_rises_named() -> None:
    found = counter_figures(counter([3683, 3600, 3683, 3610, 3684, 3620, 3684, 3650]), "c", ALL)
    assert found.increase is None
    assert found.reason is not None
    assert "+1" in found.reason
    assert "+50" in found.reason


def test_several_real_restarts_are_not_taken_for_two_publishers() -> None:
    assert interleaved(np.array([100.0, 150, 3, 80, 1, 20])) is None
    assert counter_figures(counter([100, 150, 3, 80, 1, 20]), "c", ALL).increase == 50 + 3 + 77 + 1 + 19


def test_unknown_samples_of_a_counter_are_passed_over() -> None:
    assert counter_figures(counter([5, float("nan"), 9]), "c", ALL).increase == 4
    assert counter_figures(None, "c", ALL).reason == "c: not recorded"

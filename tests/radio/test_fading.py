import math

import numpy as np
import pytest
from scipy import stats
from scipy.special import j0

from linkrover.errors import ConfigError
from linkrover.radio.fading import (
    MultipathField,
    ShadowField,
    gamma_cdf,
    gamma_quantiles_db,
    gudmundson_path_db,
    nakagami_power,
)


def test_the_incomplete_gamma_function_is_scipys():
    for shape in (0.5, 1.8, 5.0, 40.0):
        for x in (0.01, 0.5, 2.0, 10.0, 60.0):
            assert gamma_cdf(shape, x) == pytest.approx(stats.gamma.cdf(x, shape), abs=1e-12)


@pytest.mark.parametrize("m", [0.5, 1.8, 5.0])
def test_the_quantile_table_is_the_gamma_distributions(m):
    table = gamma_quantiles_db(m)
    normal = np.linspace(-4.5, 4.5, len(table))
    expected = 10 * np.log10(stats.gamma.ppf(stats.norm.cdf(normal), m) / m)
    assert table == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("m", [1.0, 1.8, 5.0])
def test_multipath_power_is_gamma_m_by_kolmogorov_and_smirnov(m):
    # one value of each of many independent fields; p above 1 % with these seeds
    values = [10 ** (MultipathField(m, 2437.0, seed).at(3.0, 1.0, 2.0, 0.0, 0.0) / 10) for seed in range(600)]
    assert stats.kstest(values, stats.gamma(m, scale=1 / m).cdf).pvalue > 0.01


def test_shadowing_is_normal_by_kolmogorov_and_smirnov():
    values = [ShadowField(5.0, 3.0, seed).at(4.0, 7.0, 0.0, 0.0) for seed in range(600)]
    assert stats.kstest(values, stats.norm(0, 5.0).cdf).pvalue > 0.01


@pytest.mark.parametrize("way", [0.5, 3.0, 9.0])
def test_shadowing_correlates_as_exp_of_the_way_over_the_decorrelation_distance(way):
    pairs = np.array(
        [(f.at(1.0, 1.0, 0, 0), f.at(1.0 + way, 1.0, 0, 0)) for f in (ShadowField(1.0, 3.0, s) for s in range(1500))]
    )
    assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(math.exp(-way / 3.0), abs=0.07)


@pytest.mark.parametrize("way", [0.02, 0.05, 0.2])
def test_multipath_correlates_as_bessels_function_of_the_way_in_wavelengths(way):
    wave = 299_792_458 / 2437e6
    pairs = []
    for seed in range(1200):
        field = MultipathField(1e3, 2437.0, seed)  # so large an m is nearly normal in dB
        pairs.append((field.at(0, 0, 0, 5, 5), field.at(0, way, 0, 5, 5)))
    assert np.corrcoef(np.array(pairs).T)[0, 1] == pytest.approx(j0(2 * math.pi * way / wave), abs=0.08)


def test_coming_back_to_a_place_finds_the_same_shadow():
    field = ShadowField(6.0, 3.0, seed=9)
    there = field.at(3.0, 4.0, 0, 0)
    field.at(10.0, 0.0, 0, 0)
    assert field.at(3.0, 4.0, 0, 0) == there == ShadowField(6.0, 3.0, seed=9).at(3.0, 4.0, 0, 0)


def test_a_gudmundson_path_has_its_sigma_and_correlation():
    along = np.arange(0, 60_000, 0.5)
    path = gudmundson_path_db(along, 4.0, 2.0, np.random.default_rng(1))
    assert path.std() == pytest.approx(4.0, rel=0.03)
    assert np.corrcoef(path[4:], path[:-4])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.02)


def test_nakagami_draws_have_their_mean_and_spread():
    power = nakagami_power(2.0, 3.0, 100_000, np.random.default_rng(2))
    assert power.mean() == pytest.approx(3.0, rel=0.02)
    assert power.var() == pytest.approx(9.0 / 2.0, rel=0.05)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: ShadowField(-1.0, 3.0, 0), "sigma_db"),
        (lambda: ShadowField(1.0, 0.0, 0), "decorrelation_m"),
        (lambda: MultipathField(0.1, 2437.0, 0), "nakagami_m"),
        (lambda: nakagami_power(2.0, -1.0, 3, np.random.default_rng(0)), "mean_power"),
        (lambda: nakagami_power(0.2, 1.0, 3, np.random.default_rng(0)), "nakagami_m"),
    ],
)
def test_bad_values_are_named(make, named):
    with pytest.raises(ConfigError, match=named):
        make()

"""Fits on synthetic data. Coverage over 1,000 repeats is `benchmarks fit_coverage`; here: few, fixed seeds."""

import math

import numpy as np
import pytest
from benchmarks.fit_coverage import LINE, drive

from linkrover.errors import ConfigError
from linkrover.radio.estimate import FitError, thin
from linkrover.radio.fit_nakagami import fit_nakagami, fit_nakagami_along
from linkrover.radio.fit_path_loss import fit_path_loss
from linkrover.radio.fit_position import fit_position
from linkrover.radio.fit_throughput import fit_throughput, model_bps

POINT = (3.0, 7.0)


def readings(seed):
    rng = np.random.default_rng(seed)
    places, root = drive()
    distance = np.hypot(places[:, 0] - POINT[0], places[:, 1] - POINT[1])
    shadow = LINE["sigma_db"] * (root @ rng.standard_normal(len(places)))
    return places, LINE["rss_1m_dbm"] - 10 * LINE["exponent"] * np.log10(distance) + shadow


def test_intervals_of_the_line_hold_the_truth_and_are_wider_than_those_of_uncorrelated_residuals():
    inside = dict.fromkeys(LINE, 0)
    for seed in range(3):
        places, rssi = readings(seed)
        fit = fit_path_loss(places, POINT, rssi)
        for name, truth in LINE.items():
            estimate = getattr(fit, name)
            inside[name] += estimate.low <= truth <= (estimate.high or math.inf)
    assert all(count >= 2 for count in inside.values())
    x = 10 * np.log10(np.hypot(*(places - POINT).T))
    naive = np.std(rssi - np.polyval(np.polyfit(x, rssi, 1), x)) / (x.std() * math.sqrt(len(x)))
    assert fit.exponent.high - fit.exponent.low > 3 * 2 * 1.96 * naive


def test_the_access_point_is_found_and_its_region_is_bounded():
    hits = bounded = 0
    for seed in range(5):
        fit = fit_position(*readings(seed))
        hits += fit.contains(*POINT)
        bounded += fit.bounded
        assert bool(fit.note) != fit.bounded
        assert fit.region_area_m2 > 0.3
        assert len(fit.outline()) >= 3
    assert hits >= 4
    assert bounded >= 3


def test_a_straight_drive_cannot_tell_the_side_and_standing_still_tells_nothing():
    line = np.column_stack([np.linspace(0, 20, 200), np.zeros(200)])
    rssi = -40 - 25 * np.log10(np.hypot(line[:, 0] - 5, 3.0))
    with pytest.raises(FitError, match="straight line"):
        fit_position(line, rssi)
    with pytest.raises(FitError, match="hardly changed"):
        fit_path_loss(np.zeros((100, 2)), (1.0, 1.0), np.full(100, -50.0))
    around = np.column_stack([5 * np.cos(np.linspace(0, 6.2, 300)), 5 * np.sin(np.linspace(0, 6.2, 300))])
    with pytest.raises(FitError, match="hardly changed"):
        fit_path_loss(around, (0.0, 0.0), np.full(300, -50.0))


def test_thinning_averages_along_the_way_and_counts_a_stop_once():
    places = np.array([(0.0, 0.0)] * 50 + [(0.1 * i, 0.0) for i in range(1, 31)])
    thinned, values, count = thin(places, np.arange(80.0), 0.5)
    assert len(values) == 7
    assert count[0] > 50
    assert thinned[-1, 0] == pytest.approx(3.0, abs=0.3)


def test_nakagami_m_of_samples_and_along_a_drive_with_shadowing():
    rng = np.random.default_rng(4)
    samples = fit_nakagami(rng.gamma(1.8, 1 / 1.8, 500))
    assert samples.low < 1.8 < samples.high
    along = np.arange(0, 77, 0.045)
    shadow = np.interp(along, np.arange(0, 80, 3.0), 4 * rng.standard_normal(27))
    rssi = np.round(-60 + shadow + 10 * np.log10(rng.gamma(3.0, 1 / 3.0, along.size)))
    drive_fit = fit_nakagami_along(rssi, along)
    assert drive_fit.value == pytest.approx(3.0, rel=0.2)
    assert drive_fit.low < drive_fit.value < drive_fit.high
    with pytest.raises(FitError, match="10 m"):
        fit_nakagami_along(rssi[:50], along[:50])
    with pytest.raises(ConfigError, match="power"):
        fit_nakagami(np.array([1.0, -1.0] * 30))


def test_throughput_parameters_are_found_where_the_data_show_them():
    rng = np.random.default_rng(5)
    level = rng.uniform(-85, -45, 200)
    fit = fit_throughput(level, model_bps(level, 1.8e6, -93.0, 19e6) + rng.normal(0, 1e6, 200))
    assert fit.alpha_b_hz.low < 1.8e6 < fit.alpha_b_hz.high
    assert fit.noise_dbm.low < -93.0 < fit.noise_dbm.high
    assert fit.cap_bps.low < 19e6 < fit.cap_bps.high


def test_what_the_data_do_not_show_is_said_to_be_unknown():
    rng = np.random.default_rng(6)
    level = rng.uniform(-58, -53, 100)  # all at high SNR: a straight stretch, and no cap in sight
    fit = fit_throughput(level, model_bps(level, 1.8e6, -93.0, math.inf) + rng.normal(0, 3e6, 100))
    assert fit.cap_bps.value is None
    assert not fit.cap_bps.identifiable
    assert not fit.noise_dbm.identifiable
    assert "trades" in fit.noise_dbm.note
    with pytest.raises(FitError, match="3 dB"):
        fit_throughput(np.full(50, -60.0), np.full(50, 1e6))
    with pytest.raises(FitError, match="at least 15"):
        fit_throughput(level[:5], level[:5])


def test_correlated_residuals_widen_the_interval():
    rng = np.random.default_rng(7)
    level = np.repeat(rng.uniform(-85, -50, 40), 10)
    noise = np.repeat(rng.normal(0, 1e6, 40), 10)
    fit = fit_throughput(level, model_bps(level, 1.8e6, -93.0, math.inf) + noise)
    assert fit.worth < 100

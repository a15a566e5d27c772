import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.errors import ConfigError
from linkrover.radio.path_loss import FreeSpace, ItuIndoor, LogDistance, TgnBreakpoint, TwoRay

MODELS = (
    LogDistance(rss_1m_dbm=-40.0, exponent=2.6),
    TwoRay(tx_power_dbm=20.0, frequency_mhz=2437.0, transmitter_height_m=0.5, receiver_height_m=1.5),
    FreeSpace(tx_power_dbm=20.0, frequency_mhz=5180.0),
    ItuIndoor(tx_power_dbm=20.0, frequency_mhz=2437.0, environment="office", floors=2),
    TgnBreakpoint(tx_power_dbm=20.0, frequency_mhz=5180.0, model="D"),
)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: type(m).__name__)
@given(distance=st.floats(0.1, 500.0))
def test_every_model_has_its_inverse_and_gives_the_same_for_floats_and_arrays(model, distance):
    rssi = model.rssi_dbm(distance)
    assert isinstance(rssi, float)
    assert model.distance_m(rssi) == pytest.approx(distance, rel=1e-9)
    array = model.rssi_dbm(np.array([distance, 2 * distance]))
    assert array[0] == pytest.approx(rssi)
    assert array[1] < array[0]
    assert model.distance_m(array) == pytest.approx([distance, 2 * distance])


def test_two_ray_is_free_space_before_the_crossover_and_falls_40_db_a_decade_after_it():
    model = TwoRay(tx_power_dbm=0.0, frequency_mhz=2400.0, transmitter_height_m=1.0, receiver_height_m=1.0)
    assert model.crossover_m == pytest.approx(4 * math.pi / model.wavelength_m)
    free = FreeSpace(tx_power_dbm=0.0, frequency_mhz=2400.0)
    assert model.rssi_dbm(10.0) == pytest.approx(free.rssi_dbm(10.0))
    far = 2 * model.crossover_m
    assert model.rssi_dbm(far) - model.rssi_dbm(10 * far) == pytest.approx(40.0)
    edge = model.crossover_m
    assert model.rssi_dbm(edge * 0.999999) == pytest.approx(model.rssi_dbm(edge * 1.000001), abs=1e-4)


def test_free_space_loses_46_7_db_in_the_first_metre_at_5_15_ghz_and_40_05_at_2_4():
    # the reference losses ns-3 uses
    assert FreeSpace(tx_power_dbm=0, frequency_mhz=5150).rssi_dbm(1.0) == pytest.approx(-46.68, abs=0.01)
    assert FreeSpace(tx_power_dbm=0, frequency_mhz=2400).rssi_dbm(1.0) == pytest.approx(-40.05, abs=0.01)


def test_itu_p1238_office_at_2437_mhz():
    model = ItuIndoor(tx_power_dbm=0, frequency_mhz=2437.0)
    assert model.rssi_dbm(10.0) == pytest.approx(-(20 * math.log10(2437) + 30 - 28))
    two = ItuIndoor(tx_power_dbm=0, frequency_mhz=2437.0, floors=2)
    assert two.floor_loss_db == 19.0
    assert two.shadowing_sigma_db == 12.0


def test_tgn_changes_slope_at_its_breakpoint():
    model = TgnBreakpoint(tx_power_dbm=0, frequency_mhz=5180.0, model="E")
    assert model.rssi_dbm(10.0) - model.rssi_dbm(20.0) == pytest.approx(20 * math.log10(2))
    assert model.rssi_dbm(20.0) - model.rssi_dbm(200.0) == pytest.approx(35.0)
    assert model.shadowing_sigma_db(5.0) == 3.0
    assert list(model.shadowing_sigma_db(np.array([5.0, 50.0]))) == [3.0, 6.0]


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: LogDistance(rss_1m_dbm=-40, exponent=0), r"log_distance\.exponent"),
        (lambda: LogDistance(rss_1m_dbm=math.nan, exponent=2), r"log_distance\.rss_1m_dbm"),
        (lambda: TwoRay(tx_power_dbm=0, frequency_mhz=-1, transmitter_height_m=1, receiver_height_m=1), "frequency"),
        (lambda: ItuIndoor(tx_power_dbm=0, frequency_mhz=2400, environment="barn"), "residential, office, commercial"),
        (lambda: TgnBreakpoint(tx_power_dbm=0, frequency_mhz=2400, model="Z"), "A, B, C, D, E, F"),
        (lambda: MODELS[0].rssi_dbm(0.0), "distance_m"),
        (lambda: MODELS[0].rssi_dbm(np.array([1.0, -2.0])), "distance_m"),
    ],
)
def test_bad_values_are_named(make, named):
    with pytest.raises(ConfigError, match=named):
        make()

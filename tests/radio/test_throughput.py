import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.errors import ConfigError
from linkrover.radio.mcs import MCS_TABLE, noise_floor_dbm, packet_error_rate, rate_bps
from linkrover.radio.presets import PRESETS, preset
from linkrover.radio.throughput import (
    ShannonShare,
    md1_wait_s,
    nodal_delay_s,
    shannon_capacity_bps,
    transmission_delay_s,
)


def test_capacity_at_0_db_is_one_bit_a_hertz():
    assert shannon_capacity_bps(20e6, -90.0, -90.0) == pytest.approx(20e6)
    assert shannon_capacity_bps(20e6, np.array([-90.0, -60.0]), -90.0)[1] == pytest.approx(20e6 * math.log2(1001))


@given(rssi=st.floats(-95, -40))
def test_throughput_has_its_inverse_below_the_cap(rssi):
    share = ShannonShare(alpha_b_hz=2e6, noise_dbm=-93.0, cap_bps=19e6)
    throughput = share.throughput_bps(rssi)
    assert throughput <= 19e6
    if throughput < 19e6:
        assert share.rssi_dbm(throughput) == pytest.approx(rssi, abs=1e-6)


def test_no_power_carries_more_than_the_cap():
    share = ShannonShare(alpha_b_hz=2e6, noise_dbm=-93.0, cap_bps=19e6)
    with pytest.raises(ConfigError, match="cap"):
        share.rssi_dbm(20e6)
    with pytest.raises(ConfigError, match="above 0"):
        share.rssi_dbm(np.array([1e6, 0.0]))


def test_a_message_takes_its_bits_over_the_throughput_and_the_other_parts_add():
    assert transmission_delay_s(1_250_000, 10e6) == pytest.approx(1.0)
    total = nodal_delay_s(1_250_000, 10e6, processing_s=0.1, queueing_s=0.2, distance_m=299_792_458)
    assert total == pytest.approx(2.3)
    with pytest.raises(ConfigError, match="octets"):
        transmission_delay_s(-1, 1e6)


def test_the_wait_of_an_md1_queue_is_half_that_of_an_mm1():
    assert md1_wait_s(0.001, 0.5) == pytest.approx(0.0005)
    with pytest.raises(ConfigError, match="utilisation"):
        md1_wait_s(0.001, 1.0)


def test_error_curves_pass_through_the_tables_points_and_scale_with_length():
    for entry in MCS_TABLE:
        assert packet_error_rate(entry.index, entry.snr_50_db) == pytest.approx(0.5)
        assert packet_error_rate(entry.index, entry.snr_10_db) == pytest.approx(0.1)
        short = packet_error_rate(entry.index, entry.snr_50_db, 729)
        assert short == pytest.approx(1 - math.sqrt(0.5))
        assert packet_error_rate(entry.index, entry.snr_50_db + 4, implementation_loss_db=4) == pytest.approx(0.5)
    assert packet_error_rate(9, -200.0) == 1.0


def test_rates_scale_with_width_and_streams_and_noise_doubles_with_width():
    assert rate_bps(7) == 72.2e6
    assert rate_bps(7, 40) == pytest.approx(150e6, rel=0.001)
    assert rate_bps(9, 80, 2) == pytest.approx(866.7e6, rel=0.001)
    assert noise_floor_dbm(20) == pytest.approx(-94.0)
    assert noise_floor_dbm(40) == pytest.approx(-91.0, abs=0.02)
    with pytest.raises(ConfigError, match="width_mhz"):
        rate_bps(0, 25)


def test_presets_are_found_by_name_and_an_unknown_one_lists_them():
    assert preset("internal-5").path_loss.exponent == 2.8
    with pytest.raises(ConfigError, match=", ".join(PRESETS)):
        preset("mesh")

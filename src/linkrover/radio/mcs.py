"""Modulation and coding schemes: PHY rate, packet error rate against SNR, airtime of a frame.

One spatial stream, 20 MHz, short guard interval (3.6 us symbols); other widths and streams scale from it.
Error curves: logistic through the 50 % and 10 % points for 1,458 octets with LDPC (link-level simulation figures),
other lengths by 1 - (1 - PER)^(L / 1458), that is: errors fall independently on the octets.

This module imports no numpy, because the emulator's medium stands on it; functions take floats.
"""

from __future__ import annotations

import math

import msgspec

from linkrover.errors import ConfigError

REFERENCE_OCTETS = 1458
SYMBOL_NS = 3600  # OFDM symbol with 0.4 us guard
WIDTH_FACTOR = {20: 1.0, 40: 54 / 26, 80: 234 / 52}  # data subcarriers 108/52 and 234/52: x2.08, x4.5


class Mcs(msgspec.Struct, frozen=True):
    """One scheme at 20 MHz and one stream. snr_50/snr_10: SNR (dB) of 50 % and 10 % packet error, 1,458 octets."""

    index: int
    rate_bps: float
    snr_50_db: float
    snr_10_db: float
    sensitivity_dbm: float  # what IEEE 802.11 asks of a receiver at 20 MHz
    modulation: str

    @property
    def slope_per_db(self) -> float:
        """Logistic slope k in PER = 1 / (1 + exp(k (SNR - SNR50)))."""
        return math.log(9.0) / (self.snr_10_db - self.snr_50_db)


MCS_TABLE: tuple[Mcs, ...] = (
    Mcs(0, 7.2e6, -1.0, -0.7, -82, "BPSK 1/2"),
    Mcs(1, 14.4e6, 2.0, 2.3, -79, "QPSK 1/2"),
    Mcs(2, 21.7e6, 4.5, 4.8, -77, "QPSK 3/4"),
    Mcs(3, 28.9e6, 7.5, 7.9, -74, "16-QAM 1/2"),
    Mcs(4, 43.3e6, 10.6, 10.9, -70, "16-QAM 3/4"),
    Mcs(5, 57.8e6, 14.8, 15.1, -66, "64-QAM 2/3"),
    Mcs(6, 65.0e6, 16.1, 16.5, -65, "64-QAM 3/4"),
    Mcs(7, 72.2e6, 17.6, 18.0, -64, "64-QAM 5/6"),
    Mcs(8, 86.7e6, 21.3, 21.6, -59, "256-QAM 3/4"),
    Mcs(9, 96.3e6, 23.1, 23.5, -57, "256-QAM 5/6"),
)


def _check(mcs: int, width_mhz: int, streams: int) -> None:
    if not 0 <= mcs < len(MCS_TABLE):
        raise ConfigError(f"mcs = {mcs}: must be 0 to {len(MCS_TABLE) - 1}")
    if width_mhz not in WIDTH_FACTOR:
        raise ConfigError(f"width_mhz = {width_mhz}: must be one of {', '.join(map(str, WIDTH_FACTOR))}")
    if not 1 <= streams <= 4:
        raise ConfigError(f"streams = {streams}: must be 1 to 4")


def rate_bps(mcs: int, width_mhz: int = 20, streams: int = 1) -> float:
    """PHY rate in bit/s.

    Raises:
        ConfigError: MCS, width or streams outside the table.
    """
    _check(mcs, width_mhz, streams)
    return MCS_TABLE[mcs].rate_bps * WIDTH_FACTOR[width_mhz] * streams


def required_snr_shift_db(streams: int) -> float:
    """How much more SNR `streams` streams need: the power is shared between them, 10 log10(streams)."""
    return 10.0 * math.log10(streams)


def log_success(mcs: int, snr_db: float) -> float:
    """ln(1 - PER) for 1,458 octets; times L / 1458 it is that of L octets."""
    entry = MCS_TABLE[mcs]
    x = -entry.slope_per_db * (snr_db - entry.snr_50_db)
    if x > 30.0:
        return -x
    return -math.log1p(math.exp(x))


def packet_error_rate(
    mcs: int, snr_db: float, octets: int = REFERENCE_OCTETS, implementation_loss_db: float = 0.0
) -> float:
    """Packet error rate, 0..1.

    Raises:
        ConfigError: MCS outside the table, or octets not positive.
    """
    _check(mcs, 20, 1)
    if octets <= 0:
        raise ConfigError(f"octets = {octets}: must be positive")
    return -math.expm1(log_success(mcs, snr_db - implementation_loss_db) * octets / REFERENCE_OCTETS)


def noise_floor_dbm(width_mhz: int = 20, noise_figure_db: float = 7.0) -> float:
    """Thermal noise -101 dBm in 20 MHz, +3 dB a doubling, plus the receiver's noise figure.

    Raises:
        ConfigError: width_mhz is not positive.
    """
    if width_mhz <= 0:
        raise ConfigError(f"width_mhz = {width_mhz}: must be positive")
    return -101.0 + 10.0 * math.log10(width_mhz / 20.0) + noise_figure_db


def payload_airtime_ns(octets: int, rate: float) -> int:
    """Airtime of `octets` at `rate` bit/s in whole symbols, with 16 service and 6 tail bits, without the preamble."""
    bits_per_symbol = rate * SYMBOL_NS / 1e9
    return math.ceil((octets * 8 + 22) / bits_per_symbol) * SYMBOL_NS


def legacy_airtime_ns(octets: int, rate: float) -> int:
    """Airtime of a non-HT OFDM frame (ACK, block ack, beacon): 20 us preamble and 4 us symbols."""
    return 20_000 + math.ceil((octets * 8 + 22) / (rate * 4e-6)) * 4000

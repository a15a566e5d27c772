"""Eq. 3-4: Shannon capacity and the share of it that a link gets; Eq. 5-6: delay of a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from linkrover.errors import ConfigError

from .values import dbm_to_mw, least, log2, mw_to_dbm, require_finite, require_not_negative, require_positive

if TYPE_CHECKING:
    from .values import Values


def snr(rssi_dbm: Values, noise_dbm: float) -> Values:
    """Signal-to-noise ratio as a ratio of powers."""
    return dbm_to_mw(rssi_dbm - noise_dbm)


def shannon_capacity_bps(bandwidth_hz: float, rssi_dbm: Values, noise_dbm: float) -> Values:
    """Eq. 3: C = B log2(1 + SNR), bit/s.

    Raises:
        ConfigError: bandwidth_hz is not above 0.
    """
    require_positive("capacity", bandwidth_hz=bandwidth_hz)
    return bandwidth_hz * log2(1.0 + snr(rssi_dbm, noise_dbm))


class ShannonShare(msgspec.Struct, frozen=True, kw_only=True):
    """Eq. 4 with a cap: T = min(cap, alpha_T B log2(1 + SNR)).

    alpha_b_hz is the product alpha_T * B. Throughput against RSSI can tell the product only: a link that gets half
    of 20 MHz behaves exactly like one that gets a quarter of 40 MHz. cap_bps None = no cap.

    Raises:
        ConfigError: alpha_b_hz or cap_bps is not above 0.
    """

    alpha_b_hz: float
    noise_dbm: float
    cap_bps: float | None = None

    def __post_init__(self) -> None:
        require_positive("throughput", alpha_b_hz=self.alpha_b_hz)
        require_finite("throughput", noise_dbm=self.noise_dbm)
        if self.cap_bps is not None:
            require_positive("throughput", cap_bps=self.cap_bps)

    def throughput_bps(self, rssi_dbm: Values) -> Values:
        """Throughput at received powers in dBm."""
        share = self.alpha_b_hz * log2(1.0 + snr(rssi_dbm, self.noise_dbm))
        return share if self.cap_bps is None else least(share, self.cap_bps)

    def rssi_dbm(self, throughput_bps: Values) -> Values:
        """Least received power that carries a throughput.

        Raises:
            ConfigError: a throughput is not above 0, or above the cap (no power carries it).
        """
        ok = throughput_bps > 0
        if not (ok if isinstance(ok, bool) else bool(ok.all())):
            raise ConfigError("throughput_bps: must be above 0 everywhere")
        if self.cap_bps is not None:
            over = throughput_bps > self.cap_bps
            if over if isinstance(over, bool) else bool(over.any()):
                raise ConfigError(f"throughput_bps: must be at most the cap, {self.cap_bps} bit/s")
        return self.noise_dbm + mw_to_dbm(2.0 ** (throughput_bps / self.alpha_b_hz) - 1.0)


def transmission_delay_s(octets: float, throughput_bps: Values) -> Values:
    """Eq. 6: d_trans = L / T, seconds, L in octets.

    Raises:
        ConfigError: octets is negative or a throughput not above 0.
    """
    require_not_negative("delay", octets=octets)
    ok = throughput_bps > 0
    if not (ok if isinstance(ok, bool) else bool(ok.all())):
        raise ConfigError("throughput_bps: must be above 0 everywhere")
    return octets * 8.0 / throughput_bps


def nodal_delay_s(
    octets: float,
    throughput_bps: Values,
    *,
    processing_s: float = 0.0,
    queueing_s: float = 0.0,
    distance_m: float = 0.0,
) -> Values:
    """Eq. 5: d = d_proc + d_queue + d_trans + d_prop, seconds.

    Raises:
        ConfigError: a part is negative.
    """
    require_not_negative("delay", processing_s=processing_s, queueing_s=queueing_s, distance_m=distance_m)
    return processing_s + queueing_s + transmission_delay_s(octets, throughput_bps) + distance_m / 299_792_458.0


def md1_wait_s(service_s: float, utilisation: float) -> float:
    """Mean wait before service of an M/D/1 queue (Pollaczek-Khinchine): rho D / (2 (1 - rho)).

    Raises:
        ConfigError: service_s is not above 0, or utilisation not in [0, 1).
    """
    require_positive("queue", service_s=service_s)
    if not 0 <= utilisation < 1:
        raise ConfigError(f"utilisation = {utilisation}: must be 0 to below 1")
    return utilisation * service_s / (2.0 * (1.0 - utilisation))

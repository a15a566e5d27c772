"""Mean received power against distance: Eq. 1 (two-ray), Eq. 2's mean (log-distance), ITU-R P.1238, TGn breakpoint.

Every model gives rssi_dbm(distance_m) and its inverse distance_m(rssi_dbm), for a float or an array.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol, cast

import msgspec

from linkrover.errors import ConfigError

from .values import (
    SPEED_OF_LIGHT_M_PER_S,
    log10,
    require_distance,
    require_finite,
    require_not_negative,
    require_positive,
    where,
)

if TYPE_CHECKING:
    from .values import Values


class PathLoss(Protocol):
    """A mean-power model."""

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm, at distances in metres."""
        ...

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Distance at which that power is received on average."""
        ...


class LogDistance(msgspec.Struct, frozen=True, kw_only=True, tag="log-distance"):
    """Eq. 2, mean: P(d) = rss_1m_dbm - 10 exponent log10(d / 1 m).

    Raises:
        ConfigError: exponent is not above 0, or rss_1m_dbm is not finite.
    """

    rss_1m_dbm: float
    exponent: float

    def __post_init__(self) -> None:
        require_positive("log_distance", exponent=self.exponent)
        require_finite("log_distance", rss_1m_dbm=self.rss_1m_dbm)

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm."""
        require_distance(distance_m)
        return self.rss_1m_dbm - 10.0 * self.exponent * log10(distance_m)

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Inverse."""
        return cast("Values", 10.0 ** ((self.rss_1m_dbm - rssi_dbm) / (10.0 * self.exponent)))


class TwoRay(msgspec.Struct, frozen=True, kw_only=True, tag="two-ray"):
    """Eq. 1, two-ray ground reflection: P = Pt + G + 10 log10(ht^2 hr^2 / d^4), d in metres.

    Before the crossover distance 4 pi ht hr / lambda, where the fourth-power law does not hold yet, free space
    (Friis): P = Pt + G + 20 log10(lambda / (4 pi d)). The two meet at the crossover, so the curve has no step.
    gain_db is the sum of both antennas' gains.

    Raises:
        ConfigError: a height or the frequency is not above 0.
    """

    tx_power_dbm: float
    frequency_mhz: float
    transmitter_height_m: float
    receiver_height_m: float
    gain_db: float = 0.0

    def __post_init__(self) -> None:
        require_positive(
            "two_ray",
            frequency_mhz=self.frequency_mhz,
            transmitter_height_m=self.transmitter_height_m,
            receiver_height_m=self.receiver_height_m,
        )
        require_finite("two_ray", tx_power_dbm=self.tx_power_dbm, gain_db=self.gain_db)

    @property
    def wavelength_m(self) -> float:
        """Wavelength."""
        return SPEED_OF_LIGHT_M_PER_S / (self.frequency_mhz * 1e6)

    @property
    def crossover_m(self) -> float:
        """Where free space ends and the fourth-power law begins."""
        return 4.0 * math.pi * self.transmitter_height_m * self.receiver_height_m / self.wavelength_m

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm."""
        require_distance(distance_m)
        power = self.tx_power_dbm + self.gain_db
        near = power + 20.0 * math.log10(self.wavelength_m / (4.0 * math.pi)) - 20.0 * log10(distance_m)
        far = power + self._far_constant() - 40.0 * log10(distance_m)
        return where(distance_m < self.crossover_m, near, far)

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Inverse."""
        power = self.tx_power_dbm + self.gain_db
        at_crossover = power + self._far_constant() - 40.0 * math.log10(self.crossover_m)
        near = self.wavelength_m / (4.0 * math.pi) * 10.0 ** ((power - rssi_dbm) / 20.0)
        far = 10.0 ** ((power + self._far_constant() - rssi_dbm) / 40.0)
        return where(rssi_dbm > at_crossover, near, far)

    def _far_constant(self) -> float:
        return 20.0 * math.log10(self.transmitter_height_m * self.receiver_height_m)


class FreeSpace(msgspec.Struct, frozen=True, kw_only=True, tag="free-space"):
    """Friis: P = Pt + G + 20 log10(lambda / (4 pi d)).

    Raises:
        ConfigError: the frequency is not above 0.
    """

    tx_power_dbm: float
    frequency_mhz: float
    gain_db: float = 0.0

    def __post_init__(self) -> None:
        require_positive("free_space", frequency_mhz=self.frequency_mhz)
        require_finite("free_space", tx_power_dbm=self.tx_power_dbm, gain_db=self.gain_db)

    def _at_1m_dbm(self) -> float:
        wavelength_m = SPEED_OF_LIGHT_M_PER_S / (self.frequency_mhz * 1e6)
        return self.tx_power_dbm + self.gain_db + 20.0 * math.log10(wavelength_m / (4.0 * math.pi))

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm."""
        require_distance(distance_m)
        return self._at_1m_dbm() - 20.0 * log10(distance_m)

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Inverse."""
        return cast("Values", 10.0 ** ((self._at_1m_dbm() - rssi_dbm) / 20.0))


ITU_COEFFICIENT = {"residential": 28.0, "office": 30.0, "commercial": 22.0}
ITU_SHADOWING_DB = {"residential": 8.0, "office": 12.0, "commercial": 10.0}


class ItuIndoor(msgspec.Struct, frozen=True, kw_only=True, tag="itu-p1238"):
    """ITU-R P.1238: L = 20 log10(f / MHz) + N log10(d) + Lf(floors) - 28, for d of 1 m and more.

    Raises:
        ConfigError: unknown environment, or a value out of range.
    """

    tx_power_dbm: float
    frequency_mhz: float
    environment: str = "office"
    floors: int = 0
    gain_db: float = 0.0

    def __post_init__(self) -> None:
        require_positive("itu_indoor", frequency_mhz=self.frequency_mhz)
        require_not_negative("itu_indoor", floors=self.floors)
        require_finite("itu_indoor", tx_power_dbm=self.tx_power_dbm, gain_db=self.gain_db)
        if self.environment not in ITU_COEFFICIENT:
            raise ConfigError(
                f"itu_indoor.environment = {self.environment!r}: must be one of {', '.join(ITU_COEFFICIENT)}"
            )

    @property
    def floor_loss_db(self) -> float:
        """Lf: 4n at home, 15 + 4(n - 1) in an office, 6 + 3(n - 1) in a shop; 0 on one floor."""
        n = self.floors
        if n == 0:
            return 0.0
        return {"residential": 4.0 * n, "office": 15.0 + 4.0 * (n - 1), "commercial": 6.0 + 3.0 * (n - 1)}[
            self.environment
        ]

    @property
    def shadowing_sigma_db(self) -> float:
        """Shadowing the recommendation gives for this environment."""
        return ITU_SHADOWING_DB[self.environment]

    def _constant(self) -> float:
        loss = 20.0 * math.log10(self.frequency_mhz) + self.floor_loss_db - 28.0
        return self.tx_power_dbm + self.gain_db - loss

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm."""
        require_distance(distance_m)
        return self._constant() - ITU_COEFFICIENT[self.environment] * log10(distance_m)

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Inverse."""
        return cast("Values", 10.0 ** ((self._constant() - rssi_dbm) / ITU_COEFFICIENT[self.environment]))


TGN_BREAKPOINT_M = {"A": 5.0, "B": 5.0, "C": 5.0, "D": 10.0, "E": 20.0, "F": 30.0}
TGN_SIGMA_AFTER_DB = {"A": 4.0, "B": 4.0, "C": 5.0, "D": 5.0, "E": 6.0, "F": 6.0}


class TgnBreakpoint(msgspec.Struct, frozen=True, kw_only=True, tag="tgn"):
    """IEEE 802.11 TGn channel models A to F: free space (slope 2) up to the breakpoint, slope 3.5 beyond.

    Raises:
        ConfigError: unknown model, or the frequency is not above 0.
    """

    tx_power_dbm: float
    frequency_mhz: float
    model: str = "D"
    gain_db: float = 0.0

    def __post_init__(self) -> None:
        require_positive("tgn", frequency_mhz=self.frequency_mhz)
        require_finite("tgn", tx_power_dbm=self.tx_power_dbm, gain_db=self.gain_db)
        if self.model not in TGN_BREAKPOINT_M:
            raise ConfigError(f"tgn.model = {self.model!r}: must be one of {', '.join(TGN_BREAKPOINT_M)}")

    @property
    def breakpoint_m(self) -> float:
        """Where the slope changes."""
        return TGN_BREAKPOINT_M[self.model]

    def shadowing_sigma_db(self, distance_m: Values) -> Values:
        """Shadowing: 3 dB before the breakpoint, 4 to 6 dB after it."""
        return where(distance_m < self.breakpoint_m, 3.0, TGN_SIGMA_AFTER_DB[self.model])

    def _free_space(self) -> FreeSpace:
        return FreeSpace(tx_power_dbm=self.tx_power_dbm, frequency_mhz=self.frequency_mhz, gain_db=self.gain_db)

    def rssi_dbm(self, distance_m: Values) -> Values:
        """Received power, dBm."""
        near = self._free_space().rssi_dbm(distance_m)
        beyond = log10(distance_m) - math.log10(self.breakpoint_m)
        return where(distance_m < self.breakpoint_m, near, near - 15.0 * beyond)

    def distance_m(self, rssi_dbm: Values) -> Values:
        """Inverse."""
        free = self._free_space()
        at_break = free.rssi_dbm(self.breakpoint_m)
        far = self.breakpoint_m * 10.0 ** ((at_break - rssi_dbm) / 35.0)
        return where(rssi_dbm > at_break, free.distance_m(rssi_dbm), far)


AnyPathLoss = LogDistance | TwoRay | FreeSpace | ItuIndoor | TgnBreakpoint

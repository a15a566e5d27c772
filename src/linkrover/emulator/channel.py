"""From the places of two nodes to the signal between them, both ways, as a pure function of time, place and seed.

channel = Channel(ChannelConfig(path_loss=LogDistance(rss_1m_dbm=-46.5, exponent=2.61)), seed=7)
there, back = channel.between(time_s, "robot", (x_m, y_m), "station", (0.0, 0.0))
channel.apply(medium, time_s, {"robot": (x_m, y_m), "station": (0.0, 0.0)})     # sets all links of a medium
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import msgspec

from linkrover.errors import ConfigError
from linkrover.radio.fading import MultipathField, ShadowField
from linkrover.radio.path_loss import AnyPathLoss, LogDistance
from linkrover.radio.values import require_not_negative, require_positive
from linkrover.radio.walls import FloorPlan

from .medium import Medium

NEAREST_M = 0.3  # nearer than this the models mean nothing; antennas are never closer in practice
STRONGEST_DBM = -20.0  # what adapters still report; nearer the receiver saturates


class ChannelConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Path loss, shadowing and multipath between any two nodes.

    sigma_db, decorrelation_m: log-normal shadowing with correlation exp(-d / decorrelation_m) in space.
    nakagami_m: multipath, None = none. direction_correlation: of the shadowing seen by the two directions (0.99 in
    the 2021 data). scene_hz: how fast the surroundings change while the robot stands. offset_db: added to every
    RSSI that the access point receives (its antenna or the station's power differs). site: seed of the shadowing, so
    that every trial in one building meets the same shadows; None = the trial's own.
    """

    path_loss: AnyPathLoss = LogDistance(rss_1m_dbm=-40.0, exponent=2.5)
    frequency_mhz: float = 2437.0
    sigma_db: float = 4.0
    decorrelation_m: float = 3.0
    nakagami_m: float | None = 2.0
    direction_correlation: float = 0.99
    scene_hz: float = 0.2
    offset_db: float = 0.0
    site: int | None = None
    plan: FloorPlan = FloorPlan()

    def __post_init__(self) -> None:
        require_positive("channel", frequency_mhz=self.frequency_mhz, decorrelation_m=self.decorrelation_m)
        require_not_negative("channel", sigma_db=self.sigma_db, scene_hz=self.scene_hz)
        if not 0 <= self.direction_correlation <= 1:
            raise ConfigError(f"channel.direction_correlation = {self.direction_correlation}: must be 0 to 1")
        if self.nakagami_m is not None and not 0.5 <= self.nakagami_m <= 1000:
            raise ConfigError(f"channel.nakagami_m = {self.nakagami_m}: must be 0.5 to 1000, or absent")


class Signal(NamedTuple):
    """What one end receives. mean_dbm: path loss and walls only; local_dbm: with shadowing; rssi_dbm: with fading."""

    rssi_dbm: float
    local_dbm: float
    mean_dbm: float
    distance_m: float
    walls: int


class _Pair:
    def __init__(self, config: ChannelConfig, seed: int, name: str) -> None:
        # crc32 and not hash(): the same seed gives the same field in every process
        pair = zlib.crc32(name.encode())
        place = (seed if config.site is None else config.site) * 1_000_003 + pair
        seed = seed * 1_000_003 + pair
        self.shadow = ShadowField(config.sigma_db, config.decorrelation_m, place)
        self.differs = ShadowField(config.sigma_db, config.decorrelation_m, place + 1, terms=48)
        self.multipath = (
            None
            if config.nakagami_m is None
            else MultipathField(config.nakagami_m, config.frequency_mhz, seed + 2, scene_hz=config.scene_hz)
        )


class Channel:
    """See the module's text. Fields of different pairs of nodes are independent."""

    def __init__(self, config: ChannelConfig, seed: int) -> None:
        self.config = config
        self._seed = seed
        self._pairs: dict[tuple[str, str], _Pair] = {}

    def between(
        self, time_s: float, a: str, a_xy: tuple[float, float], b: str, b_xy: tuple[float, float]
    ) -> tuple[Signal, Signal]:
        """(what b receives from a, what a receives from b)."""
        if a > b:
            back, there = self.between(time_s, b, b_xy, a, a_xy)
            return there, back
        config = self.config
        pair = self._pairs.get((a, b))
        if pair is None:
            pair = self._pairs[a, b] = _Pair(config, self._seed, f"{a}|{b}")
        ax, ay = a_xy
        bx, by = b_xy
        distance = math.hypot(ax - bx, ay - by)
        walls, wall_loss = config.plan.crossed(ax, ay, bx, by)
        mean = float(config.path_loss.rssi_dbm(max(distance, NEAREST_M))) - wall_loss
        common = pair.shadow.at(ax, ay, bx, by)
        rho = config.direction_correlation
        other = common if rho == 1 else rho * common + math.sqrt(1 - rho * rho) * pair.differs.at(ax, ay, bx, by)
        fade = 0.0 if pair.multipath is None else pair.multipath.at(time_s, ax, ay, bx, by)
        return (
            Signal(min(mean + common + fade, STRONGEST_DBM), mean + common, mean, distance, walls),
            Signal(min(mean + other + fade, STRONGEST_DBM), mean + other, mean, distance, walls),
        )

    def apply(
        self, medium: Medium, time_s: float, places: dict[str, tuple[float, float]]
    ) -> dict[tuple[str, str], Signal]:
        """Sets all links between the medium's access point and stations; returns the signal by (sender, receiver)."""
        point = medium.access_point
        signals: dict[tuple[str, str], Signal] = {}
        for station in medium.stations:
            up, down = self.between(time_s, station, places[station], point, places[point])
            if self.config.offset_db:
                up = up._replace(rssi_dbm=up.rssi_dbm + self.config.offset_db)
            for sender, receiver, signal in ((station, point, up), (point, station, down)):
                medium.set_link(
                    sender,
                    receiver,
                    rssi_dbm=signal.rssi_dbm,
                    distance_m=signal.distance_m,
                    walls=signal.walls,
                )
                signals[sender, receiver] = signal
        return signals

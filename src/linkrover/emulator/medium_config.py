"""Parameters of the shared medium and of the nodes on it."""

from __future__ import annotations

import math

import msgspec

from linkrover.errors import ConfigError
from linkrover.radio import mcs as phy

from .association import AssociationConfig


class NodeConfig(msgspec.Struct, frozen=True, kw_only=True):
    """One node. queue_packets, queue_octets: bound of its driver queue towards each peer. queue: "drop-tail" or
    "fair" (like fq_codel). bus_bps: what its adapter's bus or firmware can move, None = no limit.
    """

    queue_packets: int = 256
    queue_octets: int | None = None
    queue: str = "drop-tail"
    bus_bps: float | None = None

    def __post_init__(self) -> None:
        if self.queue_packets <= 0:
            raise ConfigError(f"queue_packets = {self.queue_packets}: must be 1 or more")
        if self.queue_octets is not None and self.queue_octets < 1500:
            raise ConfigError(f"queue_octets = {self.queue_octets}: must be 1500 or more")
        if self.queue not in ("drop-tail", "fair"):
            raise ConfigError(f"queue = {self.queue!r}: must be one of drop-tail, fair")
        if self.bus_bps is not None and self.bus_bps <= 0:
            raise ConfigError(f"bus_bps = {self.bus_bps}: must be positive")


class MediumConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The channel. Times of IEEE 802.11-2020 (OFDM PHY, best effort access category: DIFS = SIFS + 2 slots).

    implementation_loss_db: how much worse a real receiver is than the error curves (3 to 5). preamble_ns: HT mixed
    format, one stream. txop_limit_ns: longest data transmission. others_share: share of air time that other users of
    the channel take, whatever we do, in bursts of others_burst_ns on average. fading_m: Nakagami m of an independent
    draw for each transmission, None = the RSSI given by set_link() already holds the fading. random_backoff False
    takes the mean back-off each time. encrypted: 16 octets CCMP a frame.
    """

    band_ghz: float = 2.4
    width_mhz: int = 20
    streams: int = 1
    max_mcs: int = 7
    noise_dbm: float = -94.0
    implementation_loss_db: float = 4.0
    cw_min: int = 15
    cw_max: int = 1023
    retry_limit: int = 7
    max_subframes: int = 32
    max_aggregate_octets: int = 65_535
    txop_limit_ns: int = 4_000_000
    others_share: float = 0.0
    others_burst_ns: int = 1_000_000
    fading_m: float | None = None
    random_backoff: bool = True
    encrypted: bool = True
    fixed_mcs: int | None = None
    association: AssociationConfig = AssociationConfig()

    def __post_init__(self) -> None:
        def need(ok: bool, key: str, allowed: str) -> None:
            if not ok:
                raise ConfigError(f"medium.{key} = {getattr(self, key)}: must be {allowed}")

        need(self.band_ghz in (2.4, 5.0, 6.0), "band_ghz", "2.4, 5.0 or 6.0")
        need(self.width_mhz in phy.WIDTH_FACTOR, "width_mhz", "20, 40 or 80")
        need(1 <= self.streams <= 4, "streams", "1 to 4")
        need(0 <= self.max_mcs < len(phy.MCS_TABLE), "max_mcs", f"0 to {len(phy.MCS_TABLE) - 1}")
        need(self.fixed_mcs is None or 0 <= self.fixed_mcs <= self.max_mcs, "fixed_mcs", "0 to max_mcs, or absent")
        need(math.isfinite(self.noise_dbm), "noise_dbm", "a finite number of dBm")
        need(self.implementation_loss_db >= 0, "implementation_loss_db", "0 or more")
        need(0 <= self.cw_min <= self.cw_max, "cw_min", "0 to cw_max")
        need(self.retry_limit >= 0, "retry_limit", "0 or more")
        need(1 <= self.max_subframes <= 64, "max_subframes", "1 to 64")
        need(self.max_aggregate_octets >= 2048, "max_aggregate_octets", "2048 or more")
        need(self.txop_limit_ns > 0, "txop_limit_ns", "positive")
        need(0 <= self.others_share < 1, "others_share", "0 to below 1")
        need(self.others_burst_ns > 0, "others_burst_ns", "positive")
        need(self.fading_m is None or self.fading_m >= 0.5, "fading_m", "0.5 or more, or absent")

    @property
    def slot_ns(self) -> int:
        """Slot time (short slot)."""
        return 9_000

    @property
    def sifs_ns(self) -> int:
        """Short inter-frame space."""
        return 10_000 if self.band_ghz == 2.4 else 16_000

    @property
    def difs_ns(self) -> int:
        """SIFS + 2 slots, with the 6 us signal extension of OFDM at 2.4 GHz."""
        return self.sifs_ns + 2 * self.slot_ns + (6_000 if self.band_ghz == 2.4 else 0)

    @property
    def preamble_ns(self) -> int:
        """HT mixed format: 20 us legacy part, HT-SIG, HT-STF and one HT-LTF a stream."""
        return 32_000 + 4_000 * self.streams

    @property
    def overhead_octets(self) -> int:
        """QoS header 26, LLC/SNAP 8, FCS 4, CCMP 16 when encrypted."""
        return 38 + (16 if self.encrypted else 0)

    @property
    def basic_rate_bps(self) -> float:
        """Rate of beacons and multicasts: 1 Mbit/s DSSS at 2.4 GHz, 6 Mbit/s OFDM above."""
        return 1e6 if self.band_ghz == 2.4 else 6e6

    def basic_airtime_ns(self, octets: int) -> int:
        """Airtime of a frame of `octets` in all at the basic rate (DSSS: 192 us long preamble)."""
        if self.band_ghz == 2.4:
            return 192_000 + octets * 8_000
        return phy.legacy_airtime_ns(octets, 6e6)

    @property
    def beacon_airtime_ns(self) -> int:
        """A beacon of 250 octets with its inter-frame space."""
        return self.basic_airtime_ns(250) + self.difs_ns

"""Association of a station with its access point: lost after missed beacons, won again by scanning."""

from __future__ import annotations

import random

import msgspec

from linkrover.errors import ConfigError


class AssociationConfig(msgspec.Struct, frozen=True, kw_only=True):
    """beacon_ns: 102.4 ms (100 TU). missed_beacons: so many in a row end the association (mac80211 asks the access
    point after 7 and gives up about half a second later: 12). scan_ns: one scan over the channels; after it the
    station tries to join, and scans again after pause_ns when it hears no beacon or the hand-shake fails.
    join_ns: authentication, association and key hand-shake. failed_frames: so many frames in a row given up by the
    sender after all retries end the association too (hostapd disconnects a station after 50); 0 = never.

    drop_out_up_ns, drop_out_down_ns: an adapter that fails by itself: mean time until it does, and mean time it then
    stays silent before it scans again; 0 = never. Both times are drawn evenly within 50 % of the mean.
    """

    beacon_ns: int = 102_400_000
    missed_beacons: int = 12
    scan_ns: int = 1_500_000_000
    pause_ns: int = 1_000_000_000
    join_ns: int = 250_000_000
    failed_frames: int = 50
    drop_out_up_ns: int = 0
    drop_out_down_ns: int = 0

    def __post_init__(self) -> None:
        for key in ("beacon_ns", "missed_beacons", "scan_ns"):
            if getattr(self, key) <= 0:
                raise ConfigError(f"association.{key} = {getattr(self, key)}: must be positive")
        for key in ("pause_ns", "join_ns", "failed_frames", "drop_out_up_ns", "drop_out_down_ns"):
            if getattr(self, key) < 0:
                raise ConfigError(f"association.{key} = {getattr(self, key)}: must be 0 or more")


class Association:
    """State machine of one station. The medium calls `beacon` at every beacon time and `step` at `due_ns`."""

    def __init__(self, station: str, config: AssociationConfig, rng: random.Random, start_ns: int = 0) -> None:
        self.station = station
        self.config = config
        self._rng = rng
        self.associated = True
        self.missed = 0
        self.failed = 0
        self.due_ns: int | None = None
        self.lost_at_ns: int | None = None
        self.losses = 0
        self._joining = False
        self._plan_drop_out(start_ns)

    def _plan_drop_out(self, now_ns: int) -> None:
        if self.config.drop_out_up_ns:
            self.due_ns = now_ns + self._around(self.config.drop_out_up_ns)

    def _around(self, mean_ns: int) -> int:
        return int(mean_ns * self._rng.uniform(0.5, 1.5))

    def beacon(self, now_ns: int, heard: bool) -> bool:
        """A beacon was or was not heard; True when that ended the association."""
        if not self.associated:
            return False
        self.missed = 0 if heard else self.missed + 1
        if self.missed >= self.config.missed_beacons:
            self._lose(now_ns)
            return True
        return False

    def frame(self, now_ns: int, given_up: int, delivered: int) -> bool:
        """Frames given up after all retries, frames delivered; True when that ended the association."""
        if delivered:
            self.failed = 0
        self.failed += given_up
        if self.associated and self.config.failed_frames and self.failed >= self.config.failed_frames:
            self._lose(now_ns)
            return True
        return False

    def drop_out(self, now_ns: int) -> None:
        """At due_ns while associated: the adapter fails by itself."""
        self._lose(now_ns)
        self.due_ns = now_ns + self._around(self.config.drop_out_down_ns) + self.config.scan_ns

    def _lose(self, now_ns: int) -> None:
        self.associated = False
        self.lost_at_ns = now_ns
        self.losses += 1
        self.missed = self.failed = 0
        self._joining = False
        self.due_ns = now_ns + self.config.scan_ns

    def step(self, now_ns: int, reachable: bool) -> bool:
        """At due_ns: the scan has ended, or the hand-shake; `reachable`: beacon and hand-shake frames came through.

        True when the station is associated again.
        """
        if not reachable:
            self._joining = False
            self.due_ns = now_ns + self.config.pause_ns + self.config.scan_ns
            return False
        if not self._joining:
            self._joining = True
            self.due_ns = now_ns + self.config.join_ns
            return False
        self._joining = False
        self.associated = True
        self.due_ns = None
        self._plan_drop_out(now_ns)
        return True

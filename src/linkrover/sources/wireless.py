"""The wireless link of one interface, by whichever way the kernel gives it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Bitrate, Now, Record, Unknown, WirelessLink, now

from .interface import InterfaceSocket, InterfaceWatch
from .kept import SourceUnavailableError
from .wext import PATH, WirelessCounters, WirelessFileReader
from .wext_ioctl import WirelessIoctls, WirelessSettings

_SETTINGS_PERIOD_NS = 1_000_000_000  # SSID, frequency and power change seldom
_READINGS = ("rssi_dbm", "noise_dbm", "link_quality", "tx_failed", "missed_beacons")


class WirelessSource(Protocol):
    """A way to the link state of one interface: WirelessLink, per peer on an access point, and what else it gives."""

    last_error: LinkRoverError | None

    def sample(self) -> Sequence[Record]:
        """The link now; empty when the interface is not a wireless one. Raises nothing."""
        ...

    def close(self) -> None:
        """Give back what was opened."""
        ...


class WextSource:
    """Link state from /proc/net/wireless and the wireless-extension ioctls.

    A line exists only for an associated station. Without one, the mode tells a station that is not connected from an
    access point, of which wireless extensions say nothing. With `path` given, the file alone is read, and a line that
    was there and vanished means not connected.
    """

    def __init__(
        self, watch: InterfaceWatch, *, path: str | None = None, sockets: InterfaceSocket | None = None
    ) -> None:
        self._watch = watch
        self._forced = path is not None
        self._file = WirelessFileReader(path or PATH)
        self._ioctls = None if self._forced else WirelessIoctls(sockets)
        self._settings = WirelessSettings()
        self._wireless = self._forced
        self._settings_due_ns = 0
        self._settings_epoch = -1
        self._line_seen = False
        self.last_error: LinkRoverError | None = None

    def sample(self) -> list[WirelessLink]:
        """The link now; empty when the interface is not a wireless one."""
        self.last_error = None
        iface = self._watch.iface
        place = self._watch.look()
        stamp = now()
        if place.index is None and not self._forced:
            self._line_seen = False
            if not self._wireless:
                return []
            return [self._nothing(stamp, None, Unknown.ABSENT)]
        name = iface if self._forced else place.name
        try:
            line = self._file.read().get(name)
        except (SourceUnavailableError, ParseError) as error:
            self.last_error = error
            reason = error.reason if isinstance(error, SourceUnavailableError) else Unknown.UNSUPPORTED
            self._refresh(name, place.epoch)
            if not self._wireless:
                self.last_error = None
                return []
            return [self._nothing(stamp, None, reason)]
        connected_changed = (line is not None) != self._line_seen
        if connected_changed:
            self._settings_due_ns = 0
        self._refresh(name, place.epoch)
        if line is None:
            was_seen, self._line_seen = self._line_seen, self._line_seen and self._forced
            if not self._wireless:
                return []
            if was_seen or self._settings.mode in {"station", "ibss", "mesh"}:
                return [self._nothing(stamp, False, Unknown.NOT_CONNECTED)]
            return [self._nothing(stamp, None, Unknown.UNSUPPORTED)]
        self._line_seen = self._wireless = True
        return [self._link(stamp, line)]

    def close(self) -> None:
        """Give back the file descriptor and the socket."""
        self._file.close()

    def _refresh(self, name: str, epoch: int) -> None:
        now_ns = time.monotonic_ns()
        if self._ioctls is None or (now_ns < self._settings_due_ns and epoch == self._settings_epoch):
            return
        self._settings_due_ns, self._settings_epoch = now_ns + _SETTINGS_PERIOD_NS, epoch
        self._wireless = self._ioctls.is_wireless(name)
        try:
            self._settings = self._ioctls.read(name) if self._wireless else WirelessSettings()
        except ParseError as error:
            self.last_error = error

    def _link(self, stamp: Now, line: WirelessCounters) -> WirelessLink:
        settings = self._settings
        unknown = self._settings_unknown()
        if line.level_dbm is None:
            unknown["rssi_dbm"] = Unknown.UNSUPPORTED
        if line.noise_dbm is None:
            unknown["noise_dbm"] = Unknown.UNSUPPORTED
        # cfg80211 never fills this column in (cfg80211_wireless_stats, net/wireless/wext-compat.c): its 0 says nothing
        missed_beacons = line.missed_beacons if line.missed_beacons or self._forced else None
        if missed_beacons is None:
            unknown["missed_beacons"] = Unknown.UNSUPPORTED
        return WirelessLink(
            wall_ns=stamp.wall_ns,
            mono_ns=stamp.mono_ns,
            unknown=unknown,
            iface=self._watch.iface,
            source="wext",
            connected=True,
            mode=settings.mode,
            ssid=settings.ssid,
            bssid=settings.bssid,
            frequency_mhz=settings.frequency_mhz,
            tx_power_dbm=settings.tx_power_dbm,
            rssi_dbm=line.level_dbm,
            noise_dbm=line.noise_dbm,
            link_quality=line.quality,
            link_quality_max=settings.quality_max,
            tx_bitrate=None if settings.bitrate_bps is None else Bitrate(rate_bps=settings.bitrate_bps),
            tx_failed=line.gave_up,
            missed_beacons=missed_beacons,
            power_save=settings.power_save,
        )

    def _nothing(self, stamp: Now, connected: bool | None, reason: Unknown) -> WirelessLink:
        settings = self._settings
        unknown = {**self._settings_unknown(), **dict.fromkeys(_READINGS, reason)}
        if connected is None:
            unknown["connected"] = reason
        return WirelessLink(
            wall_ns=stamp.wall_ns,
            mono_ns=stamp.mono_ns,
            unknown=unknown,
            iface=self._watch.iface,
            source="wext",
            connected=connected,
            mode=settings.mode,
            ssid=settings.ssid,
            frequency_mhz=settings.frequency_mhz,
            tx_power_dbm=settings.tx_power_dbm,
            power_save=settings.power_save,
        )

    def _settings_unknown(self) -> dict[str, Unknown]:
        fields = ("mode", "ssid", "bssid", "frequency_mhz", "tx_power_dbm", "power_save")
        return {field: Unknown.UNSUPPORTED for field in fields if getattr(self._settings, field) is None}


def open_wireless_source(
    watch: InterfaceWatch, *, path: str | None = None, sockets: InterfaceSocket | None = None
) -> WirelessSource:
    """The best way to this interface's link state: nl80211 where the kernel has it, wireless extensions otherwise.

    `path` forces the text format of /proc/net/wireless from that file (an emulated driver's).
    """
    if path is not None:
        return WextSource(watch, path=path, sockets=sockets)
    from .radio import RadioSource  # it falls back on the class above

    return RadioSource(watch, sockets=sockets)

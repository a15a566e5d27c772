"""The radio of one interface for the agent: nl80211 first, wireless extensions where the kernel has no more."""

from __future__ import annotations

import errno
import time
from pathlib import Path

from ..errors import LinkRoverError, ParseError
from ..records import RadioCapability, Record, Unknown, WirelessLink, now
from .genetlink import FamilyAbsentError
from .interface import InterfaceSocket, InterfaceWatch
from .netlink import NetlinkError
from .nl80211 import GONE, Nl80211
from .wireless import WextSource

_TRY_AGAIN_NS = 5_000_000_000  # a driver may be loaded later
_REASONS = {
    errno.ETIMEDOUT: Unknown.TIMED_OUT,
    errno.EPERM: Unknown.NOT_PERMITTED,
    errno.EACCES: Unknown.NOT_PERMITTED,
}
_READINGS = ("connected", "rssi_dbm", "noise_dbm", "link_quality", "tx_failed", "missed_beacons")


class RadioSource:
    """WirelessLink, StationLink, ChannelSurvey and, when it changed, RadioCapability of one interface.

    The `source` field of a link says which way it came: "nl80211", or "wext" where this kernel or driver has no
    nl80211.
    """

    def __init__(self, watch: InterfaceWatch, *, sockets: InterfaceSocket | None = None) -> None:
        self._watch = watch
        self._wext = WextSource(watch, path=None, sockets=sockets)
        self._nl: Nl80211 | None = None
        self._try_ns = 0
        self._not_here: tuple[int | None, int] | None = None  # the device nl80211 does not know
        self._was_wireless = False
        self._told: tuple[str, ...] = ()
        self._tell_ns = 0
        self.last_error: LinkRoverError | None = None

    def sample(self) -> list[Record]:
        """All that is known now; empty when the interface is not a wireless one. Raises nothing."""
        self.last_error = None
        place = self._watch.look()
        nl = self._open()
        device = (place.index, place.epoch)
        if nl is None or device == self._not_here:
            return self._by_extensions()
        at = now()
        if place.index is None:
            return [self._unreadable(Unknown.ABSENT)] if self._was_wireless else []
        try:
            found = nl.read_index(self._watch.iface, place.index, at)
        except NetlinkError as error:
            # Wired, or moved to another namespace in this very moment; or a driver that does not tell of its peers.
            if error.code in (*GONE, errno.EOPNOTSUPP):
                self._not_here = device
                return self._by_extensions()
            self.last_error = error
            return [self._unreadable(_REASONS.get(error.code, Unknown.UNSUPPORTED))]
        except ParseError as error:
            self.last_error = error
            return [self._unreadable(Unknown.UNSUPPORTED)]
        self._was_wireless = True
        return [*found.links, *found.stations, *found.surveys, *self._capability(nl, at.mono_ns, place.name)]

    def refresh(self) -> None:
        """An event says that something rare changed: ask it again at the next sample."""
        self._not_here = None
        if self._nl is not None:
            self._nl.refresh(self._watch.iface)

    def close(self) -> None:
        """Give back what was opened."""
        self._wext.close()
        if self._nl is not None:
            self._nl.close()

    def _open(self) -> Nl80211 | None:
        if self._nl is None and time.monotonic_ns() >= self._try_ns:
            self._try_ns = time.monotonic_ns() + _TRY_AGAIN_NS
            try:
                self._nl = Nl80211()
            except FamilyAbsentError:
                return None  # no wireless driver is loaded: nothing is wrong
            except LinkRoverError as error:
                self.last_error = error
        return self._nl

    def _by_extensions(self) -> list[Record]:
        records: list[Record] = list(self._wext.sample())
        self.last_error = self.last_error or self._wext.last_error
        return records

    def _unreadable(self, reason: Unknown) -> WirelessLink:
        at = now()
        unknown = dict.fromkeys(_READINGS, reason)
        return WirelessLink(
            wall_ns=at.wall_ns, mono_ns=at.mono_ns, iface=self._watch.iface, source="nl80211", unknown=unknown
        )

    def _capability(self, nl: Nl80211, mono_ns: int, name: str) -> list[RadioCapability]:
        if mono_ns < self._tell_ns:
            return []
        self._tell_ns = mono_ns + 1_000_000_000
        found = nl.capability(self._watch.iface, driver_name(name))
        if not found.given or found.given == self._told:
            return []
        self._told = found.given
        return [found]


def driver_name(iface: str) -> str | None:
    """The kernel driver of an interface, from sysfs; None for a device without one."""
    link = Path("/sys/class/net") / iface / "device" / "driver"
    try:
        return link.readlink().name
    except OSError:
        return None

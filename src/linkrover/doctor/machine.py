"""Facts about this machine, read where the kernel keeps them; the roots can be moved for tests."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

import msgspec

from linkrover.errors import LinkRoverError
from linkrover.probe import stamps
from linkrover.records import ChannelSurvey, StationLink, WirelessLink
from linkrover.sources.ethtool import DriverInfo, EthtoolReader
from linkrover.sources.genetlink import FamilyAbsentError
from linkrover.sources.interface import InterfaceSocket
from linkrover.sources.nl80211 import Nl80211
from linkrover.sources.wext import PATH as WIRELESS_PATH
from linkrover.sources.wext import parse_wireless
from linkrover.sources.wext_ioctl import WirelessIoctls

IFF_MULTICAST = 0x1000


class Radio(msgspec.Struct, frozen=True, kw_only=True):
    """A wireless interface as it is now. source: "nl80211" or "wext"."""

    iface: str
    source: str
    mode: str | None = None
    link: WirelessLink | None = None
    rssi_dbm: float | None = None
    frequency_mhz: int | None = None
    width_mhz: int | None = None
    power_save: bool | None = None
    stations: tuple[StationLink, ...] = ()
    surveys: tuple[ChannelSurvey, ...] = ()
    alpha2: str | None = None
    dfs_region: str | None = None


class Machine:
    """Reads facts; what is not there is None."""

    def __init__(self, proc: Path = Path("/proc"), sys: Path = Path("/sys"), dev: Path = Path("/dev")) -> None:
        self.proc, self.sys, self.dev = proc, sys, dev

    def text(self, path: Path) -> str | None:
        """A small file without surrounding white space."""
        try:
            return path.read_bytes()[:65_536].decode("utf-8", "backslashreplace").strip()
        except OSError:
            return None

    def sysctl(self, name: str) -> str | None:
        """A sysctl by its dotted name."""
        return self.text(self.proc / "sys" / name.replace(".", "/"))

    def interfaces(self) -> list[str]:
        """Network devices, by name."""
        try:
            return sorted(
                entry.name for entry in (self.sys / "class/net").iterdir() if entry.is_symlink() or entry.is_dir()
            )
        except OSError:
            return []

    def is_wireless(self, iface: str) -> bool:
        """Whether an interface is a radio's."""
        return any((self.sys / "class/net" / iface / name).exists() for name in ("phy80211", "wireless"))

    def index(self, iface: str) -> int | None:
        """Interface index."""
        return _number(self.text(self.sys / "class/net" / iface / "ifindex"))

    def mtu(self, iface: str) -> int | None:
        """Largest packet, octets."""
        return _number(self.text(self.sys / "class/net" / iface / "mtu"))

    def multicast(self, iface: str) -> bool | None:
        """Whether the interface takes part in multicast."""
        flags = _number(self.text(self.sys / "class/net" / iface / "flags"))
        return None if flags is None else bool(flags & IFF_MULTICAST)

    def clock_source(self) -> str | None:
        """The kernel's clock source."""
        return self.text(self.sys / "devices/system/clocksource/clocksource0/current_clocksource")

    def bluetooth(self) -> tuple[list[str], bool | None]:
        """Bluetooth controllers, and whether all of them are switched off (rfkill)."""
        folder = self.sys / "class/bluetooth"
        try:
            names = sorted(entry.name for entry in folder.iterdir() if ":" not in entry.name)
        except OSError:
            return [], None
        states = []
        for name in names:
            try:
                switches = [entry for entry in (folder / name).iterdir() if entry.name.startswith("rfkill")]
            except OSError:
                continue
            states += ["1" in (self.text(s / "soft"), self.text(s / "hard")) for s in switches]
        return names, all(states) if states else None

    def capabilities(self) -> int:
        """Effective capabilities of this process, as a bit set."""
        for line in (self.text(self.proc / "self/status") or "").splitlines():
            if line.startswith("CapEff:"):
                return int(line.split()[1], 16)
        return 0

    def driver(self, iface: str) -> DriverInfo:
        """Driver, version, firmware by ethtool; the driver's name alone from sysfs where ethtool says nothing."""
        sockets = InterfaceSocket()
        try:
            return EthtoolReader(sockets).driver(iface)
        except LinkRoverError:
            link = self.sys / "class/net" / iface / "device/driver"
            return DriverInfo(link.resolve().name if link.exists() else None, None, None, None)
        finally:
            sockets.close()

    def tunnel(self) -> tuple[bool, bool]:
        """/dev/net/tun: there, usable."""
        path = self.dev / "net/tun"
        return path.exists(), os.access(path, os.R_OK | os.W_OK)

    def kernel_stamps(self) -> bool:
        """Whether a UDP socket gets kernel send and receive stamps."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            return stamps.wants_send_stamps(sock)

    def radio(self, iface: str) -> Radio | None:
        """The radio of an interface, None where it is not wireless. By nl80211, else by the wireless extensions.

        Raises:
            LinkRoverError: it is there but cannot be read.
        """
        try:
            nl80211 = Nl80211(slow_period_ns=0)
        except FamilyAbsentError:
            return self._by_extensions(iface)
        try:
            if iface not in [one.name for one in nl80211.interfaces()]:
                return self._by_extensions(iface)
            info = nl80211.interface(iface)
            sample = nl80211.read(iface)
            link = sample.links[0]
            country = nl80211.regulatory(info.wiphy)
            return Radio(
                iface=iface,
                source="nl80211",
                mode=info.mode,
                link=link,
                rssi_dbm=link.rssi_dbm,
                frequency_mhz=link.frequency_mhz or info.frequency_mhz,
                width_mhz=link.width_mhz or info.width_mhz,
                power_save=link.power_save,
                stations=sample.stations,
                surveys=sample.surveys,
                alpha2=country.alpha2,
                dfs_region=country.dfs_region,
            )
        finally:
            nl80211.close()

    def busy(self, iface: str) -> float | None:
        """Busy share of the channel over half a second, None where the driver does not give it."""
        nl80211 = Nl80211(slow_period_ns=0)
        try:
            nl80211.read(iface)
            time.sleep(0.5)
            surveys = nl80211.read(iface).surveys
        finally:
            nl80211.close()
        return next((s.utilization for s in surveys if s.in_use and s.utilization is not None), None)

    def _by_extensions(self, iface: str) -> Radio | None:
        sockets = InterfaceSocket()
        try:
            ioctls = WirelessIoctls(sockets)
            text = self.text(self.proc / "net/wireless")
            lines = {} if text is None else parse_wireless(text.encode() + b"\n", WIRELESS_PATH)
            if not ioctls.is_wireless(iface) and iface not in lines:
                return None
            settings = ioctls.read(iface)
        finally:
            sockets.close()
        line = lines.get(iface)
        return Radio(
            iface=iface,
            source="wext",
            mode=settings.mode,
            rssi_dbm=None if line is None or line.level_dbm is None else float(line.level_dbm),
            frequency_mhz=settings.frequency_mhz,
            power_save=settings.power_save,
            alpha2=self.text(self.sys / "module/cfg80211/parameters/ieee80211_regdom"),
        )


def _number(text: str | None) -> int | None:
    try:
        return None if text is None else int(text, 0)
    except ValueError:
        return None

"""What a recording says of the machine it was made on."""

from __future__ import annotations

import array
import os
import socket
import struct
import sys
from collections.abc import Iterable
from typing import NamedTuple

from linkrover import __version__
from linkrover.errors import LinkRoverError
from linkrover.probe.stamps import clock_error
from linkrover.records import Interface, Manifest, now
from linkrover.sources.ethtool import DriverInfo, EthtoolReader
from linkrover.sources.interface import InterfaceSocket
from linkrover.sources.nl80211 import Nl80211
from linkrover.sources.wext_ioctl import WirelessIoctls

from .config import AgentConfig, to_toml

SIOCGIFCONF = 0x8912
_IFREQ_BYTES = 40 if struct.calcsize("P") == 8 else 32

# Those that change what a link's figures mean, or that people with robots on Wi-Fi are told to change.
SYSCTLS = (
    "net.core.default_qdisc",
    "net.core.netdev_max_backlog",
    "net.core.rmem_default",
    "net.core.rmem_max",
    "net.core.wmem_default",
    "net.core.wmem_max",
    "net.ipv4.conf.all.rp_filter",
    "net.ipv4.ip_forward",
    "net.ipv4.ipfrag_high_thresh",
    "net.ipv4.ipfrag_time",
    "net.ipv4.tcp_congestion_control",
    "net.ipv4.tcp_ecn",
    "net.ipv4.tcp_mtu_probing",
    "net.ipv4.tcp_rmem",
    "net.ipv4.tcp_slow_start_after_idle",
    "net.ipv4.tcp_wmem",
)


def collect_manifest(config: AgentConfig, *, middleware: str | None = None) -> Manifest:
    """The manifest of an agent that starts now. What the machine does not tell is left None."""
    stamp = now()
    system = os.uname()
    values = ((name, _text(f"/proc/sys/{name.replace('.', '/')}")) for name in SYSCTLS)
    return Manifest(
        wall_ns=stamp.wall_ns,
        mono_ns=stamp.mono_ns,
        linkrover_version=__version__,
        role=config.role,
        host=system.nodename,
        kernel=system.release,
        machine=system.machine,
        python=sys.version.split()[0],
        boot_id=_text("/proc/sys/kernel/random/boot_id"),
        clock_source=_text("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        interfaces=collect_interfaces(config.interfaces),
        peer=", ".join(config.peers) or None,
        middleware=middleware,
        sysctls={name: value for name, value in values if value is not None},
        case=config.case,
        trial=config.trial,
        run=config.run,
        emulated=config.emulated,
        config=to_toml(config),
        notes={**_circumstances(), **config.notes},
    )


def _circumstances() -> dict[str, str]:
    """Which network namespace this is, and whether the wall clock follows an outside source (adjtimex)."""
    found = {}
    try:
        found["network_namespace"] = os.readlink("/proc/thread-self/ns/net")  # noqa: PTH115
    except OSError:
        found["network_namespace"] = "unknown"
    error = clock_error()
    found["wall_clock"] = (
        f"synchronised, error below {error.error_ns / 1e6:.1f} ms" if error.synchronized else "not synchronised"
    )
    return found


def collect_interfaces(names: Iterable[str]) -> tuple[Interface, ...]:
    """The named interfaces as they are now; one that is not there has only its name."""
    sockets = InterfaceSocket()
    try:
        ethtool = EthtoolReader(sockets)
        wireless = WirelessIoctls(sockets)
        addresses = local_addresses()
        found = []
        for name in names:
            driver = _driver(ethtool, name)
            radio = _radio(name, wireless)
            found.append(
                Interface(
                    name=name,
                    mac=sockets.mac(name),
                    addresses=tuple(address for owner, address in addresses if owner == name),
                    driver=driver.driver,
                    driver_version=driver.version,
                    firmware=driver.firmware,
                    mtu=sockets.mtu(name),
                    speed_bps=ethtool.speed_bps(name),
                    frequency_mhz=radio.frequency_mhz,
                    width_mhz=radio.width_mhz,
                    power_save=radio.power_save,
                    mode=radio.mode,
                )
            )
        return tuple(found)
    finally:
        sockets.close()


def local_addresses() -> list[tuple[str, str]]:
    """(interface, address) of this network namespace, IPv4 (SIOCGIFCONF) and IPv6 (/proc/net/if_inet6)."""
    found: list[tuple[str, str]] = []
    sockets = InterfaceSocket()
    try:
        room = array.array("B", bytes(256 * _IFREQ_BYTES))
        address, _ = room.buffer_info()
        try:
            used = struct.unpack_from("i", sockets.ask(SIOCGIFCONF, struct.pack("iP", len(room), address)))[0]
        except OSError:
            used = 0
        data = room.tobytes()[:used]
        for at in range(0, used - _IFREQ_BYTES + 1, _IFREQ_BYTES):
            label = data[at : at + 16].split(b"\0", 1)[0].decode("utf-8", "backslashreplace")
            found.append((label.split(":")[0], socket.inet_ntoa(data[at + 20 : at + 24])))
    finally:
        sockets.close()
    for line in (_text("/proc/thread-self/net/if_inet6") or "").splitlines():
        fields = line.split()
        if len(fields) == 6 and len(fields[0]) == 32:
            found.append((fields[5], socket.inet_ntop(socket.AF_INET6, bytes.fromhex(fields[0]))))
    return found


def route_interface(family: int, address: tuple[str | int, ...], names: Iterable[str]) -> str | None:
    """Which of `names` the kernel would send through to a UDP address; None when it is another, or none."""
    with socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as trial:
        try:
            trial.connect(address)  # sends nothing: it only looks up the route
        except OSError:
            return None
        source = str(trial.getsockname()[0]).split("%")[0]
    owners = [name for name, owned in local_addresses() if owned == source]
    return next((name for name in names if name in owners), None)


class _Radio(NamedTuple):
    mode: str | None = None
    frequency_mhz: int | None = None
    width_mhz: int | None = None
    power_save: bool | None = None


def _radio(name: str, wireless: WirelessIoctls) -> _Radio:
    """What nl80211 says, else the wireless extensions; nothing for a wired interface."""
    try:
        reader = Nl80211()
    except LinkRoverError:
        return _radio_by_extensions(name, wireless)
    try:
        info = reader.interface(name)
        return _Radio(info.mode, info.frequency_mhz, info.width_mhz, reader.power_save(name))
    except LinkRoverError:
        return _radio_by_extensions(name, wireless)
    finally:
        reader.close()


def _radio_by_extensions(name: str, wireless: WirelessIoctls) -> _Radio:
    if not wireless.is_wireless(name):
        return _Radio()
    settings = wireless.read(name)
    return _Radio(settings.mode, settings.frequency_mhz, None, settings.power_save)


def _driver(ethtool: EthtoolReader, name: str) -> DriverInfo:
    try:
        return ethtool.driver(name)
    except LinkRoverError:
        return DriverInfo(None, None, None, None)


def _text(path: str) -> str | None:
    try:
        with open(path, encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123
            return file.read(65536).strip()
    except OSError:
        return None

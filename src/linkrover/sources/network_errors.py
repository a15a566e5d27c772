"""Error counters of several interfaces: TCP and UDP of the namespace, MAC and NIC of each interface."""

from __future__ import annotations

from collections.abc import Sequence

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Continuity, NetworkErrors, Unknown, now

from .counters import increments
from .ethtool import MAC_RX_DROPPED, MAC_TX_RETRIES, EthtoolReader, pick
from .interface import InterfaceSocket, InterfaceWatch, Presence
from .kept import SourceUnavailableError
from .netdev import DeviceCounters, NetdevReader
from .snmp import NetstatReader, SnmpReader
from .sysfs import SysfsReader

_SNMP_FIELDS = {
    "tcp_retransmits": "tcp_retransmits",
    "tcp_bad_segments": "tcp_bad_segments",
    "udp_errors": "udp_in_errors",
}
_NETSTAT_FIELDS = {"tcp_lost_retransmits": "tcp_lost_retransmits", "tcp_timeouts": "tcp_timeouts"}
_NIC_FIELDS = ("nic_tx_errors", "nic_rx_errors", "nic_tx_dropped", "nic_rx_dropped")
_MAC_FIELDS = ("mac_tx_retries", "mac_rx_dropped")


class NetworkErrorsSource:
    """Samples error counters.

    NIC counters come from sysfs where it shows this namespace, else from /proc/net/dev; nic_rx_dropped is in both
    cases what the kernel dropped plus what the device missed, so that the figure does not depend on the way.
    """

    def __init__(
        self,
        watches: Sequence[InterfaceWatch],
        *,
        sockets: InterfaceSocket | None = None,
        netdev: NetdevReader | None = None,
        snmp: SnmpReader | None = None,
        netstat: NetstatReader | None = None,
    ) -> None:
        self._watches = tuple(watches)
        self._sockets = sockets or InterfaceSocket()
        self._netdev = netdev or NetdevReader()
        self._snmp = snmp or SnmpReader()
        self._netstat = netstat or NetstatReader()
        self._ethtool = {watch.iface: EthtoolReader(self._sockets) for watch in watches}
        self._sysfs = {watch.iface: SysfsReader(self._sockets) for watch in watches}
        self._sysfs_refused: dict[str, int] = {}  # interface -> epoch in which sysfs was of no use
        self._mac_refused: dict[str, tuple[int, Unknown]] = {}
        self._bases: dict[str, tuple[int, dict[str, int]] | None] = {}
        self.last_error: LinkRoverError | None = None

    def sample(self) -> list[NetworkErrors]:
        """One record per interface. What cannot be read is None, with the reason; nothing is raised."""
        self.last_error = None
        places = [(watch.iface, watch.look()) for watch in self._watches]
        stamp = now()
        machine: dict[str, int] = {}
        machine_unknown: dict[str, Unknown] = {}
        try:
            snmp = self._snmp.read()
            machine = {field: getattr(snmp, title) for field, title in _SNMP_FIELDS.items()}
            machine["udp_buffer_errors"] = snmp.udp_receive_buffer_errors + snmp.udp_send_buffer_errors
        except (SourceUnavailableError, ParseError) as error:
            machine_unknown |= dict.fromkeys((*_SNMP_FIELDS, "udp_buffer_errors"), self._why(error))
        try:
            netstat = self._netstat.read()
            machine |= {field: getattr(netstat, title) for field, title in _NETSTAT_FIELDS.items()}
        except (SourceUnavailableError, ParseError) as error:
            machine_unknown |= dict.fromkeys(_NETSTAT_FIELDS, self._why(error))
        records = []
        for iface, place in places:
            own, unknown = self._own(iface, place)
            continuity = self._continuity(iface, place, own)
            records.append(
                NetworkErrors(
                    wall_ns=stamp.wall_ns,
                    mono_ns=stamp.mono_ns,
                    unknown={**machine_unknown, **unknown},
                    iface=iface,
                    continuity=continuity,
                    **machine,
                    **own,
                )
            )
        return records

    def close(self) -> None:
        """Give back the file descriptors."""
        for sysfs in self._sysfs.values():
            sysfs.close()
        for reader in (self._netdev, self._snmp, self._netstat):
            reader.close()

    def _why(self, error: SourceUnavailableError | ParseError) -> Unknown:
        self.last_error = error
        return error.reason if isinstance(error, SourceUnavailableError) else Unknown.UNSUPPORTED

    def _own(self, iface: str, place: Presence) -> tuple[dict[str, int], dict[str, Unknown]]:
        if place.index is None:
            return {}, dict.fromkeys(_NIC_FIELDS + _MAC_FIELDS, Unknown.ABSENT)
        values: dict[str, int] = {}
        unknown: dict[str, Unknown] = {}
        try:
            values |= self._nic(iface, place, place.index)
        except (SourceUnavailableError, ParseError) as error:
            unknown |= dict.fromkeys(_NIC_FIELDS, self._why(error))
        refused = self._mac_refused.get(iface)
        if refused is not None and refused[0] == place.epoch:
            unknown |= dict.fromkeys(_MAC_FIELDS, refused[1])
            return values, unknown
        try:
            statistics = self._ethtool[iface].statistics(place.name, place.index)
        except SourceUnavailableError as error:
            # what a driver does not offer now it will not offer in a second: ask again when the device changes
            self._mac_refused[iface] = (place.epoch, error.reason)
            unknown |= dict.fromkeys(_MAC_FIELDS, error.reason)
        except ParseError as error:
            unknown |= dict.fromkeys(_MAC_FIELDS, self._why(error))
        else:
            for field, names in zip(_MAC_FIELDS, (MAC_TX_RETRIES, MAC_RX_DROPPED), strict=True):
                value = pick(statistics, names)
                if value is None:
                    unknown[field] = Unknown.UNSUPPORTED
                else:
                    values[field] = value
        return values, unknown

    def _nic(self, iface: str, place: Presence, index: int) -> dict[str, int]:
        if self._sysfs_refused.get(iface) != place.epoch:
            sysfs = self._sysfs[iface]
            try:
                if sysfs.index != index:
                    self._check_sysfs(sysfs, place.name)
                found = sysfs.read(place.name, index)
            except SourceUnavailableError:
                self._sysfs_refused[iface] = place.epoch
            else:
                return _nic(found.tx_errors, found.rx_errors, found.tx_dropped, found.rx_dropped + found.rx_missed)
        device = self._netdev.read((place.name,)).get(place.name)
        if device is None:
            raise SourceUnavailableError(f"/proc/net/dev, {place.name}", Unknown.ABSENT)
        return _device_nic(device)

    def _check_sysfs(self, sysfs: SysfsReader, name: str) -> None:
        before = self._netdev.read((name,)).get(name)
        seen = sysfs.byte_counters(name)
        after = self._netdev.read((name,)).get(name)
        if before is None or after is None or seen is None:
            raise SourceUnavailableError(f"statistics of {name}", Unknown.ABSENT)
        if not (before.rx_bytes <= seen[0] <= after.rx_bytes and before.tx_bytes <= seen[1] <= after.tx_bytes):
            raise SourceUnavailableError(f"statistics of {name}", Unknown.UNSUPPORTED, "sysfs of another namespace")

    def _continuity(self, iface: str, place: Presence, own: dict[str, int]) -> Continuity:
        base = self._bases.get(iface)
        if place.index is None:
            self._bases[iface] = None
            return Continuity.GONE
        returned = iface in self._bases
        self._bases[iface] = (place.epoch, own)
        if base is None or base[0] != place.epoch:
            return Continuity.BACK if returned else Continuity.FIRST
        shared = [field for field in own if field in base[1]]
        if not shared:
            return Continuity.STEADY
        return increments(tuple(base[1][field] for field in shared), tuple(own[field] for field in shared))[0]


def _nic(tx_errors: int, rx_errors: int, tx_dropped: int, rx_dropped: int) -> dict[str, int]:
    return dict(zip(_NIC_FIELDS, (tx_errors, rx_errors, tx_dropped, rx_dropped), strict=True))


def _device_nic(device: DeviceCounters) -> dict[str, int]:
    return _nic(device.tx_errors, device.rx_errors, device.tx_dropped, device.rx_dropped)

"""Link utilisation of several interfaces from one reading of /proc/net/dev and /proc/net/snmp."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import Continuity, LinkUtilization, Unknown, now

from .counters import increments
from .interface import InterfaceWatch
from .kept import SourceUnavailableError
from .netdev import DeviceCounters, NetdevReader
from .snmp import SnmpReader

_DEVICE_FIELDS = ("rx_bytes", "tx_bytes", "rx_packets", "tx_packets")
_RATE_FIELDS = ("rx_rate_bps", "tx_rate_bps")
_MACHINE_FIELDS = ("tcp_tx_segments", "tcp_rx_segments", "udp_tx_datagrams", "udp_rx_datagrams")
_MACHINE_RATES = tuple(f"{field}_per_s" for field in _MACHINE_FIELDS)


class _Base(msgspec.Struct):
    epoch: int
    mono_ns: int
    counters: tuple[int, ...]


class UtilizationSource:
    """Samples utilisation; rates are increments over the time between two readings of the same live device."""

    def __init__(
        self,
        watches: Sequence[InterfaceWatch],
        *,
        netdev: NetdevReader | None = None,
        snmp: SnmpReader | None = None,
    ) -> None:
        self._watches = tuple(watches)
        self._netdev = netdev or NetdevReader()
        self._snmp = snmp or SnmpReader()
        self._bases: dict[str, _Base | None] = {}
        self._machine_base: tuple[int, tuple[int, ...]] | None = None
        self.last_error: LinkRoverError | None = None

    def sample(self) -> list[LinkUtilization]:
        """One record per interface. What cannot be read is None, with the reason; nothing is raised."""
        self.last_error = None
        places = [(watch.iface, watch.look()) for watch in self._watches]
        stamp = now()
        devices, devices_reason = self._devices([place.name for _, place in places if place.index is not None])
        machine, machine_unknown = self._machine(stamp.mono_ns)
        records = []
        for iface, place in places:
            device = devices.get(place.name) if place.index is not None else None
            values, unknown, continuity, interval = self._device(
                iface, place.epoch, device, stamp.mono_ns, devices_reason
            )
            records.append(
                LinkUtilization(
                    wall_ns=stamp.wall_ns,
                    mono_ns=stamp.mono_ns,
                    unknown={**unknown, **machine_unknown},
                    iface=iface,
                    continuity=continuity,
                    interval_ns=interval,
                    **values,  # type: ignore[arg-type]
                    **machine,  # type: ignore[arg-type]
                )
            )
        return records

    def close(self) -> None:
        """Give back the file descriptors."""
        self._netdev.close()
        self._snmp.close()

    def _devices(self, names: list[str]) -> tuple[dict[str, DeviceCounters], Unknown | None]:
        try:
            return self._netdev.read(names), None
        except (SourceUnavailableError, ParseError) as error:
            self.last_error = error
            return {}, error.reason if isinstance(error, SourceUnavailableError) else Unknown.UNSUPPORTED

    def _device(
        self, iface: str, epoch: int, device: DeviceCounters | None, mono_ns: int, reason: Unknown | None
    ) -> tuple[dict[str, int | float | None], dict[str, Unknown], Continuity, int | None]:
        base = self._bases.get(iface)
        if device is None:
            if reason is None:
                self._bases[iface] = None
            why = reason or Unknown.ABSENT
            return {}, dict.fromkeys(_DEVICE_FIELDS + _RATE_FIELDS, why), Continuity.GONE, None
        counters = (device.rx_bytes, device.tx_bytes, device.rx_packets, device.tx_packets)
        values: dict[str, int | float | None] = dict(zip(_DEVICE_FIELDS, counters, strict=True))
        continuity, steps, interval = Continuity.FIRST, None, None
        if base is not None and base.epoch == epoch:
            interval = mono_ns - base.mono_ns
            continuity, steps = increments(base.counters, counters)
        elif iface in self._bases:
            continuity = Continuity.BACK
        self._bases[iface] = _Base(epoch, mono_ns, counters)
        if steps is None or not interval:
            return values, dict.fromkeys(_RATE_FIELDS, Unknown.NO_BASE), continuity, interval
        values["rx_rate_bps"] = steps[0] * 8e9 / interval
        values["tx_rate_bps"] = steps[1] * 8e9 / interval
        return values, {}, continuity, interval

    def _machine(self, mono_ns: int) -> tuple[dict[str, int | float | None], dict[str, Unknown]]:
        try:
            snmp = self._snmp.read()
        except (SourceUnavailableError, ParseError) as error:
            self.last_error = error
            why = error.reason if isinstance(error, SourceUnavailableError) else Unknown.UNSUPPORTED
            self._machine_base = None
            return {}, dict.fromkeys(_MACHINE_FIELDS + _MACHINE_RATES, why)
        counters = (snmp.tcp_out_segments, snmp.tcp_in_segments, snmp.udp_out_datagrams, snmp.udp_in_datagrams)
        values: dict[str, int | float | None] = dict(zip(_MACHINE_FIELDS, counters, strict=True))
        base, self._machine_base = self._machine_base, (mono_ns, counters)
        if base is not None and mono_ns > base[0]:
            _, steps = increments(base[1], counters)
            if steps is not None:
                values |= {
                    name: step * 1e9 / (mono_ns - base[0]) for name, step in zip(_MACHINE_RATES, steps, strict=True)
                }
                return values, {}
        return values, dict.fromkeys(_MACHINE_RATES, Unknown.NO_BASE)

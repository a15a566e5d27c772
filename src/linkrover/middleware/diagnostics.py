"""/diagnostics at 1 Hz: OK, WARN, ERROR or STALE with stable names, for the tools robots already have."""

from __future__ import annotations

import collections
from collections.abc import Callable

import msgspec

from linkrover.messages.mapping import header
from linkrover.records import (
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Record,
    SelfAccount,
    WirelessLink,
    now,
)

from .protocol import Middleware

OK, WARN, ERROR, STALE = 0, 1, 2, 3
_WORDS = {OK: "OK", WARN: "weak", ERROR: "bad", STALE: "stale"}


class Thresholds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From where on a value is worth a warning or an error."""

    rssi_warn_dbm: float = -72.0
    rssi_error_dbm: float = -82.0
    delay_warn_ms: float = 100.0
    delay_error_ms: float = 500.0
    loss_warn: float = 0.01  # share of the pings of the last window_s
    loss_error: float = 0.2
    retransmits_warn_per_s: float = 10.0
    retransmits_error_per_s: float = 200.0
    window_s: float = 10.0
    stale_s: float = 5.0


class Status(msgspec.Struct, frozen=True):
    """One line of /diagnostics."""

    name: str
    level: int
    message: str
    values: dict[str, str]


def _graded(value: float, warn: float, error: float) -> int:
    """The level of a value that is worse the further it goes from warn towards error."""
    if warn <= error:
        return ERROR if value >= error else WARN if value >= warn else OK
    return ERROR if value <= error else WARN if value <= warn else OK


class Diagnostics:
    """A sink that keeps the newest of everything and says once a second how it stands.

    Names are "linkrover/<end>: <subject>"; hardware_id is the interface or the end.
    """

    def __init__(
        self,
        middleware: Middleware,
        end: str,
        thresholds: Thresholds | None = None,
        extra: Callable[[], dict[str, str]] | None = None,
    ) -> None:
        self._middleware = middleware
        self._end = end
        self._limits = thresholds or Thresholds()
        self._extra = extra
        self._latest: dict[tuple[str, str], Record] = {}
        self._delays: dict[str, collections.deque[NetworkDelay]] = {}
        self._errors: dict[str, collections.deque[NetworkErrors]] = {}
        self._outages: dict[str, bool] = {}
        self._account: SelfAccount | None = None

    def take(self, record: Record) -> None:
        """Remember."""
        if isinstance(record, (WirelessLink, LinkUtilization)):
            if isinstance(record, WirelessLink) and record.peer is not None:
                return  # an access point's peers are many; the interface's own state is what is graded
            self._latest[(type(record).__name__, record.iface)] = record
        elif isinstance(record, NetworkErrors):
            self._errors.setdefault(record.iface, collections.deque(maxlen=600)).append(record)
        elif isinstance(record, NetworkDelay) and not record.method.endswith("late"):
            key = f"{record.method} to {record.peer}"
            self._delays.setdefault(key, collections.deque(maxlen=1200)).append(record)
        elif isinstance(record, LinkEvent) and record.kind in (EventKind.OUTAGE_BEGAN, EventKind.OUTAGE_ENDED):
            self._outages[record.peer or record.iface] = record.kind is EventKind.OUTAGE_BEGAN
        elif isinstance(record, SelfAccount):
            self._account = record

    def close(self) -> None:
        """Nothing is held."""

    def statuses(self, mono_ns: int) -> list[Status]:
        """How everything stands at this time (CLOCK_MONOTONIC)."""
        found = [self._link(r, mono_ns) for r in self._latest.values() if isinstance(r, WirelessLink)]
        found += [self._traffic(r, mono_ns) for r in self._latest.values() if isinstance(r, LinkUtilization)]
        found += [self._retransmits(iface, kept, mono_ns) for iface, kept in self._errors.items() if kept]
        found += [self._delay(key, kept, mono_ns) for key, kept in self._delays.items() if kept]
        found.append(self._itself(mono_ns))
        return sorted(found, key=lambda status: status.name)

    def publish(self) -> None:
        """Say it on /diagnostics."""
        instant = now()
        listed = self.statuses(instant.mono_ns)
        interfaces = {key[1] for key in self._latest} | self._errors.keys()
        array = {
            "header": header(instant.wall_ns, ""),
            "status": [
                {
                    "level": s.level,
                    "name": f"linkrover/{self._end}: {s.name}",
                    "message": s.message,
                    "hardware_id": next((i for i in interfaces if s.name.startswith(f"{i} ")), self._end),
                    "values": [{"key": k, "value": v} for k, v in s.values.items()],
                }
                for s in listed
            ],
        }
        self._middleware.publish("/diagnostics", "diagnostic_msgs/DiagnosticArray", array)

    def _stale(self, record: Record, mono_ns: int) -> float | None:
        age_s = (mono_ns - record.mono_ns) / 1e9
        return age_s if age_s > self._limits.stale_s else None

    def _link(self, record: WirelessLink, mono_ns: int) -> Status:
        limits, name = self._limits, f"{record.iface} link"
        values = {"rssi_dbm": _text(record.rssi_dbm), "ssid": record.ssid or "", "bssid": record.bssid or ""}
        age_s = self._stale(record, mono_ns)
        if age_s is not None:
            return Status(name, STALE, f"no reading for {age_s:.0f} s", values)
        if record.connected is False:
            return Status(name, ERROR, "not connected", values)
        if record.rssi_dbm is None:
            return Status(name, OK, "no signal reading: not wireless, or the driver does not give it", values)
        level = _graded(record.rssi_dbm, limits.rssi_warn_dbm, limits.rssi_error_dbm)
        return Status(name, level, f"{_WORDS[level]}: {record.rssi_dbm:.0f} dBm", values)

    def _traffic(self, record: LinkUtilization, mono_ns: int) -> Status:
        values = {"rx_rate_bps": _text(record.rx_rate_bps), "tx_rate_bps": _text(record.tx_rate_bps)}
        name, age_s = f"{record.iface} traffic", self._stale(record, mono_ns)
        if age_s is not None:
            return Status(name, STALE, f"no reading for {age_s:.0f} s", values)
        if record.rx_bytes is None:
            return Status(name, ERROR, "the interface is not there", values)
        rx, tx = (0.0 if v is None else v / 1e6 for v in (record.rx_rate_bps, record.tx_rate_bps))
        return Status(name, OK, f"in {rx:.2f}, out {tx:.2f} Mbit/s", values)

    def _retransmits(self, iface: str, kept: collections.deque[NetworkErrors], mono_ns: int) -> Status:
        limits, newest, name = self._limits, kept[-1], f"{iface} errors"
        oldest = next((r for r in kept if mono_ns - r.mono_ns <= limits.window_s * 1e9), newest)
        values = {"tcp_retransmits": _text(newest.tcp_retransmits), "mac_tx_retries": _text(newest.mac_tx_retries)}
        age_s = self._stale(newest, mono_ns)
        if age_s is not None:
            return Status(name, STALE, f"no reading for {age_s:.0f} s", values)
        seconds = (newest.mono_ns - oldest.mono_ns) / 1e9
        if seconds <= 0 or newest.tcp_retransmits is None or oldest.tcp_retransmits is None:
            return Status(name, OK, "counting", values)
        rate = max(0, newest.tcp_retransmits - oldest.tcp_retransmits) / seconds
        level = _graded(rate, limits.retransmits_warn_per_s, limits.retransmits_error_per_s)
        return Status(name, level, f"{rate:.1f} TCP retransmits/s (whole host)", values)

    def _delay(self, key: str, kept: collections.deque[NetworkDelay], mono_ns: int) -> Status:
        limits, name = self._limits, f"delay, {key}"
        recent = [r for r in kept if mono_ns - r.mono_ns <= limits.window_s * 1e9] or [kept[-1]]
        answered = sorted(r.delay_ns / 1e6 for r in recent if r.delay_ns is not None)
        loss = 1 - len(answered) / len(recent)
        median_ms = answered[len(answered) // 2] if answered else None
        values = {"median_ms": _text(median_ms), "loss": f"{loss:.3f}", "alive": str(kept[-1].alive)}
        age_s = self._stale(kept[-1], mono_ns)
        if age_s is not None:
            return Status(name, STALE, f"no ping for {age_s:.0f} s", values)
        level = _graded(loss, limits.loss_warn, limits.loss_error)
        if median_ms is None or self._outages.get(kept[-1].peer):
            return Status(name, ERROR, "no answer", values)
        level = max(level, _graded(median_ms, limits.delay_warn_ms, limits.delay_error_ms))
        return Status(name, level, f"median {median_ms:.1f} ms, {loss:.1%} lost", values)

    def _itself(self, mono_ns: int) -> Status:
        values = {} if self._extra is None else self._extra()
        if self._account is None:
            return Status("recording", OK, "starting", values)
        a = self._account
        values |= {
            "cpu_percent": f"{100 * a.cpu_ns / a.interval_ns:.2f}" if a.interval_ns else "",
            "records_lost": str(a.records_lost),
            "missed_slots": str(a.missed_slots),
        }
        age_s = self._stale(a, mono_ns)
        if age_s is not None:
            return Status("recording", STALE, f"sampling stands still for {age_s:.0f} s", values)
        level = WARN if a.records_lost or a.missed_slots else OK
        return Status("recording", level, f"{a.missed_slots} slots missed, {a.records_lost} records lost", values)


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:g}"

"""Records <-> the message types of the 2021 package (`network_analysis`), with their sentinels.

A lost delay is -1 ms, a missing signal reading -256, a missing counter -1, a missing rate NaN. `total_*_mbps` is a
true rate here (Mbit/s over the measured interval); the 2021 nodes published Mbit per interval, so that a reader of
their bags must take rates from the counters (see `linkrover.bag.patterns`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from linkrover.errors import ParseError
from linkrover.records import LinkUtilization, NetworkDelay, NetworkErrors, Record, WirelessLink

from .mapping import get, header, stamp_ns
from .wire import Message

NO_READING = -256
LOST_MS = -1.0
NOTHING_YET = -2  # what some tools of 2021 wrote before the first message
_INT32_END = 2**31 - 1
_FLOAT32_MAX = 3.4e38

ERRORS = {
    "retransmits": "tcp_retransmits",
    "badsegments": "tcp_bad_segments",
    "udperrors": "udp_errors",
    "tx_retires": "mac_tx_retries",
    "rx_dropped": "mac_rx_dropped",
    "nic_tx_errors": "nic_tx_errors",
    "nic_rx_errors": "nic_rx_errors",
    "nic_tx_dropped": "nic_tx_dropped",
    "nic_rx_dropped": "nic_rx_dropped",
}
COUNTERS = {
    "tcp_tx_segments": "tcp_tx_segments",
    "tcp_rx_segments": "tcp_rx_segments",
    "udp_tx_datagrams": "udp_tx_datagrams",
    "udp_rx_datagrams": "udp_rx_datagrams",
    "total_tx_packets": "tx_packets",
    "total_tx_bytes": "tx_bytes",
    "total_rx_packets": "rx_packets",
    "total_rx_bytes": "rx_bytes",
}
_RATES = {
    "tcp_tx_segmentrate": "tcp_tx_segments_per_s",
    "tcp_rx_segmentrate": "tcp_rx_segments_per_s",
    "udp_tx_datagramrate": "udp_tx_datagrams_per_s",
    "udp_rx_datagramrate": "udp_rx_datagrams_per_s",
}
_MBPS = {"total_tx_mbps": "tx_rate_bps", "total_rx_mbps": "rx_rate_bps"}


def to_2021(record: Record) -> tuple[str, Message] | None:
    """(message type, message) of a record that the 2021 package has a type for, else None."""
    found = _TO.get(type(record))
    return None if found is None else (found[0], found[1](record))


def _utilization(record: LinkUtilization) -> Message:
    message: Message = {"header": header(record.wall_ns, record.iface), "iface": record.iface}
    for name, field in COUNTERS.items():
        message[name] = _or(getattr(record, field), -1)
    for name, field in _RATES.items():
        message[name] = _or(getattr(record, field), math.nan)
    for name, field in _MBPS.items():
        rate = getattr(record, field)
        message[name] = math.nan if rate is None else rate / 1e6
    return message


def _errors(record: NetworkErrors) -> Message:
    message: Message = {"header": header(record.wall_ns, record.iface), "iface": record.iface}
    for name, field in ERRORS.items():
        message[name] = _or(getattr(record, field), -1)
    return message


def _wireless(record: WirelessLink) -> Message:
    return {
        "header": header(record.wall_ns, record.iface),
        "iface": record.iface,
        "ssid": record.ssid or "",
        "status": bool(record.connected),
        "txpower": _whole(record.tx_power_dbm),
        "rssi": _whole(record.rssi_dbm),
        "lqi": -1.0 if record.link_quality is None or abs(record.link_quality) > _FLOAT32_MAX else record.link_quality,
        "noise": _whole(record.noise_dbm),
    }


def _delay(record: NetworkDelay) -> Message:
    return {
        "header": header(record.wall_ns, record.iface),
        "iface": record.iface,
        "delay": LOST_MS if record.delay_ns is None else record.delay_ns / 1e6,
        "alive": record.alive,
    }


def _or(value: Any, sentinel: Any) -> Any:
    return sentinel if value is None else value


def _whole(value: float | None) -> int:
    return NO_READING if value is None or not abs(value) < _INT32_END else round(value)


def from_2021(message_type: str, message: Any, received_ns: int | None = None) -> tuple[Record, ...]:
    """The records in a message of the 2021 package; more than one for `NetworkAnalysis` and `WirelessLinkVector`.

    wall_ns is the header's stamp, or `received_ns` where that is given; mono_ns is the same figure, since these
    messages carry no monotonic clock. Rates are as published: see the module's text. Raises ParseError.
    """
    name = message_type.rpartition("/")[2]
    try:
        if name == "NetworkAnalysis":
            parts = (("delay", "NetworkDelay"), ("errors", "NetworkErrors"), ("quality", "WirelessLink"),
                     ("utilization", "LinkUtilization"))  # fmt: skip
            return tuple(_FROM[kind](one, received_ns) for field, kind in parts for one in get(message, field))
        if name == "WirelessLinkVector":
            return tuple(_FROM["WirelessLink"](one, received_ns) for one in get(message, "wireless_quality"))
        if name not in _FROM:
            raise ParseError(message_type, "message", f"one of {', '.join(_FROM)}")
        return (_FROM[name](message, received_ns),)
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ParseError(message_type, "message", "a message of the 2021 package", str(error)) from None


def _base(message: Any, received_ns: int | None) -> dict[str, Any]:
    wall_ns = stamp_ns(message) if received_ns is None else received_ns
    return {"wall_ns": wall_ns, "mono_ns": wall_ns, "iface": str(get(message, "iface"))}


def _utilization_back(message: Any, received_ns: int | None) -> LinkUtilization:
    values = _base(message, received_ns)
    for name, field in COUNTERS.items():
        values[field] = _count(get(message, name))
    for name, field in _RATES.items():
        values[field] = _rate(get(message, name))
    for name, field in _MBPS.items():
        rate = _rate(get(message, name))
        values[field] = None if rate is None else rate * 1e6
    return LinkUtilization(**values)


def _errors_back(message: Any, received_ns: int | None) -> NetworkErrors:
    values = _base(message, received_ns)
    for name, field in ERRORS.items():
        values[field] = _count(get(message, name))
    return NetworkErrors(**values)


def _wireless_back(message: Any, received_ns: int | None) -> WirelessLink:
    lqi = float(get(message, "lqi"))
    return WirelessLink(
        **_base(message, received_ns),
        source="2021",
        connected=bool(get(message, "status")),
        ssid=str(get(message, "ssid")) or None,
        tx_power_dbm=_reading(get(message, "txpower")),
        rssi_dbm=_reading(get(message, "rssi")),
        link_quality=lqi if lqi >= 0 else None,
        noise_dbm=_reading(get(message, "noise")),
    )


def _delay_back(message: Any, received_ns: int | None) -> NetworkDelay:
    delay = float(get(message, "delay"))
    known = math.isfinite(delay) and delay >= 0
    return NetworkDelay(
        **_base(message, received_ns),
        peer="",
        method="ros1 action",
        delay_ns=round(delay * 1e6) if known else None,
        alive=bool(get(message, "alive")),
    )


def _count(value: Any) -> int | None:
    return int(value) if value >= 0 else None


def _rate(value: Any) -> float | None:
    return float(value) if math.isfinite(value) and value >= 0 else None


def _reading(value: Any) -> float | None:
    return None if value in (NO_READING, NOTHING_YET) else float(value)


_TO: dict[type[Record], tuple[str, Callable[[Any], Message]]] = {
    LinkUtilization: ("network_analysis/LinkUtilization", _utilization),
    NetworkErrors: ("network_analysis/NetworkErrors", _errors),
    WirelessLink: ("network_analysis/WirelessLink", _wireless),
    NetworkDelay: ("network_analysis/NetworkDelay", _delay),
}
_FROM: dict[str, Callable[[Any, int | None], Record]] = {
    "LinkUtilization": _utilization_back,
    "NetworkErrors": _errors_back,
    "WirelessLink": _wireless_back,
    "NetworkDelay": _delay_back,
}

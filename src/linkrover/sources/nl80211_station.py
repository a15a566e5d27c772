"""The nl80211 station dump: one peer of a wireless interface, bytes -> StationLink.

Numbers and meanings: linux/nl80211.h (NL80211_ATTR_STA_INFO, enum nl80211_sta_info, enum nl80211_rate_info).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from ..errors import ParseError
from ..records import Bitrate, Now, StationLink, TidCounters, Unknown
from .genetlink import GENL_HEADER
from .netlink import NLA_TYPE_MASK, attribute_list, attributes

ATTR_IFINDEX, ATTR_MAC, ATTR_STA_INFO = 3, 6, 21

_U8, _S8, _U16, _U32, _U64 = (struct.Struct("=" + form) for form in "BbHIQ")
_FLAGS = struct.Struct("=II")
_HEADER = struct.Struct("=HH")

RX_BYTES, TX_BYTES, TX_BITRATE, RX_BITRATE = 2, 3, 8, 14
STA_FLAGS, RX_BYTES64, TX_BYTES64 = 17, 23, 24
CHAIN_SIGNAL, CHAIN_SIGNAL_AVG, EXPECTED_THROUGHPUT, TID_STATS = 25, 26, 27, 31
FLAG_AUTHORIZED, FLAG_ASSOCIATED = 1 << 1, 1 << 7

# Attribute -> field and width, for values that are taken as they are.
_PLAIN: dict[int, tuple[str, struct.Struct]] = {
    1: ("inactive_ms", _U32),
    9: ("rx_packets", _U32),
    10: ("tx_packets", _U32),
    11: ("tx_retries", _U32),
    12: ("tx_failed", _U32),
    16: ("connected_s", _U32),
    18: ("beacon_loss", _U32),
    28: ("rx_dropped", _U64),
    29: ("rx_beacons", _U64),
    32: ("rx_airtime_us", _U64),
    39: ("tx_airtime_us", _U64),
    RX_BYTES64: ("rx_bytes", _U64),
    TX_BYTES64: ("tx_bytes", _U64),
}
# dBm in one signed byte. 0 is what drivers leave when they do not know: no frame arrives at 0 dBm.
_SIGNAL: dict[int, str] = {
    7: "rssi_dbm",
    13: "rssi_avg_dbm",
    30: "beacon_rssi_avg_dbm",
    34: "ack_rssi_dbm",
    35: "ack_rssi_avg_dbm",
}
_FIELDS = tuple(
    name
    for name in StationLink.__struct_fields__
    if name not in ("wall_ns", "mono_ns", "unknown", "iface", "peer", "rssi_stale")
)
_WIDTHS = {3: 40, 8: 80, 9: 160, 10: 160, 11: 10, 12: 5, 18: 320}  # RATE_INFO flag -> MHz
_HE_GUARDS_NS = {0: 800, 1: 1600, 2: 3200}


def parse_bitrate(data: bytes, file: str = "nl80211 rate") -> Bitrate:
    """A nested NL80211_STA_INFO_{TX,RX}_BITRATE. For HT `mcs` is the index 0..31 that also holds the streams.

    Raises:
        ParseError: an attribute points outside the data or is too short.
    """
    found = attributes(data, file)
    rate_bps = None
    if 5 in found:
        rate_bps = _value(found, 5, _U32, file) * 100_000
    elif 1 in found:
        rate_bps = _value(found, 1, _U16, file) * 100_000
    width_mhz: int | None = next((mhz for kind, mhz in _WIDTHS.items() if kind in found), 20)
    mcs = nss = guard_ns = None
    mode = "legacy"
    if 19 in found:
        mode, mcs = "eht", _value(found, 19, _U8, file)
        nss = _optional(found, 20, _U8, file)
        guard_ns = _HE_GUARDS_NS.get(_optional(found, 21, _U8, file) or 0)
    elif 13 in found:
        mode, mcs = "he", _value(found, 13, _U8, file)
        nss = _optional(found, 14, _U8, file)
        guard_ns = _HE_GUARDS_NS.get(_optional(found, 15, _U8, file) or 0)
    elif 6 in found:
        mode, mcs = "vht", _value(found, 6, _U8, file)
        nss = _optional(found, 7, _U8, file)
        guard_ns = 400 if 4 in found else 800
    elif 2 in found:
        mode, mcs = "ht", _value(found, 2, _U8, file)
        nss = mcs // 8 + 1 if mcs < 32 else 1
        guard_ns = 400 if 4 in found else 800
    elif width_mhz == 20:
        width_mhz = None  # a legacy rate does not say its width
    return Bitrate(
        rate_bps=rate_bps or None, mode=mode, mcs=mcs, nss=nss, width_mhz=width_mhz, guard_interval_ns=guard_ns
    )


def _value(found: dict[int, bytes], kind: int, form: struct.Struct, file: str) -> int:
    value = found[kind]
    if len(value) < form.size:
        raise ParseError(file, f"attribute {kind}", f"{form.size} bytes", f"{len(value)} bytes")
    return int(form.unpack_from(value)[0])


def _optional(found: dict[int, bytes], kind: int, form: struct.Struct, file: str) -> int | None:
    return _value(found, kind, form, file) if kind in found else None


def _chains(data: bytes, file: str) -> tuple[float, ...]:
    values = []
    for kind, value in attribute_list(data, file):
        if not value:
            raise ParseError(file, f"chain {kind}", "1 byte", "nothing")
        values.append(float(_S8.unpack_from(value)[0]))
    return tuple(values)


def _tids(data: bytes, file: str) -> tuple[TidCounters, ...]:
    found = []
    for index, nested in attribute_list(data, file):
        one = attributes(nested, file)
        counters = TidCounters(
            tid=index - 1,
            rx_frames=_optional(one, 1, _U64, file),
            tx_frames=_optional(one, 2, _U64, file),
            tx_retries=_optional(one, 3, _U64, file),
            tx_failed=_optional(one, 4, _U64, file),
        )
        # mac80211 lists all 17 identifiers; those that never carried a frame say nothing.
        if counters.rx_frames or counters.tx_frames or counters.tx_retries or counters.tx_failed:
            found.append(counters)
    return tuple(found)


# The same rate comes again and again: parsing it once per distinct value saves a quarter of a sample.
_rates: dict[bytes, Bitrate] = {}


def _bitrate(data: bytes, file: str) -> Bitrate:
    known = _rates.get(data)
    if known is None:
        if len(_rates) > 512:
            _rates.clear()
        known = _rates[data] = parse_bitrate(data, file)
    return known


_NESTED: dict[int, tuple[str, Callable[[bytes, str], Any]]] = {
    TX_BITRATE: ("tx_bitrate", _bitrate),
    RX_BITRATE: ("rx_bitrate", _bitrate),
    CHAIN_SIGNAL: ("rssi_chain_dbm", _chains),
    CHAIN_SIGNAL_AVG: ("rssi_chain_avg_dbm", _chains),
    TID_STATS: ("tids", _tids),
}

_missing: dict[frozenset[str], dict[str, Unknown]] = {}


def _unknown(fields: dict[str, Any], tids: bool) -> dict[str, Unknown]:
    key = frozenset(fields) if tids else frozenset((*fields, "tids"))
    known = _missing.get(key)
    if known is None:
        if len(_missing) > 256:
            _missing.clear()
        known = _missing[key] = {name: Unknown.UNSUPPORTED for name in _FIELDS if name not in key}
    return known


def parse_station(
    payload: bytes, at: Now, iface: str, file: str = "nl80211 station", *, tids: bool = True
) -> StationLink:
    """One message of the station dump, from its genlmsghdr on. Unknown attributes are skipped.

    tids=False leaves the counters per traffic identifier out: they are three quarters of the work.
    What the driver does not give is `None` with the reason UNSUPPORTED; a signal of 0 dBm counts as not given.

    Raises:
        ParseError: an attribute points outside the message, is too short, or peer or values are absent.
    """
    peer = b""
    info: bytes | None = None
    for kind, value in attribute_list(payload, file, GENL_HEADER):
        if kind == ATTR_MAC:
            peer = value
        elif kind == ATTR_STA_INFO:
            info = value
    if len(peer) != 6 or info is None:
        raise ParseError(file, "message", "a peer address and station values", "neither" if not peer else "one of them")
    fields: dict[str, Any] = {}
    offset, end = 0, len(info)
    plain, signal, nested = _PLAIN, _SIGNAL, _NESTED
    while end - offset >= 4:  # attribute_list() unrolled: this loop is half the cost of a sample
        length, kind = _HEADER.unpack_from(info, offset)
        stop = offset + length
        if length < 4 or stop > end:
            raise ParseError(file, f"station value at {offset}", f"4 to {end - offset} bytes", f"length {length}")
        kind &= NLA_TYPE_MASK
        start = offset + 4
        offset = (stop + 3) & ~3
        if kind in plain:
            name, form = plain[kind]
            if stop - start < form.size:
                raise ParseError(file, f"station value {kind}", f"{form.size} bytes", f"{stop - start} bytes")
            fields[name] = form.unpack_from(info, start)[0]
        elif kind in signal:
            if stop == start:
                raise ParseError(file, f"station value {kind}", "1 byte", "nothing")
            level = _S8.unpack_from(info, start)[0]
            if level:
                fields[signal[kind]] = float(level)
        elif kind in nested:
            if kind == TID_STATS and not tids:
                continue
            name, decode = nested[kind]
            fields[name] = decode(info[start:stop], file)
        elif kind in (RX_BYTES, TX_BYTES):
            if stop - start < 4:
                raise ParseError(file, f"station value {kind}", "4 bytes", f"{stop - start} bytes")
            fields.setdefault("rx_bytes" if kind == RX_BYTES else "tx_bytes", _U32.unpack_from(info, start)[0])
        elif kind == EXPECTED_THROUGHPUT:
            if stop - start < 4:
                raise ParseError(file, f"station value {kind}", "4 bytes", f"{stop - start} bytes")
            fields["expected_throughput_bps"] = _U32.unpack_from(info, start)[0] * 1000
        elif kind == STA_FLAGS:
            if stop - start < 8:
                raise ParseError(file, f"station value {kind}", "8 bytes", f"{stop - start} bytes")
            mask, flags = _FLAGS.unpack_from(info, start)
            if mask & FLAG_AUTHORIZED:
                fields["authorized"] = bool(flags & FLAG_AUTHORIZED)
            if mask & FLAG_ASSOCIATED:
                fields["associated"] = bool(flags & FLAG_ASSOCIATED)
    return StationLink(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        iface=iface,
        peer=mac_text(peer),
        unknown=_unknown(fields, tids),
        **fields,
    )


def mac_text(value: bytes) -> str:
    """Six bytes as 02:00:00:00:01:00."""
    return value[:6].hex(":")

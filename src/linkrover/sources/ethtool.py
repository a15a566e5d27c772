"""ethtool by ioctl: driver information, link speed, and the driver's own statistics (include/uapi/linux/ethtool.h)."""

from __future__ import annotations

import array
import struct

import msgspec

from linkrover.errors import ParseError
from linkrover.records import Unknown

from .interface import InterfaceSocket
from .kept import SourceUnavailableError, reason_of

SIOCETHTOOL = 0x8946
_GDRVINFO = 0x03
_GSTRINGS = 0x1B
_GSTATS = 0x1D
_GSSET_INFO = 0x37
_GLINKSETTINGS = 0x4C
_SET_STATS = 1
_NAME_SIZE = 32
_SPEED_UNKNOWN = {0, 0xFFFFFFFF, 0xFFFF}
_STATISTICS_LIMIT = 16384
# The kernel writes as many values as the driver has at that instant, whatever room was asked for.
_SLACK = 256
_SOURCE = "ethtool"

# What drivers call the same thing, the most specific name first. mac80211 (net/mac80211/ethtool.c) adds up over the
# peers it has now, so its figures fall when a peer leaves.
MAC_TX_RETRIES = ("tx_retries", "tx_retry_count", "tx_retry", "retries", "tx_multi_retries", "Tx_Retries")
MAC_RX_DROPPED = ("rx_dropped", "rx_drops", "rx_drop", "rx_total_drops", "dropped_rx", "Rx_Dropped")


class DriverInfo(msgspec.Struct, frozen=True):
    """Who drives the interface (ETHTOOL_GDRVINFO); empty strings are None."""

    driver: str | None
    version: str | None
    firmware: str | None
    bus: str | None


def parse_driver_info(data: bytes) -> DriverInfo:
    """The kernel's struct ethtool_drvinfo.

    Raises:
        ParseError: shorter than the structure.
    """
    if len(data) < 196:
        raise ParseError(_SOURCE, "driver information", "196 octets", str(len(data)))
    driver, version, firmware, bus = struct.unpack_from("4x32s32s32s32s", data)
    return DriverInfo(_text(driver), _text(version), _text(firmware), _text(bus))


def parse_names(data: bytes, count: int) -> tuple[str, ...]:
    """Names of `count` statistics, 32 octets each (ETHTOOL_GSTRINGS without its head).

    Raises:
        ParseError: fewer octets than that.
    """
    if len(data) < count * _NAME_SIZE:
        raise ParseError(_SOURCE, "statistics names", f"{count * _NAME_SIZE} octets", str(len(data)))
    return tuple(_text(data[at : at + _NAME_SIZE]) or "" for at in range(0, count * _NAME_SIZE, _NAME_SIZE))


def parse_values(data: bytes, count: int) -> tuple[int, ...]:
    """Values of `count` statistics, unsigned 64 bit each (ETHTOOL_GSTATS without its head).

    Raises:
        ParseError: fewer octets than that.
    """
    if len(data) < count * 8:
        raise ParseError(_SOURCE, "statistics values", f"{count * 8} octets", str(len(data)))
    return struct.unpack_from(f"={count}Q", data)


def pick(statistics: dict[str, int], names: tuple[str, ...]) -> int | None:
    """The first of `names` that the driver has."""
    for name in names:
        value = statistics.get(name)
        if value is not None:
            return value
    return None


def _text(data: bytes) -> str | None:
    text = data.split(b"\0", 1)[0].decode("utf-8", "backslashreplace").strip()
    return text if text and text != "N/A" else None


class EthtoolReader:
    """Asks the driver of an interface; names of statistics are asked once a device."""

    def __init__(self, sockets: InterfaceSocket) -> None:
        self._sockets = sockets
        self._known: tuple[str, int, int] | None = None  # name, index, count
        self._names: tuple[str, ...] = ()
        self._buffer = array.array("B")

    def statistics(self, name: str, index: int = 0) -> dict[str, int]:
        """The driver's statistics by its own names; of a name that occurs twice the first.

        Raises:
            SourceUnavailableError: the driver has none, or the interface is not there.
        """
        count = self._count(name)
        if self._known != (name, index, count):
            reply = self._call(name, struct.pack("3I", _GSTRINGS, _SET_STATS, count), (count + _SLACK) * _NAME_SIZE)
            given = min(count, struct.unpack_from("8xI", reply)[0])
            self._names = parse_names(reply[12:], given)
            self._known = (name, index, count)
        reply = self._call(name, struct.pack("2I", _GSTATS, count), (count + _SLACK) * 8)
        given = struct.unpack_from("4xI", reply)[0]
        if given != len(self._names):
            self._known = None
            raise ParseError(_SOURCE, f"statistics of {name}", f"{len(self._names)} values", str(given))
        values = parse_values(reply[8:], given)
        return dict(zip(reversed(self._names), reversed(values), strict=True))

    def driver(self, name: str) -> DriverInfo:
        """Driver, version, firmware and bus.

        Raises:
            SourceUnavailableError: the driver does not say.
        """
        return parse_driver_info(self._call(name, struct.pack("I", _GDRVINFO), 196))

    def speed_bps(self, name: str) -> int | None:
        """Link speed of a wired interface in bit/s; None when unknown, down, or wireless."""
        try:
            head = self._call(name, struct.pack("I", _GLINKSETTINGS), 512)
            words = -struct.unpack_from("15xb", head)[0]
            if words <= 0:
                return None
            asked = struct.pack("I11xb", _GLINKSETTINGS, words)
            speed = struct.unpack_from("4xI", self._call(name, asked, 512 + 12 * words))[0]
        except SourceUnavailableError:
            return None
        return None if speed in _SPEED_UNKNOWN else speed * 1_000_000

    def _count(self, name: str) -> int:
        reply = self._call(name, struct.pack("2IQ", _GSSET_INFO, 0, 1 << _SET_STATS), 64)
        mask, count = struct.unpack_from("8xQI", reply)
        if not mask & (1 << _SET_STATS) or count == 0:
            raise SourceUnavailableError(f"ethtool {name}", Unknown.UNSUPPORTED, "this driver has no statistics")
        if count > _STATISTICS_LIMIT:
            raise ParseError(_SOURCE, f"statistics of {name}", f"at most {_STATISTICS_LIMIT}", str(count))
        return int(count)

    def _call(self, name: str, head: bytes, size: int) -> bytes:
        if len(self._buffer) < len(head) + size:
            self._buffer = array.array("B", bytes(len(head) + size))
        self._buffer[: len(head)] = array.array("B", head)
        address, _ = self._buffer.buffer_info()
        try:
            self._sockets.ask(SIOCETHTOOL, struct.pack("16sP16x", name.encode("utf-8", "surrogateescape"), address))
        except OSError as error:
            raise SourceUnavailableError(f"ethtool {name}", reason_of(error), error.strerror or "") from error
        return self._buffer[: len(head) + size].tobytes()

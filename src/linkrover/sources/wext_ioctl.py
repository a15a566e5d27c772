"""Wireless extension ioctls: name, mode, SSID, BSSID, frequency, power (include/uapi/linux/wireless.h)."""

from __future__ import annotations

import array
import math
import struct

import msgspec

from linkrover.errors import ParseError

from .interface import InterfaceSocket

SIOCGIWNAME = 0x8B01
SIOCGIWFREQ = 0x8B05
SIOCGIWMODE = 0x8B07
SIOCGIWRANGE = 0x8B0B
SIOCGIWAP = 0x8B15
SIOCGIWESSID = 0x8B1B
SIOCGIWRATE = 0x8B21
SIOCGIWTXPOW = 0x8B27
SIOCGIWPOWER = 0x8B2D

_MODES = {1: "ibss", 2: "station", 3: "ap", 4: "repeater", 6: "monitor", 7: "mesh"}
_TXPOW_TYPE = 0x00FF
_TXPOW_MWATT = 0x0001
_ARPHRD_ETHER = 1
_SSID_MAX = 32
_FREQUENCY_UNITS_BELOW = 1000  # below it the number is a channel, not Hz
_SOURCE = "wireless extensions"


class WirelessSettings(msgspec.Struct, frozen=True):
    """What the ioctls gave; None where the driver gave nothing."""

    mode: str | None = None
    ssid: str | None = None
    bssid: str | None = None
    frequency_mhz: int | None = None
    tx_power_dbm: float | None = None
    bitrate_bps: int | None = None
    power_save: bool | None = None
    quality_max: int | None = None


def decode_ssid(data: bytes) -> str | None:
    r"""SSID octets as text (UTF-8; other octets as \xNN); None when hidden or empty."""
    if not data.strip(b"\0"):
        return None
    return data.decode("utf-8", "backslashreplace")


def decode_address(data: bytes) -> str | None:
    """A struct sockaddr of SIOCGIWAP; None when not associated (all zero, all ones, or 44:44:44:44:44:44).

    Raises:
        ParseError: too short or not an Ethernet address.
    """
    if len(data) < 8:
        raise ParseError(_SOURCE, "SIOCGIWAP", "a socket address of 8 octets or more", str(len(data)))
    family = struct.unpack_from("H", data)[0]
    if family != _ARPHRD_ETHER:
        raise ParseError(_SOURCE, "SIOCGIWAP", "address family 1 (ARPHRD_ETHER)", str(family))
    octets = data[2:8]
    if octets in {b"\0" * 6, b"\xff" * 6, b"\x44" * 6}:
        return None
    return ":".join(f"{octet:02x}" for octet in octets)


def decode_frequency_mhz(data: bytes) -> int | None:
    """A struct iw_freq (m * 10^e Hz), in whole MHz; None when the driver gave a channel number or nothing.

    Raises:
        ParseError: too short, or an exponent no driver uses.
    """
    if len(data) < 6:
        raise ParseError(_SOURCE, "SIOCGIWFREQ", "6 octets or more", str(len(data)))
    mantissa, exponent = struct.unpack_from("ih", data)
    if not 0 <= exponent <= 12:
        raise ParseError(_SOURCE, "SIOCGIWFREQ", "an exponent within 0..12", str(exponent))
    hertz = mantissa * 10**exponent
    return None if hertz < _FREQUENCY_UNITS_BELOW else round(hertz / 1_000_000)


def decode_tx_power_dbm(data: bytes) -> float | None:
    """A struct iw_param of SIOCGIWTXPOW; None when switched off or in the driver's own scale.

    Raises:
        ParseError: too short.
    """
    if len(data) < 8:
        raise ParseError(_SOURCE, "SIOCGIWTXPOW", "8 octets or more", str(len(data)))
    value, _fixed, disabled, flags = struct.unpack_from("iBBH", data)
    if disabled or flags & _TXPOW_TYPE not in {0, _TXPOW_MWATT}:
        return None
    if flags & _TXPOW_MWATT:
        if value <= 0:
            return None
        return 10 * math.log10(value)
    return float(value)


class WirelessIoctls:
    """Asks the driver of one interface through the wireless extensions."""

    def __init__(self, sockets: InterfaceSocket | None = None) -> None:
        self._sockets = sockets or InterfaceSocket()

    def is_wireless(self, name: str) -> bool:
        """Whether the kernel's wireless extensions know the interface."""
        return self._small(SIOCGIWNAME, name) is not None

    def read(self, name: str) -> WirelessSettings:
        """All the driver gives; a refused or missing answer is None.

        Raises:
            ParseError: an answer that is not what it should be.
        """
        mode = self._small(SIOCGIWMODE, name)
        address = self._small(SIOCGIWAP, name)
        frequency = self._small(SIOCGIWFREQ, name)
        power = self._small(SIOCGIWTXPOW, name)
        rate = self._small(SIOCGIWRATE, name)
        saving = self._small(SIOCGIWPOWER, name)
        # one octet more would make the kernel count a final NUL, as for tools of before 2007 (wext-core.c)
        ssid = self._pointed(SIOCGIWESSID, name, _SSID_MAX)
        limits = self._pointed(SIOCGIWRANGE, name, 1024)
        return WirelessSettings(
            mode=None if mode is None else _MODES.get(struct.unpack_from("I", mode)[0]),
            ssid=None if ssid is None else decode_ssid(ssid[:_SSID_MAX]),
            bssid=None if address is None else decode_address(address),
            frequency_mhz=None if frequency is None else decode_frequency_mhz(frequency),
            tx_power_dbm=None if power is None else decode_tx_power_dbm(power),
            bitrate_bps=None if rate is None else (struct.unpack_from("i", rate)[0] or None),
            power_save=None if saving is None else not saving[5],
            quality_max=_quality_max(limits),
        )

    def _small(self, request: int, name: str) -> bytes | None:
        try:
            return self._sockets.ask(request, struct.pack("16s16x", name.encode("utf-8", "surrogateescape")))[16:]
        except OSError:
            return None

    def _pointed(self, request: int, name: str, size: int) -> bytes | None:
        buffer = array.array("B", bytes(size))
        address, _ = buffer.buffer_info()
        # struct iw_point: pointer, length, flags
        asked = struct.pack("16sPHH4x", name.encode("utf-8", "surrogateescape"), address, size, 0)
        try:
            reply = self._sockets.ask(request, asked)
        except OSError:
            return None
        length = struct.unpack_from("16xPHH", reply)[1]
        return buffer.tobytes()[: min(length, size)]

    def close(self) -> None:
        """Give back the socket."""
        self._sockets.close()


def _quality_max(limits: bytes | None) -> int | None:
    # max_qual.qual stands at octet 44 of struct iw_range on every architecture; 0 = not given
    return limits[44] or None if limits is not None and len(limits) > 44 else None

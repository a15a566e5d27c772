"""/proc/net/wireless: link quality, level, noise and discards (net/wireless/wext-proc.c, wext-compat.c)."""

from __future__ import annotations

import re

import msgspec

from linkrover.errors import ParseError

from .digits import show
from .kept import KeptFile

PATH = "/proc/thread-self/net/wireless"

_LINE = re.compile(
    rb" *([^\s:]+): ([0-9a-f]{4}) {1,8}(-?[0-9]{1,4})([. ]) {1,8}(-?[0-9]{1,4})([. ]) {1,8}(-?[0-9]{1,4})([. ])"
    rb"  *([0-9]{1,10})  *([0-9]{1,10})  *([0-9]{1,10})  *([0-9]{1,10})  *([0-9]{1,10})  *([0-9]{1,10}) *"
)
_UNSET = -256


class WirelessCounters(msgspec.Struct, frozen=True):
    """One line. With cfg80211 drivers it exists only while a station is associated, and never for an access point.

    quality: the driver's own scale (with cfg80211: RSSI + 110, held within 0..70).
    level_dbm, noise_dbm: None when the driver gave none (printed as -256, or 0) or gives no dBm (printed positive);
    relative_level then holds what it gave. A reading without its dot is the driver's last one, not renewed since
    anybody last read the file.
    gave_up: the "retry" column; with cfg80211 the frames given up after all retries (nl80211's "tx failed").
    All counters restart with each association.
    """

    status: int
    quality: int
    quality_renewed: bool
    level_dbm: int | None
    level_renewed: bool
    relative_level: int | None
    noise_dbm: int | None
    noise_renewed: bool
    discarded_nwid: int
    discarded_crypt: int
    discarded_fragment: int
    gave_up: int
    discarded_misc: int
    missed_beacons: int


def parse_wireless(data: bytes, file: str = PATH) -> dict[str, WirelessCounters]:
    """Lines by exact interface name.

    Raises:
        ParseError: not the kernel's format, torn, or a value out of the kernel's range.
    """
    if not data.endswith(b"\n"):
        raise ParseError(file, "end", "a final newline (the text is torn)", show(data[-20:]))
    lines = data.split(b"\n")
    if len(lines) < 3 or not lines[0].startswith(b"Inter-| sta-|"):
        raise ParseError(file, "line 1", "the header 'Inter-| sta-|   Quality ...'", show(lines[0]))
    if not lines[1].startswith(b" face | tus | link level noise |"):
        raise ParseError(file, "line 2", "the header ' face | tus | link level noise |'", show(lines[1]))
    found: dict[str, WirelessCounters] = {}
    for number, line in enumerate(lines[2:-1], 3):
        match = _LINE.fullmatch(line)
        if match is None:
            raise ParseError(file, f"line {number}", "'name: status link level noise', six counters", show(line))
        raw = match.groups()
        name = raw[0].decode("utf-8", "backslashreplace")
        if name in found:
            raise ParseError(file, f"line {number}", "each interface once", f"{name} again")
        quality, level, noise = int(raw[2]), int(raw[4]), int(raw[6])
        for value, title in ((quality, "link"), (level, "level"), (noise, "noise")):
            if not -256 <= value <= 255:
                raise ParseError(file, f"line {number} ({name})", f"{title} within -256..255", str(value))
        counts = [int(field) for field in raw[8:]]
        if max(counts) >= 1 << 32:
            raise ParseError(file, f"line {number} ({name})", "counters below 2^32", str(max(counts)))
        found[name] = WirelessCounters(
            int(raw[1], 16),
            quality,
            raw[3] == b".",
            _dbm(level),
            raw[5] == b".",
            level if level > 0 else None,
            _dbm(noise),
            raw[7] == b".",
            *counts,
        )
    return found


def _dbm(printed: int) -> int | None:
    """The kernel prints an unsigned octet minus 256; 64 and more of it are negative dBm, as wireless-tools read it."""
    if printed >= 0 or printed == _UNSET:
        return None
    return printed + 256 if printed + 256 < 64 else printed


class WirelessFileReader:
    """Reads /proc/net/wireless, or a file of the same format that an emulated driver writes."""

    def __init__(self, path: str = PATH) -> None:
        self._file = KeptFile(path)

    @property
    def path(self) -> str:
        """Where it reads."""
        return self._file.path

    def read(self) -> dict[str, WirelessCounters]:
        """Lines by interface name; an interface without one is not in the result.

        Raises:
            SourceUnavailableError: the file cannot be read (a kernel without wireless extensions has none).
            ParseError: it is not what it should be, twice in a row.
        """
        try:
            return parse_wireless(self._file.read(), self._file.path)
        except ParseError:
            # an emulated driver may have been in the middle of writing
            return parse_wireless(self._file.read(), self._file.path)

    def close(self) -> None:
        """Give back the file descriptor."""
        self._file.close()

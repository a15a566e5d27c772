"""The emulated radio's face to the sources: the text of `/proc/net/wireless`, in a file.

Format as the kernel's wext-proc.c prints it (a real line is in the tests). The file is changed in place, so that a
reader that keeps its descriptor open and uses pread sees it as it would see procfs.
"""

from __future__ import annotations

import os
from pathlib import Path

HEADER = (
    b"Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE\n"
    b" face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22\n"
)
QUALITY_MAX = 70
NOISE_UNSET_DBM = -256


def level_dbm(rssi_dbm: float) -> int:
    """The whole dBm the driver shows: rounded, within the eight bits wext has for it."""
    return max(-110, min(-1, round(rssi_dbm)))


def wireless_line(
    iface: str, rssi_dbm: float, noise_dbm: float | None = None, retry_drops: int = 0, missed_beacons: int = 0
) -> bytes:
    """One interface's line; quality is the kernel's clamp(level + 110, 0..70).

    retry_drops: frames given up after all retries (nl80211's "tx failed"). Source: wireless_seq_printf_stats,
    net/wireless/wext-proc.c: "%6s: %04x  %3d%c  %3d%c  %3d%c  %6d %6d %6d %6d %6d   %6d".
    """
    level = level_dbm(rssi_dbm)
    quality = max(0, min(QUALITY_MAX, level + 110))
    noise = NOISE_UNSET_DBM if noise_dbm is None else round(noise_dbm)
    updated = "." if noise_dbm is not None else " "
    return (
        f"{iface:>6}: 0000  {quality:3d}.  {level:3d}.  {noise:3d}{updated}  {0:6d} {0:6d} {0:6d} "
        f"{retry_drops:6d} {0:6d}   {missed_beacons:6d}\n"
    ).encode()


class DriverFile:
    """Writes the text of one end. Not associated: headers only, as the kernel does."""

    def __init__(self, path: Path, iface: str = "wlan0") -> None:
        self.path = path
        self.iface = iface
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        os.pwrite(self._fd, HEADER, 0)
        self._size = len(HEADER)

    def write(self, rssi_dbm: float | None, noise_dbm: float | None = None, retry_drops: int = 0) -> None:
        """Show this signal; None = not associated."""
        line = b"" if rssi_dbm is None else wireless_line(self.iface, rssi_dbm, noise_dbm, retry_drops)
        size = len(HEADER) + len(line)
        if line:
            os.pwrite(self._fd, line, len(HEADER))
        if size < self._size:
            os.ftruncate(self._fd, size)
        self._size = size

    def close(self) -> None:
        """Give the descriptor back; the file stays for its readers."""
        os.close(self._fd)

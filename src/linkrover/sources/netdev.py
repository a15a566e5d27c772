"""/proc/net/dev: bytes, packets, errors and drops of every interface (net/core/net-procfs.c)."""

from __future__ import annotations

from collections.abc import Collection

import msgspec

from linkrover.errors import ParseError

from .digits import counter, show
from .kept import KeptFile

PATH = "/proc/thread-self/net/dev"

_COLUMNS = 16
_HEADER = (
    b"bytes packets errs drop fifo frame compressed multicast".split(),
    b"bytes packets errs drop fifo colls carrier compressed".split(),
)


class DeviceCounters(msgspec.Struct, frozen=True):
    """Raw counters of one interface since it was made.

    The kernel adds up here: rx_errors includes length, CRC and frame errors as the driver counts them; rx_dropped
    is rx_dropped + rx_missed_errors of the statistics in sysfs.
    """

    rx_bytes: int
    rx_packets: int
    rx_errors: int
    rx_dropped: int
    tx_bytes: int
    tx_packets: int
    tx_errors: int
    tx_dropped: int


def parse_netdev(data: bytes, file: str = PATH, *, only: Collection[str] | None = None) -> dict[str, DeviceCounters]:
    """Counters by exact interface name. `only` limits what is parsed to these names.

    Raises:
        ParseError: not the kernel's format, torn, or a value that is not a counter.
    """
    if not data.endswith(b"\n"):
        raise ParseError(file, "end", "a final newline (the text is torn)", show(data[-20:]))
    lines = data.split(b"\n")
    if len(lines) < 3 or not lines[0].startswith(b"Inter-|"):
        raise ParseError(file, "line 1", "the header 'Inter-|   Receive ...'", show(lines[0]))
    header = lines[1].split(b"|")
    if len(header) != 3 or header[1].split() != _HEADER[0] or header[2].split() != _HEADER[1]:
        raise ParseError(file, "line 2", "the column names of /proc/net/dev", show(lines[1]))
    wanted = None if only is None else {name.encode("utf-8", "surrogateescape") for name in only}
    found: dict[str, DeviceCounters] = {}
    for number, line in enumerate(lines[2:-1], 3):
        raw_name, colon, rest = line.partition(b":")
        raw_name = raw_name.strip(b" ")
        if not colon or not raw_name:
            raise ParseError(file, f"line {number}", "'name: counters'", show(line))
        if wanted is not None and raw_name not in wanted:
            continue
        values = rest.split()
        if len(values) != _COLUMNS:
            raise ParseError(file, f"line {number}", f"{_COLUMNS} counters", str(len(values)))
        name = raw_name.decode("utf-8", "backslashreplace")
        if name in found:
            raise ParseError(file, f"line {number}", "each interface once", f"{name} again")
        place = f"line {number} ({name})"
        found[name] = DeviceCounters(*[counter(values[i], file, place) for i in (0, 1, 2, 3, 8, 9, 10, 11)])
    return found


class NetdevReader:
    """Reads /proc/net/dev of the namespace it was opened in."""

    def __init__(self, path: str = PATH, *, only: Collection[str] | None = None) -> None:
        self._file = KeptFile(path)
        self.only = only

    def read(self, only: Collection[str] | None = None) -> dict[str, DeviceCounters]:
        """Counters by interface name; an interface that is not there is not in the result.

        Raises:
            SourceUnavailableError: the file cannot be read.
            ParseError: it is not what it should be.
        """
        return parse_netdev(self._file.read(), self._file.path, only=self.only if only is None else only)

    def close(self) -> None:
        """Give back the file descriptor."""
        self._file.close()

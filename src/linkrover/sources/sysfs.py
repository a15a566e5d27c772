"""/sys/class/net/*/statistics: the error counters of one device, each on its own (rtnl_link_stats64)."""

from __future__ import annotations

import os

import msgspec

from linkrover.records import Unknown

from .digits import counter
from .interface import InterfaceSocket, check_name
from .kept import SourceUnavailableError, reason_of

ROOT = "/sys/class/net"
_FILES = ("rx_errors", "rx_dropped", "rx_missed_errors", "tx_errors", "tx_dropped")


class NicStatistics(msgspec.Struct, frozen=True):
    """Raw error counters of a device. rx_missed: it had no room for a frame; rx_dropped: the kernel had none."""

    rx_errors: int
    rx_dropped: int
    rx_missed: int
    tx_errors: int
    tx_dropped: int


def parse_statistic(data: bytes, file: str) -> int:
    """One statistics file: a decimal counter and a newline.

    Raises:
        ParseError: anything else.
    """
    return counter(data.removesuffix(b"\n"), file, "line 1")


class SysfsReader:
    """Keeps the statistics files of one device open.

    A sysfs mount shows the network namespace it was mounted in, which is not always the reader's: a process that
    entered another namespace without mounting sysfs anew would read a stranger of the same name. So opening compares
    index and address with what the reader's own namespace says, and refuses where they differ; byte_counters() lets a
    caller compare those too, for devices without an address.
    """

    def __init__(self, sockets: InterfaceSocket, *, root: str = ROOT) -> None:
        self._sockets = sockets
        self._root = root
        self._fds: list[int] = []
        self._paths: list[str] = []
        self.index: int | None = None  # of the device whose files are open

    def read(self, name: str, index: int) -> NicStatistics:
        """The counters of the device `name` that has `index`.

        Raises:
            SourceUnavailableError: not there, or sysfs belongs to another namespace.
            ParseError: not a counter.
        """
        if self.index != index:
            self.close()
            self._open(name, index)
        try:
            values = [
                parse_statistic(os.pread(fd, 64, 0), path) for fd, path in zip(self._fds, self._paths, strict=True)
            ]
        except OSError as error:
            # ENODEV: the device was removed under the open files
            self.close()
            raise SourceUnavailableError(f"{self._root}/{name}", Unknown.ABSENT, error.strerror or "") from error
        return NicStatistics(*values)

    def byte_counters(self, name: str) -> tuple[int, int] | None:
        """Received and sent bytes as sysfs has them, None when it has no such device."""
        try:
            rx, tx = (int(self._text(name, f"statistics/{title}")) for title in ("rx_bytes", "tx_bytes"))
        except (OSError, ValueError):
            return None
        return rx, tx

    def close(self) -> None:
        """Give back the file descriptors."""
        for fd in self._fds:
            os.close(fd)
        self._fds, self._paths, self.index = [], [], None

    def _open(self, name: str, index: int) -> None:
        check_name(name)
        directory = f"{self._root}/{name}"
        try:
            same = int(self._text(name, "ifindex")) == index
            mac = self._sockets.mac(name)
            same = same and (mac is None or self._text(name, "address") == mac)
        except (OSError, ValueError) as error:
            reason = reason_of(error) if isinstance(error, OSError) else Unknown.UNSUPPORTED
            raise SourceUnavailableError(directory, reason, str(error)) from error
        if not same:
            raise SourceUnavailableError(directory, Unknown.UNSUPPORTED, "this sysfs shows another network namespace")
        for title in _FILES:
            path = f"{directory}/statistics/{title}"
            try:
                self._fds.append(os.open(path, os.O_RDONLY | os.O_CLOEXEC))
            except OSError as error:
                self.close()
                raise SourceUnavailableError(path, reason_of(error), error.strerror or "") from error
            self._paths.append(path)
        self.index = index

    def _text(self, name: str, title: str) -> str:
        fd = os.open(f"{self._root}/{name}/{title}", os.O_RDONLY | os.O_CLOEXEC)
        try:
            return os.read(fd, 256).decode("ascii", "replace").strip()
        finally:
            os.close(fd)

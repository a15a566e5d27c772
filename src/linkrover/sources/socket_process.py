"""Which process holds a socket: /proc/PID/fd, as far as this user may look."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

_SOCKET = re.compile(r"socket:\[(\d+)\]")
_AGAIN_NS = 5_000_000_000  # walking all of /proc costs milliseconds: not for every new socket


class ProcessNames:
    """Names of the processes of sockets, by inode. A socket shared by several belongs to the first one found."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc
        self._known: dict[int, str] = {}
        self._walked_ns: int | None = None
        self._hopeless: set[int] = set()

    def names(self, inodes: set[int]) -> dict[int, str]:
        """Name and pid, "python3[812]", of those that are known; a process not ours to look into is left out."""
        wanted = inodes - self._known.keys() - self._hopeless - {0}
        due = self._walked_ns is None or time.monotonic_ns() - self._walked_ns >= _AGAIN_NS
        if wanted and due:
            self._known = {inode: name for inode, name in self._known.items() if inode in inodes}
            self._walk(wanted)
            self._walked_ns = time.monotonic_ns()
            self._hopeless = (self._hopeless | (wanted - self._known.keys())) & inodes
        return {inode: self._known[inode] for inode in inodes if inode in self._known}

    def _walk(self, wanted: set[int]) -> None:
        left = set(wanted)
        for entry in os.scandir(self._proc):
            if not left:
                return
            if not entry.name.isdigit():
                continue
            try:
                files = os.listdir(f"{entry.path}/fd")  # noqa: PTH208  # half the cost of Path objects
            except OSError:
                continue  # another user's process, or one that has just ended
            for file in files:
                try:
                    match = _SOCKET.fullmatch(os.readlink(f"{entry.path}/fd/{file}"))  # noqa: PTH115
                except OSError:
                    continue
                if match and int(match[1]) in left:
                    left.discard(int(match[1]))
                    self._known[int(match[1])] = f"{self._name(entry.path)}[{entry.name}]"

    @staticmethod
    def _name(path: str) -> str:
        try:
            return Path(path, "comm").read_text(errors="backslashreplace").strip()
        except OSError:
            return "?"

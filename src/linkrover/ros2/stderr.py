"""What Cyclone DDS writes to standard error, through a pipe and a thread of ours.

It writes from its own threads, under its own locks: a terminal that stands still (Ctrl-S) would stop DDS and, with the
next read of a topic, sampling. And in an outage it says the same several times a second.
"""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable

AGAIN_S = 60.0
_CYCLONE = re.compile(r"\d+\.\d+ \[\d+\]\s+\S+: (?P<text>.*)")
STDERR = 2


class CapturedStderr:
    """Takes standard error's place until close(). write gets whole lines; a line of Cyclone DDS once in AGAIN_S.

    terminal: a file descriptor of what standard error was.
    """

    def __init__(self) -> None:
        self.terminal = os.dup(STDERR)
        self._write: Callable[[str], object] = lambda _: None
        self._said: dict[str, float] = {}
        read, write = os.pipe()
        os.dup2(write, STDERR)
        os.close(write)
        self._pipe = os.fdopen(read, "r", encoding="utf-8", errors="replace")
        self._thread = threading.Thread(target=self._read, name="stderr", daemon=True)

    def start(self, write: Callable[[str], object]) -> None:
        """Hand lines over from now on; write must not block."""
        self._write = write
        self._thread.start()

    def close(self) -> None:
        """Give standard error back; what was written to it is handed over first."""
        os.dup2(self.terminal, STDERR)  # the pipe's only writer: its reader comes to an end
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _read(self) -> None:
        with self._pipe:
            for line in self._pipe:
                found = _CYCLONE.fullmatch(line.rstrip("\n"))
                if found is None:
                    self._write(line)
                elif self._due(found["text"]):
                    self._write(f"linkrover: WARNING: Cyclone DDS: {found['text']}\n")

    def _due(self, text: str) -> bool:
        key, now_s = re.sub(r"\d+", "0", text), time.monotonic()
        if now_s < self._said.get(key, now_s):
            return False
        self._said[key] = now_s + AGAIN_S
        return True

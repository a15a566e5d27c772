"""Writing to a terminal or pipe without ever making the measuring wait for whoever reads it."""

from __future__ import annotations

import os
import select
import threading
from collections import deque
from collections.abc import Callable

QUEUE_BYTES = 4 << 20


class Output:
    """Writes text to a file descriptor from a thread of its own.

    A stopped terminal (Ctrl-S) or a slow pipe blocks that thread alone; what does not fit into the queue meanwhile is
    dropped, oldest first, and counted. on_broken is called (from the thread) when the reader has gone.
    """

    def __init__(self, fd: int, *, on_broken: Callable[[], None] | None = None) -> None:
        self.dropped = 0
        self.broken = False
        self._fd = fd
        self._on_broken = on_broken
        self._queue: deque[tuple[bytes, bool]] = deque()  # data, whether it is a frame
        self._queued_bytes = 0
        self._condition = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="linkrover-output", daemon=True)
        self._thread.start()

    def write(self, text: str | bytes, *, frame: bool = False) -> None:
        """Queue text. A frame of a view takes the place of an earlier frame that was not written yet."""
        data = text.encode("utf-8", "backslashreplace") if isinstance(text, str) else text
        with self._condition:
            if self.broken:
                return
            if frame and self._queue and self._queue[-1][1]:
                self._queued_bytes -= len(self._queue.pop()[0])
            self._queue.append((data, frame))
            self._queued_bytes += len(data)
            while self._queued_bytes > QUEUE_BYTES and len(self._queue) > 1:
                self._queued_bytes -= len(self._queue.popleft()[0])
                self.dropped += 1
            self._condition.notify()

    def close(self, timeout_s: float = 2.0) -> None:
        """Write what is queued, for at most timeout_s."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._queue and not self._closing:
                    self._condition.wait()
                if not self._queue:
                    return
                data, _ = self._queue.popleft()
                self._queued_bytes -= len(data)
            if not self._write_all(data):
                return

    def _write_all(self, data: bytes) -> bool:
        view = memoryview(data)
        while view:
            written = self._write_some(view)
            if written is None:
                with self._condition:
                    self.broken = True
                    self._queue.clear()
                if self._on_broken is not None:
                    self._on_broken()
                return False
            view = view[written:]
        return True

    def _write_some(self, view: memoryview) -> int | None:
        """Bytes written; None when the reader has gone (EPIPE) or the terminal was closed (EIO)."""
        try:
            return os.write(self._fd, view)
        except BlockingIOError:
            select.select([], [self._fd], [], 1.0)
            return 0
        except OSError:
            return None

"""The absolute schedule: periodic jobs, timers and readable file descriptors in one thread.

A job's slots lie at start + k * period on CLOCK_MONOTONIC. A job that runs late does not move the later slots;
slots that passed meanwhile are skipped and counted, never run in a burst.
"""

from __future__ import annotations

import collections
import contextlib
import heapq
import os
import selectors
import time
from collections.abc import Callable
from typing import Protocol

import msgspec


class HasFileno(Protocol):
    """A socket, or anything else the kernel can watch."""

    def fileno(self) -> int:
        """The file descriptor."""
        ...


class Slot(msgspec.Struct, frozen=True):
    """One turn of a periodic job. late_ns: start of the callback minus due_ns. missed: slots skipped before it."""

    index: int
    due_ns: int
    late_ns: int
    missed: int


class Job:
    """A periodic job; cancel() ends it."""

    def __init__(self, period_ns: int, callback: Callable[[Slot], None], start_ns: int) -> None:
        self.period_ns = period_ns
        self.callback = callback
        self.start_ns = start_ns
        self.next_index = 0
        self.cancelled = False
        self.missed_total = 0

    def cancel(self) -> None:
        """No further slots."""
        self.cancelled = True


class Loop:
    """Runs jobs, timers and readers until stop() is called or a given time is reached.

    stop() and call_soon() may be called from a signal handler or another thread.
    """

    def __init__(self) -> None:
        # select() has microsecond time-outs; Python's epoll rounds up to a millisecond, which is late by that much.
        self._selector = selectors.SelectSelector()
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._selector.register(self._wake_read, selectors.EVENT_READ)
        self._readers: dict[int, Callable[[], None]] = {}
        self._heap: list[tuple[int, int, Callable[[], None]]] = []
        self._order = 0
        self._stopped = False
        self._soon: collections.deque[Callable[[], None]] = collections.deque()

    def every(self, period_ns: int, callback: Callable[[Slot], None], *, start_ns: int | None = None) -> Job:
        """Call back at start_ns + k * period_ns (CLOCK_MONOTONIC), start_ns defaulting to now.

        Raises:
            ValueError: period_ns is not positive.
        """
        if period_ns <= 0:
            raise ValueError(f"period_ns must be positive, got {period_ns}")
        job = Job(period_ns, callback, time.monotonic_ns() if start_ns is None else start_ns)
        self._push(job.start_ns, lambda: self._turn(job))
        return job

    def at(self, due_ns: int, callback: Callable[[], None]) -> None:
        """Call back once, at due_ns on CLOCK_MONOTONIC or as soon after as can be."""
        self._push(due_ns, callback)

    def call_soon(self, callback: Callable[[], None]) -> None:
        """Call back in the loop's thread at its next turn."""
        self._soon.append(callback)
        self._wake()

    def reader(self, file: HasFileno | int, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back whenever `file` is readable (or has an error queue to read). Returns what removes it again."""
        fd = self._selector.register(file, selectors.EVENT_READ).fd
        self._readers[fd] = callback

        def remove() -> None:
            # by number: a socket that was closed first has none any more
            if self._readers.get(fd) is callback:
                del self._readers[fd]
                self._selector.unregister(fd)

        return remove

    def run(self, until_ns: int | None = None) -> None:
        """Run until stop() or until_ns (CLOCK_MONOTONIC)."""
        while not self._stopped:
            now_ns = time.monotonic_ns()
            if until_ns is not None and now_ns >= until_ns:
                return
            while self._heap and self._heap[0][0] <= now_ns and not self._stopped:
                heapq.heappop(self._heap)[2]()
            due_ns = self._heap[0][0] if self._heap else until_ns
            if until_ns is not None and due_ns is not None:
                due_ns = min(due_ns, until_ns)
            wait_s = None if due_ns is None else max(0, due_ns - time.monotonic_ns()) / 1e9
            for key, _ in self._selector.select(wait_s):
                if key.fd == self._wake_read:
                    self._drain_wake()
                    continue
                # an earlier callback of this round may have removed this one and closed its file
                callback = self._readers.get(key.fd)
                if callback is not None:
                    callback()

    def stop(self) -> None:
        """Make run() return; safe in a signal handler."""
        self._stopped = True
        self._wake()

    def close(self) -> None:
        """Give back the file descriptors. stop() and call_soon() do nothing afterwards."""
        self._selector.close()
        # a late signal or thread must not write into whatever gets this number next
        wake_write, self._wake_write = self._wake_write, -1
        os.close(wake_write)
        os.close(self._wake_read)

    def _push(self, due_ns: int, callback: Callable[[], None]) -> None:
        self._order += 1
        heapq.heappush(self._heap, (due_ns, self._order, callback))

    def _turn(self, job: Job) -> None:
        if job.cancelled:
            return
        now_ns = time.monotonic_ns()
        index = max(job.next_index, (now_ns - job.start_ns) // job.period_ns)
        due_ns = job.start_ns + index * job.period_ns
        missed = index - job.next_index
        job.missed_total += missed
        job.next_index = index + 1
        self._push(due_ns + job.period_ns, lambda: self._turn(job))
        job.callback(Slot(index, due_ns, now_ns - due_ns, missed))

    def _wake(self) -> None:
        if self._wake_write < 0:
            return
        try:
            os.write(self._wake_write, b"x")
        except BlockingIOError:
            return  # already woken

    def _drain_wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 4096)
        # one at a time: another thread may add while this runs, and nothing of it may be lost; only as many as there
        # are now, so that callbacks which call again leave the others their turn
        for _ in range(len(self._soon)):
            self._soon.popleft()()

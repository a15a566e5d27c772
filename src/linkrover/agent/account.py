"""What measuring costs: CPU, memory, lateness and missed slots."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable

from linkrover.loop import Slot
from linkrover.records import SelfAccount, now

from .sink import CountingSink, Sink

_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_bytes() -> int:
    """Resident set of this process, from /proc/self/statm."""
    with open("/proc/self/statm", "rb", buffering=0) as file:  # noqa: PTH123  # unbuffered, once a second
        return int(file.read(256).split()[1]) * _PAGE_BYTES


class Account:
    """Gathers the slots of an agent's jobs between two SelfAccount records."""

    def __init__(self, sinks: Iterable[Sink]) -> None:
        self._sinks = sinks
        self._since_ns = time.monotonic_ns()
        self._cpu_ns = time.process_time_ns()
        self._lateness: list[int] = []
        self._missed = 0

    def note(self, slot: Slot) -> None:
        """One turn of a job."""
        self._lateness.append(slot.late_ns)
        self._missed += slot.missed

    def settle(self) -> SelfAccount:
        """The account since the last one; record counters are totals of all sinks that count."""
        stamp = now()
        cpu_ns = time.process_time_ns()
        late = sorted(self._lateness)
        counting = [sink for sink in self._sinks if isinstance(sink, CountingSink)]
        account = SelfAccount(
            wall_ns=stamp.wall_ns,
            mono_ns=stamp.mono_ns,
            interval_ns=stamp.mono_ns - self._since_ns,
            cpu_ns=cpu_ns - self._cpu_ns,
            rss_bytes=resident_bytes(),
            samples=len(late),
            missed_slots=self._missed,
            lateness_median_ns=late[len(late) // 2] if late else None,
            lateness_max_ns=late[-1] if late else None,
            records_written=sum(sink.records_written for sink in counting),
            records_lost=sum(sink.records_lost for sink in counting),
            bytes_written=sum(sink.bytes_written for sink in counting),
        )
        self._since_ns, self._cpu_ns, self._missed = stamp.mono_ns, cpu_ns, 0
        self._lateness.clear()
        return account

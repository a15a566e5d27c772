"""The plain view: events at once, everything else every few seconds."""

from __future__ import annotations

import time

from linkrover.records import Record

from .lines import clean, event_line, summary_lines
from .output import Output
from .state import LiveState


class LogView:
    """A sink that writes log lines with the local time in front."""

    def __init__(self, output: Output, *, period_s: float = 5.0) -> None:
        self.state = LiveState()
        self._output = output
        self._period_ns = round(period_s * 1e9)
        self._due_ns = time.monotonic_ns() + self._period_ns

    def take(self, record: Record) -> None:
        """Events are written at once."""
        self.state.take(record)
        line = event_line(record)
        if line is not None:
            self._say(line)
        if record.mono_ns >= self._due_ns:
            self._due_ns = record.mono_ns + self._period_ns
            for line in summary_lines(self.state):
                self._say(line)

    def close(self) -> None:
        """One last summary."""
        for line in summary_lines(self.state):
            self._say(line)

    def _say(self, line: str) -> None:
        self._output.write(f"{time.strftime('%H:%M:%S')} {clean(line)}\n")

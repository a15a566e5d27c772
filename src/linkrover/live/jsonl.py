"""Every record as one line of JSON, for a script."""

from __future__ import annotations

import msgspec

from linkrover.records import Record

from .output import Output


class JsonLines:
    """A sink: each record with its name under "type"; null = unknown, the reason under "unknown"."""

    def __init__(self, output: Output) -> None:
        self._output = output
        self._encoder = msgspec.json.Encoder()

    def take(self, record: Record) -> None:
        """One record, one line."""
        self._output.write(self._encoder.encode(record) + b"\n")

    def close(self) -> None:
        """The output is closed by whoever opened it."""

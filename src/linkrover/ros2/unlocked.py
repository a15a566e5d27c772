"""A DDS writer that lets other Python threads run while it writes.

cyclonedds' own write() keeps Python's lock while it waits for readers that do not keep up, and sampling would wait
with it. No `from __future__ import annotations` here: c_call reads the annotations as types.
"""

import ctypes
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.internal import c_call, dds_c_t
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Sample as Container

from .types import Sample


class UnlockedWriter(DataWriter[Any]):  # type: ignore[misc]
    """Writes what Sample.serialize() gives."""

    def write(self, sample: Sample, timestamp: int | None = None) -> None:
        """As DataWriter.write(); timestamp is not used.

        Raises:
            DDSException: the readers did not keep up, or the writer is gone.
        """
        del timestamp
        data = sample.serialize()
        data += bytes(-len(data) % 4)
        container = Container(ctypes.cast(ctypes.c_char_p(data), ctypes.c_void_p), len(data))
        code = int(self._write_unlocked(self._ref, ctypes.byref(container)))
        if code < 0:
            raise DDSException(code, "Occurred while writing a sample")

    @c_call("dds_write")  # type: ignore[untyped-decorator]
    def _write_unlocked(self, writer: dds_c_t.entity, data: ctypes.POINTER(Container)) -> dds_c_t.returnv:  # type: ignore[valid-type]
        """Replaced by c_call."""

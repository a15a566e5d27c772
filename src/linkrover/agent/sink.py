"""Where records go: the recorder, the live view, a ROS node."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from linkrover.records import Record


class Sink(Protocol):
    """Takes every record of an agent, in the loop's thread; must not block it."""

    def take(self, record: Record) -> None:
        """One record."""
        ...

    def close(self) -> object:
        """No more records come: finish what was begun. What it returns is its own affair."""
        ...


@runtime_checkable
class CountingSink(Protocol):
    """A sink that keeps count of what became of the records it took (a recorder)."""

    records_written: int
    records_lost: int
    bytes_written: int

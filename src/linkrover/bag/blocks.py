"""What every container is read into: topics, and blocks of raw messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

import msgspec


class Topic(msgspec.Struct, frozen=True):
    """A topic as its file declares it. type: "package/Name"; definition: its text with all it needs."""

    id: int
    name: str
    type: str
    definition: str
    ros1: bool = False  # ROS 1 serialisation instead of CDR
    encoding: str = "cdr"


class Raw(msgspec.Struct):
    """One message: data[start:end] of its block, received at log_ns (wall clock)."""

    topic: int
    log_ns: int
    start: int
    end: int


class Block(msgspec.Struct):
    """Messages that lie in one buffer.

    walk() finds them in file order. index, where the file has one that fits: by topic the (log_ns, offset) pairs as
    little-endian uint64, offset being where the MCAP message record begins.
    """

    data: bytes | memoryview
    walk: Callable[[], Iterator[Raw]]
    index: dict[int, bytes] | None = None


class Container(Protocol):
    """A file that can be read block by block, however damaged."""

    topics: dict[int, Topic]
    problems: list[str]
    metadata: dict[str, dict[str, str]]

    def blocks(self) -> Iterator[Block]:
        """All blocks there are, in file order; fills topics and problems on the way."""
        ...


class Problems:
    """Collects what is wrong with a file, without a line for each of a thousand bad messages."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._counted: dict[str, int] = {}

    def add(self, line: str) -> None:
        """Something that happened once."""
        if line not in self.lines:
            self.lines.append(line)

    def count(self, what: str, number: int = 1) -> None:
        """Something that may happen often; `what` reads after a number."""
        self._counted[what] = self._counted.get(what, 0) + number

    def all(self) -> list[str]:
        """Every line."""
        return self.lines + [f"{number} {what}" for what, number in self._counted.items()]

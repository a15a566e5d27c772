"""A part of a report: what every format shows under one heading."""

from __future__ import annotations

from dataclasses import dataclass, field

from .table import Table


@dataclass(slots=True)
class Section:
    """A heading with sentences and tables below it."""

    heading: str
    words: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)

    def __bool__(self) -> bool:
        """Whether there is something to say."""
        return bool(self.words or self.tables)

"""Small history lines out of block characters."""

from __future__ import annotations

from collections.abc import Iterable

_BLOCKS = "▁▂▃▄▅▆▇█"


def spark(values: Iterable[float | None], width: int, *, least: float | None = None) -> str:
    """The last `width` values as blocks, a gap where a value is unknown.

    The scale runs from the smallest value shown (or `least`, if that is smaller) to the largest.
    """
    shown = list(values)[-width:]
    known = [value for value in shown if value is not None]
    if not known:
        return " " * len(shown)
    low = min(known) if least is None else min(least, *known)
    span = max(known) - low
    top = len(_BLOCKS) - 1
    return "".join(
        " " if value is None else _BLOCKS[round((value - low) / span * top) if span > 0 else 0] for value in shown
    )

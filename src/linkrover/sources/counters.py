"""What happened to running counters between two samples: steady, wrapped at 2^32, or reset."""

from __future__ import annotations

from linkrover.records import Continuity

_WRAP = 1 << 32
_QUARTER = 1 << 30


def increments(previous: tuple[int, ...], current: tuple[int, ...]) -> tuple[Continuity, tuple[int, ...] | None]:
    """Increments of counters that live and die together, with how they came about.

    A counter that fell has wrapped at 2^32 only if it stood in the last quarter below 2^32, moved by less than a
    quarter of it, and some other counter of the group went on; when all that moved fell, the group was reset and no
    increment is known. So a wrap of every counter in one interval reads as a reset: a gap, never a wrong rate.
    """
    steps = [now - before for before, now in zip(previous, current, strict=True)]
    if min(steps) >= 0:
        return Continuity.STEADY, tuple(steps)
    if max(steps) <= 0:
        return Continuity.RESET, None
    for place, step in enumerate(steps):
        if step < 0:
            wrapped = step + _WRAP
            if not (_WRAP - _QUARTER <= previous[place] < _WRAP and wrapped < _QUARTER):
                return Continuity.RESET, None
            steps[place] = wrapped
    return Continuity.WRAPPED, tuple(steps)

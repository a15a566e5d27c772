"""Where lost probes were lost: on the way there or back, from the reflector's own sequence (RFC 8762, 4.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Floats

UNANSWERED = ("lost", "lost forward", "lost back")


def share_lost_back(session: Floats, sequence: Floats, reflected: Floats, state: NDArray[np.object_]) -> Floats:
    """For each probe that was never answered, how likely its answer was lost on the way back; NaN where unknown.

    0 is lost on the way there, 1 on the way back. Where both ways lost within one gap between two answered probes,
    the reflector's numbers say how many each (those that never came belong to probes that did arrive there), but not
    which: each of that gap has the share, so that their sum is exact. reflected: the reflector's numbers, NaN unknown.
    """
    import numpy as np

    share = np.full(len(state), np.nan)
    share[state == "lost forward"] = 0.0
    share[state == "lost back"] = 1.0
    lost = state == "lost"
    for each in np.unique(session[lost]):
        rows = np.flatnonzero(session == each)
        rows = rows[np.argsort(sequence[rows], kind="stable")]
        _fill(share, rows, sequence[rows], reflected[rows], lost[rows])
    return share


def _fill(share: Floats, rows: NDArray[np.intp], sequence: Floats, reflected: Floats, lost: NDArray[np.bool_]) -> None:
    """One session in the order of sending."""
    import numpy as np

    answered = np.flatnonzero(np.isfinite(reflected))
    if not len(answered) or bool(np.all(reflected[answered] == sequence[answered])):
        return  # a stateless reflector copies our numbers
    seen = np.unique(reflected[answered])
    # before the first answer the reflector had counted from 0, if the recording holds the session from its start
    start = [-1.0 if sequence[0] == 1 else np.nan]
    below, above = np.concatenate((start, reflected[answered[:-1]])), reflected[answered]
    between = np.searchsorted(seen, above, "left") - np.searchsorted(seen, below, "right")
    missing = above - below - 1 - between
    gap = np.diff(np.concatenate(([0], np.cumsum(lost)[answered])))
    told = (gap > 0) & (above > below) & (missing <= gap)  # else the reflector began again, or packets were doubled
    shares = np.where(told, missing / np.maximum(gap, 1), np.nan)
    which = np.searchsorted(answered, np.flatnonzero(lost))
    inside = which < len(answered)  # after the last answer nothing is known
    share[rows[lost][inside]] = shares[which[inside]]

"""Tables of many peers, connections or topics in one: taken apart by name; and how far a counter rose."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns, Floats


def by_names(table: Columns, *names: str) -> dict[tuple[str, ...], Columns]:
    """One table for each combination of the words in the columns `names`, in the order of first appearance."""
    import numpy as np

    rows: dict[tuple[str, ...], list[int]] = {}
    for row, key in enumerate(zip(*(table[name].tolist() for name in names), strict=True)):
        rows.setdefault(tuple("" if word is None else str(word) for word in key), []).append(row)
    if len(rows) == 1:
        return {next(iter(rows)): table}
    picks = {key: np.array(found) for key, found in rows.items()}
    return {key: {name: column[found] for name, column in table.items()} for key, found in picks.items()}


def steps(counter: Floats, restarted: NDArray[np.bool_] | None = None) -> Floats:
    """Increase to each sample from the one before, 0 for the first; a fall is a restart from zero.

    `restarted`: samples at which the counter is known to have begun anew. NaN where either sample is unknown.
    """
    import numpy as np

    if not len(counter):
        return np.zeros(0)
    step = np.diff(counter, prepend=counter[:1])
    again = step < 0
    if restarted is not None:
        again = again | restarted
        again[0] = False
    return np.where(again, counter, step)


def rise(
    counter: Floats | None, restarted: NDArray[np.bool_] | None = None, *, from_zero: bool = False
) -> float | None:
    """How far a counter rose from its first known sample to its last; `None` where it never was known.

    from_zero: what it counts began while it was watched, so the first sample counts too.
    """
    import numpy as np

    if counter is None:
        return None
    known = np.isfinite(counter)
    if not known.any():
        return None
    if restarted is not None and not known.all():
        # a restart between two known samples belongs to the later one
        marks = np.cumsum(restarted)[known]
        restarted = np.diff(marks, prepend=marks[:1]) > 0
    values = counter[known]
    return float(steps(values, restarted).sum() + (values[0] if from_zero else 0.0))


def last_word(column: NDArray[np.object_] | None) -> str | None:
    """The last word that is known."""
    if column is None:
        return None
    return next((str(word) for word in reversed(column.tolist()) if word), None)


def usual_word(column: NDArray[np.object_] | None) -> str | None:
    """The most frequent word."""
    words = [str(word) for word in column.tolist() if word] if column is not None else []
    return max(set(words), key=words.count) if words else None


def quantile(values: Floats, probability: float) -> float | None:
    """A quantile of the known values."""
    import numpy as np

    known = values[np.isfinite(values)]
    return float(np.quantile(known, probability)) if len(known) else None

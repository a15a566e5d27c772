"""Thinning a line for the screen without hiding what matters: extremes and gaps stay."""

from __future__ import annotations

import numpy as np

from .view import Floats


def thin(t_s: Floats, value: Floats, most: int = 2000) -> tuple[Floats, Floats]:
    """At most about `most` points of a line: of each bucket of equal count the lowest and highest value, and one NaN
    where the bucket holds a gap. Lines of `most` points or fewer come back as they are.

    Raises:
        ValueError: the two arrays differ in length.
    """
    if len(t_s) != len(value):
        raise ValueError(f"t_s has {len(t_s)} values and value has {len(value)}")
    if len(t_s) <= most:
        return t_s, value
    buckets = max(1, most // 3)
    per = -(-len(value) // buckets)
    padded = np.full(per * buckets, np.nan)
    padded[: len(value)] = value
    grid = padded.reshape(buckets, per)
    known = np.isfinite(grid)
    some = known.any(axis=1)
    starts = np.arange(buckets) * per
    low = starts + np.where(known, grid, np.inf).argmin(axis=1)
    high = starts + np.where(known, grid, -np.inf).argmax(axis=1)
    inside = np.arange(per * buckets).reshape(buckets, per) < len(value)
    hole = starts + (~known & inside).argmax(axis=1)
    holed = (~known & inside).any(axis=1)
    keep = np.unique(np.concatenate([low[some], high[some], hole[holed]]))
    return t_s[keep], value[keep]


def thin_points(t_s: Floats, value: Floats, most: int = 6000) -> tuple[Floats, Floats]:
    """At most about `most` points of a cloud: every k-th known point, so that the density stays true, and of each
    bucket the highest, so that no outlier is hidden.

    Raises:
        ValueError: the two arrays differ in length.
    """
    if len(t_s) != len(value):
        raise ValueError(f"t_s has {len(t_s)} values and value has {len(value)}")
    known = np.flatnonzero(np.isfinite(value))
    if len(known) <= most:
        return t_s[known], value[known]
    even = known[:: -(-len(known) // (most * 9 // 10))]
    buckets = np.array_split(known, max(1, most // 10))
    peaks = np.array([bucket[value[bucket].argmax()] for bucket in buckets if len(bucket)])
    keep = np.union1d(even, peaks)
    return t_s[keep], value[keep]

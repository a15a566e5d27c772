"""Standing still against moving, at the same distance: rest near the antenna is no merit of rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from .effects import Effect, paired_effect
from .motion import moving_window, position_at, still_window
from .run import Run

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BIN_M = 2.0
MIN_S = 2.0  # a distance counts where the robot both stood and moved at least so long


class StillMoving(msgspec.Struct, frozen=True, kw_only=True):
    """One run's throughput standing still less that while moving, Mbit/s."""

    raw: float | None = None
    matched: float | None = None
    matched_s: float = 0.0  # seconds of standing still that found a partner


def still_against_moving(run: Run) -> StillMoving:
    """Difference of throughput, raw and at matched distance from the place where the run began."""
    import numpy as np

    still, _ = still_window(run)
    robot = run.robot
    iface = robot.primary if robot is not None else None
    table = robot.utilization.get(iface) if robot is not None and iface is not None else None
    pose = run.pose
    if still is None or table is None:
        return StillMoving()
    moving = moving_window(run, still)
    good = table["has_base"]
    begin, end = table["begin_s"][good], table["t_s"][good]
    if not len(begin):
        return StillMoving()
    rate = table["bits"][good] / (end - begin) / 1e6
    at_rest, in_motion = still.measure(begin, end), moving.measure(begin, end)
    # an interval that is part rest, part motion tells of neither
    pure = np.maximum(at_rest, in_motion) > 0.8 * (end - begin)
    rest, motion = (
        np.where(pure & (at_rest > in_motion), at_rest, 0),
        np.where(pure & (in_motion > at_rest), in_motion, 0),
    )
    if rest.sum() < MIN_S or motion.sum() < MIN_S:
        return StillMoving()
    raw = float((rate * rest).sum() / rest.sum() - (rate * motion).sum() / motion.sum())
    if pose is None:
        return StillMoving(raw=raw)
    x, y = position_at(run, (begin + end) / 2)
    distance = np.hypot(x - pose["x_m"][0], y - pose["y_m"][0])
    known = np.isfinite(distance)
    cell = (distance[known] / BIN_M).astype(np.int64)
    n = int(cell.max()) + 1 if len(cell) else 0
    t_rest, t_motion = np.bincount(cell, rest[known], n), np.bincount(cell, motion[known], n)
    v_rest = np.bincount(cell, (rate * rest)[known], n)
    v_motion = np.bincount(cell, (rate * motion)[known], n)
    both = (t_rest >= MIN_S) & (t_motion >= MIN_S)
    if not both.any():
        return StillMoving(raw=raw)
    weight = np.minimum(t_rest[both], t_motion[both])
    difference = v_rest[both] / t_rest[both] - v_motion[both] / t_motion[both]
    return StillMoving(
        raw=raw, matched=float((weight * difference).sum() / weight.sum()), matched_s=float(t_rest[both].sum())
    )


def still_effects(runs: Sequence[Run]) -> list[Effect]:
    """The effect of standing still on throughput over trials: raw, and at matched distance."""
    found = [still_against_moving(run) for run in runs]
    base = Effect(
        factor="motion",
        low="moving",
        high="still",
        metric="throughput",
        unit="Mbit/s",
        ratio=False,
        better="high",
        trials=0,
        strata=0,
    )
    raw = paired_effect(base, [f.raw for f in found if f.raw is not None])
    matched = paired_effect(
        msgspec.structs.replace(base, matched=f"distance from the start, {BIN_M:g} m bins"),
        [f.matched for f in found if f.matched is not None],
    )
    return [raw, matched]

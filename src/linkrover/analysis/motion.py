"""Where the robot was, how far it drove, and when it stood still."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from .window import Window

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Run

    Floats = NDArray[np.float64]

STILL_M_PER_S = 0.05
STILL_RAD_PER_S = 0.1
POSE_HOLD_S = 1.5
BY_ODOMETRY = f"odometry: below {STILL_M_PER_S} m/s and {STILL_RAD_PER_S} rad/s"
BY_COMMAND = "last velocity command: zero forward and zero turn (the paper's rule)"


class MotionFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Odometry of one run: metres, seconds, m/s."""

    rule: str | None = None  # by which the robot counts as standing still
    static_percent: float | None = None
    driven_m: float | None = None
    farthest_m: float | None = None  # from the place where the run began
    speed_mean: float | None = None  # while moving
    speed_max: float | None = None
    extent_m: tuple[float, float] | None = None
    reason: str | None = None


def still_window(run: Run) -> tuple[Window | None, str | None]:
    """When the robot stood still, and the rule by which; `None` without odometry and commands."""
    import numpy as np

    end = run.robot
    command = end.command if end is not None else None
    if run.published_2021 and command is not None:
        still = (command["forward_m_per_s"] == 0) & (command["turn_rad_per_s"] == 0)
        known = Window.of(float(command["t_s"][0]), float(run.span.ends[-1]))
        return _within(Window.from_flags(command["t_s"], still, float(run.span.ends[-1])), known, run), BY_COMMAND
    pose = run.pose
    if pose is None or len(pose["t_s"]) < 2:
        return None, None
    t = pose["t_s"]
    step = np.maximum(np.diff(t), 1e-6)
    forward, turn = pose.get("forward_m_per_s"), pose.get("turn_rad_per_s")
    if forward is None or np.isnan(forward).all():
        forward = np.append(np.hypot(np.diff(pose["x_m"]), np.diff(pose["y_m"])) / step, 0.0)
    if turn is None or np.isnan(turn).all():
        turned = np.diff(np.unwrap(pose["heading_rad"])) / step
        turn = np.append(turned, 0.0)
    still = (np.abs(np.nan_to_num(forward)) < STILL_M_PER_S) & (np.abs(np.nan_to_num(turn)) < STILL_RAD_PER_S)
    return _within(Window.from_flags(t, still, float(t[-1])), _known(t), run), BY_ODOMETRY


def moving_window(run: Run, still: Window) -> Window:
    """When the robot is known to have moved."""
    end = run.robot
    if run.published_2021 and end is not None and end.command is not None:
        known = Window.of(float(end.command["t_s"][0]), float(run.span.ends[-1]))
    else:
        assert run.pose is not None
        known = _known(run.pose["t_s"])
    return known.intersect(run.span).without(still)


def _known(t: Floats) -> Window:
    """A pose speaks until the next one, but not over a hole in the odometry."""
    import numpy as np

    flags = np.append(np.diff(t) < POSE_HOLD_S, True)
    return Window.from_flags(t, flags, float(t[-1]))


def _within(still: Window, known: Window, run: Run) -> Window:
    return still.intersect(known).intersect(run.span)


def motion_figures(run: Run, still: Window | None, rule: str | None) -> MotionFigures:
    """Distance, speed and share of standing still."""
    import numpy as np

    pose = run.pose
    static = None
    if still is not None:
        known = still.seconds + moving_window(run, still).seconds
        static = 100.0 * still.seconds / known if known > 0 else None
    if pose is None or len(pose["t_s"]) < 2:
        return MotionFigures(rule=rule, static_percent=static, reason="distance, speed: no odometry was recorded")
    t, x, y = pose["t_s"], pose["x_m"], pose["y_m"]
    steps = np.hypot(np.diff(x), np.diff(y))
    # odometry that jumps was reset: the jump was not driven
    driven = float(steps[steps < 5.0 * np.maximum(np.diff(t), 0.02) + 0.05].sum())
    seconds = float(t[-1] - t[0])
    moving = seconds - (still.seconds if still is not None else 0.0)
    forward = pose.get("forward_m_per_s")
    top = float(np.nanmax(np.abs(forward))) if forward is not None and np.isfinite(forward).any() else None
    return MotionFigures(
        rule=rule,
        static_percent=static,
        driven_m=driven,
        farthest_m=float(np.hypot(x - x[0], y - y[0]).max()),
        speed_mean=driven / moving if moving > 1.0 else None,
        speed_max=top,
        extent_m=(float(np.ptp(x)), float(np.ptp(y))),
    )


def position_at(run: Run, times: Floats) -> tuple[Floats, Floats]:
    """Robot position at given times, m; NaN where no odometry is near."""
    import numpy as np

    pose = run.pose
    if pose is None or not len(pose["t_s"]):
        nothing = np.full(len(times), np.nan)
        return nothing, nothing.copy()
    t = pose["t_s"]
    x, y = np.interp(times, t, pose["x_m"]), np.interp(times, t, pose["y_m"])
    at = np.clip(np.searchsorted(t, times), 1, max(len(t) - 1, 1))
    near = np.minimum(np.abs(times - t[at - 1]), np.abs(t[np.minimum(at, len(t) - 1)] - times)) < POSE_HOLD_S
    return np.where(near, x, np.nan), np.where(near, y, np.nan)

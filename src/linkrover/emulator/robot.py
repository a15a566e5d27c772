"""A differential-drive robot that executes velocity commands, and the operator who steers it along waypoints.

Both are pure steppers with explicit time (monotonic ns): the real-time emulation feeds the robot with the commands
that really crossed the link, virtual time with those its model delivered. Speeds, stops and extent follow the 2021
drives: 74-93 m, 12-19 x 10-16 m, commands 0 or 0.5 m/s and 0 or 1.5 rad/s, still 11-35 % of the time.
"""

from __future__ import annotations

import math
import random

import msgspec

from linkrover.errors import ConfigError
from linkrover.records import Now, Pose

ODOMETRY_HZ = 50
COMMAND_HZ = 10
REACHED_M = 0.3
TURN_IN_PLACE_RAD = 0.35


class Waypoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A point of the route, metres, and how long the robot stands there, seconds."""

    x_m: float
    y_m: float
    stop_s: float = 0.0


class Drive(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the robot moves. The defaults are the 2021 robot's commands.

    command_timeout_s: without a new command for this long the robot stops. backtrack_after_s: without one for this
    long it drives back along its own trail at backtrack_m_per_s until commands arrive again.
    """

    cruise_m_per_s: float = 0.5
    turn_rad_per_s: float = 1.5
    acceleration_m_per_s2: float = 1.0
    turn_acceleration_rad_per_s2: float = 6.0
    command_timeout_s: float = 0.6
    backtrack_after_s: float = 6.0
    backtrack_m_per_s: float = 0.25
    odometry_error: float = 0.005  # standard deviation of the scale errors of distance and turn

    def __post_init__(self) -> None:
        for key in (
            "cruise_m_per_s",
            "turn_rad_per_s",
            "acceleration_m_per_s2",
            "turn_acceleration_rad_per_s2",
            "command_timeout_s",
            "backtrack_after_s",
            "backtrack_m_per_s",
        ):
            if not getattr(self, key) > 0:
                raise ConfigError(f"drive.{key} must be above 0, got {getattr(self, key)}")
        if not 0 <= self.odometry_error < 0.5:
            raise ConfigError(f"drive.odometry_error must be in [0, 0.5), got {self.odometry_error}")


class Route(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Waypoints in order; the robot starts on the first one, facing the second."""

    waypoints: tuple[Waypoint, ...]

    def __post_init__(self) -> None:
        if len(self.waypoints) < 2:
            raise ConfigError(f"trajectory.waypoints must hold at least 2 points, got {len(self.waypoints)}")
        for index, point in enumerate(self.waypoints):
            if not (math.isfinite(point.x_m) and math.isfinite(point.y_m)):
                raise ConfigError(f"trajectory.waypoints[{index}] must be finite metres, got {point.x_m}, {point.y_m}")
            if not point.stop_s >= 0:
                raise ConfigError(f"trajectory.waypoints[{index}].stop_s must be 0 or more, got {point.stop_s}")

    @property
    def length_m(self) -> float:
        """Length of the polyline."""
        pairs = zip(self.waypoints, self.waypoints[1:], strict=False)
        return sum(math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in pairs)

    @property
    def farthest_m(self) -> float:
        """Largest distance of a waypoint from the start."""
        start = self.waypoints[0]
        return max(math.dist((start.x_m, start.y_m), (p.x_m, p.y_m)) for p in self.waypoints)

    @property
    def start_heading_rad(self) -> float:
        """Direction of the first leg."""
        a, b = self.waypoints[:2]
        return math.atan2(b.y_m - a.y_m, b.x_m - a.x_m)

    def nominal_s(self, drive: Drive | None = None) -> float:
        """How long the drive takes when every command arrives: legs, turns in place, stops."""
        drive = drive or Drive()
        seconds = self.length_m / drive.cruise_m_per_s + sum(p.stop_s for p in self.waypoints)
        heading = self.start_heading_rad
        for a, b in zip(self.waypoints, self.waypoints[1:], strict=False):
            leg = math.atan2(b.y_m - a.y_m, b.x_m - a.x_m)
            turn = abs(wrap(leg - heading))
            if turn > TURN_IN_PLACE_RAD:
                # a stop and a start around each turn cost about half a second at these accelerations
                seconds += turn / drive.turn_rad_per_s + 0.5
            heading = leg
        return seconds

    def scaled(self, factor: float) -> Route:
        """The same shape, `factor` times as large, stops as much longer or shorter."""
        if not factor > 0:
            raise ConfigError(f"a route can be scaled by a factor above 0, got {factor}")
        start = self.waypoints[0]
        return Route(
            waypoints=tuple(
                Waypoint(
                    start.x_m + (p.x_m - start.x_m) * factor,
                    start.y_m + (p.y_m - start.y_m) * factor,
                    p.stop_s * factor,
                )
                for p in self.waypoints
            )
        )

    def turned(self, angle_rad: float) -> Route:
        """The same route, turned about its start: where another robot drives."""
        start, cos, sin = self.waypoints[0], math.cos(angle_rad), math.sin(angle_rad)
        return Route(
            waypoints=tuple(
                Waypoint(
                    start.x_m + cos * (p.x_m - start.x_m) - sin * (p.y_m - start.y_m),
                    start.y_m + sin * (p.x_m - start.x_m) + cos * (p.y_m - start.y_m),
                    p.stop_s,
                )
                for p in self.waypoints
            )
        )

    def fitted(self, duration_s: float, drive: Drive | None = None) -> Route:
        """The route made smaller (never larger) so that the drive is over in duration_s.

        Raises:
            ConfigError: duration_s is not positive.
        """
        if not duration_s > 0:
            raise ConfigError(f"duration must be above 0 s, got {duration_s}")
        if self.nominal_s(drive) <= duration_s:
            return self
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if self.scaled(middle).nominal_s(drive) <= duration_s else (low, middle)
        # turns alone may take longer than a very short run lasts: then the robot gets as far as it gets
        return self.scaled(max(low, 0.02))


LAB_2021 = Route(
    waypoints=(
        Waypoint(0, 0, 8),
        Waypoint(7, 0, 4),
        Waypoint(7, 5, 6),
        Waypoint(13, 5, 6),
        Waypoint(15.5, 8.5, 14),
        Waypoint(11, 11, 5),
        Waypoint(4, 11, 6),
        Waypoint(4, 6, 4),
        Waypoint(10, 5.5, 3),
        Waypoint(12, 1, 8),
        Waypoint(16, 2, 10),
        Waypoint(11, 0, 4),
        Waypoint(5, -1, 3),
        Waypoint(2, 4, 5),
        Waypoint(-1, 1, 3),
        Waypoint(0, 0, 2),
    )
)
"""About 77 m, 17 x 12 m, at most 17.7 m away, some 260 s: like the drives of 2021 (their floor plan is not public)."""

OUT_AND_BACK = Route(
    waypoints=(Waypoint(0, 0, 2), Waypoint(8, 1, 3), Waypoint(15, -1.5, 5), Waypoint(8, -1, 2), Waypoint(0, 0, 2))
)
"""The demo's drive: away from the start and back, about 31 m and 81 s before it is fitted to the duration."""

ROUTES = {"lab-2021": LAB_2021, "out-and-back": OUT_AND_BACK}


def wrap(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.atan2(math.sin(angle_rad), math.cos(angle_rad))


class Operator:
    """Steers by sight: sees where the robot is, sends keys at 10 Hz. Gives up a waypoint the robot was lost at."""

    def __init__(self, route: Route, drive: Drive | None = None) -> None:
        self.route = route
        self.drive = drive or Drive()
        self.next_waypoint = 0
        self._standing_since_ns: int | None = None

    @property
    def done(self) -> bool:
        """Whether the whole route is driven."""
        return self.next_waypoint >= len(self.route.waypoints)

    def skip(self) -> None:
        """Give the present waypoint up, because the robot lost the link on the way to it. Home is never given up."""
        if self.next_waypoint < len(self.route.waypoints) - 1:
            self.next_waypoint += 1
            self._standing_since_ns = None

    def command(self, now_ns: int, x_m: float, y_m: float, heading_rad: float) -> tuple[float, float]:
        """The command for a robot seen at that pose: forward m/s, turn rad/s."""
        while not self.done:
            point = self.route.waypoints[self.next_waypoint]
            distance = math.dist((point.x_m, point.y_m), (x_m, y_m))
            if self._standing_since_ns is None and distance > min(REACHED_M, 0.05 * self.route.farthest_m + 0.02):
                return self._towards(point, x_m, y_m, heading_rad, distance)
            if self._standing_since_ns is None:
                self._standing_since_ns = now_ns
            if now_ns - self._standing_since_ns < point.stop_s * 1e9:
                return 0.0, 0.0
            self._standing_since_ns = None
            self.next_waypoint += 1
        return 0.0, 0.0

    def _towards(self, point: Waypoint, x_m: float, y_m: float, heading: float, distance: float) -> tuple[float, float]:
        error = wrap(math.atan2(point.y_m - y_m, point.x_m - x_m) - heading)
        if abs(error) > TURN_IN_PLACE_RAD:
            # key taps near the end: at full rate a command that arrives 100 ms late turns 0.15 rad too far
            rate = self.drive.turn_rad_per_s * (1.0 if abs(error) > 0.8 else 0.5)
            return 0.0, math.copysign(rate, error)
        forward = self.drive.cruise_m_per_s * (1.0 if distance > 0.5 else 0.5)
        return forward, max(-0.6, min(0.6, 1.5 * error))


class Robot:
    """Integrates the pose from the commands it was given; stops, then backtracks, when they stay away."""

    def __init__(self, route: Route, drive: Drive | None = None, seed: int = 0) -> None:
        self.drive = drive or Drive()
        start = route.waypoints[0]
        self.x_m, self.y_m, self.heading_rad = start.x_m, start.y_m, route.start_heading_rad
        self.forward_m_per_s = self.turn_rad_per_s = 0.0
        self.travelled_m = 0.0
        self.backtracking = False
        draw = random.Random(seed)
        self._scale = draw.gauss(1, self.drive.odometry_error)
        self._turn_scale = draw.gauss(1, self.drive.odometry_error)
        self._odometry = (start.x_m, start.y_m, self.heading_rad)
        self._target = (0.0, 0.0)
        self._last_step_ns: int | None = None
        self._last_command_ns: int | None = None
        self._trail: list[tuple[float, float]] = [(self.x_m, self.y_m)]

    def command(self, now_ns: int, forward_m_per_s: float, turn_rad_per_s: float) -> None:
        """A velocity command has arrived."""
        limit, turn_limit = self.drive.cruise_m_per_s, self.drive.turn_rad_per_s
        self._target = (max(-limit, min(limit, forward_m_per_s)), max(-turn_limit, min(turn_limit, turn_rad_per_s)))
        self._last_command_ns = now_ns
        self.backtracking = False

    def step(self, now_ns: int) -> None:
        """Move on to now_ns (nothing happens when time did not pass)."""
        if self._last_step_ns is None:
            self._last_step_ns = now_ns
        dt = (now_ns - self._last_step_ns) / 1e9
        if dt <= 0:
            return
        self._last_step_ns = now_ns
        forward, turn = self._wanted(now_ns)
        self.forward_m_per_s = _approach(self.forward_m_per_s, forward, self.drive.acceleration_m_per_s2 * dt)
        self.turn_rad_per_s = _approach(self.turn_rad_per_s, turn, self.drive.turn_acceleration_rad_per_s2 * dt)
        way, angle = self.forward_m_per_s * dt, self.turn_rad_per_s * dt
        self.x_m, self.y_m, self.heading_rad = _move((self.x_m, self.y_m, self.heading_rad), way, angle)
        self._odometry = _move(self._odometry, way * self._scale, angle * self._turn_scale)
        self.travelled_m += abs(way)
        if not self.backtracking and math.dist(self._trail[-1], (self.x_m, self.y_m)) > 0.2:
            self._trail.append((self.x_m, self.y_m))

    def odometry(self, now: Now) -> Pose:
        """What the wheels say: the true motion with this robot's scale errors."""
        x, y, heading = self._odometry
        return Pose(
            wall_ns=now.wall_ns,
            mono_ns=now.mono_ns,
            x_m=x,
            y_m=y,
            heading_rad=wrap(heading),
            forward_m_per_s=self.forward_m_per_s * self._scale,
            turn_rad_per_s=self.turn_rad_per_s * self._turn_scale,
        )

    def true_pose(self, now: Now) -> Pose:
        """Where it really is, in frame "map"."""
        return Pose(
            wall_ns=now.wall_ns,
            mono_ns=now.mono_ns,
            x_m=self.x_m,
            y_m=self.y_m,
            heading_rad=wrap(self.heading_rad),
            forward_m_per_s=self.forward_m_per_s,
            turn_rad_per_s=self.turn_rad_per_s,
            frame="map",
        )

    def _wanted(self, now_ns: int) -> tuple[float, float]:
        if self._last_command_ns is None:
            return 0.0, 0.0
        silent_s = (now_ns - self._last_command_ns) / 1e9
        if silent_s <= self.drive.command_timeout_s:
            return self._target
        if silent_s <= self.drive.backtrack_after_s:
            return 0.0, 0.0
        self.backtracking = True
        while self._trail and math.dist(self._trail[-1], (self.x_m, self.y_m)) < 0.15:
            self._trail.pop()
        if not self._trail:
            self._trail.append((self.x_m, self.y_m))
            return 0.0, 0.0
        # in reverse: its back points to where it came from
        x, y = self._trail[-1]
        error = wrap(math.atan2(self.y_m - y, self.x_m - x) - self.heading_rad)
        if abs(error) > 0.6:
            return 0.0, math.copysign(min(0.8, self.drive.turn_rad_per_s), error)
        return -self.drive.backtrack_m_per_s, max(-0.8, min(0.8, 1.5 * error))


def _approach(value: float, target: float, step: float) -> float:
    return max(value - step, min(value + step, target))


def _move(pose: tuple[float, float, float], way: float, angle: float) -> tuple[float, float, float]:
    x, y, heading = pose
    middle = heading + angle / 2
    return x + way * math.cos(middle), y + way * math.sin(middle), heading + angle

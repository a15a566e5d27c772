"""Floor plan: walls as line segments; what a straight path loses on them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from linkrover.errors import ConfigError

from .values import require_finite, require_not_negative

if TYPE_CHECKING:
    from .values import Array


class Wall(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A wall from (x1, y1) to (x2, y2), metres, and what crossing it costs, dB.

    Raises:
        ConfigError: no length, not finite, or a negative loss.
    """

    x1_m: float
    y1_m: float
    x2_m: float
    y2_m: float
    loss_db: float = 5.0

    def __post_init__(self) -> None:
        require_finite("wall", x1_m=self.x1_m, y1_m=self.y1_m, x2_m=self.x2_m, y2_m=self.y2_m)
        require_not_negative("wall", loss_db=self.loss_db)
        if (self.x1_m, self.y1_m) == (self.x2_m, self.y2_m):
            raise ConfigError(f"wall at ({self.x1_m}, {self.y1_m}): must have two different ends")


class FloorPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Walls within [x_min_m, x_max_m] x [y_min_m, y_max_m].

    Raises:
        ConfigError: a wall outside the plan, or an empty extent.
    """

    walls: tuple[Wall, ...] = ()
    x_min_m: float = -1000.0
    y_min_m: float = -1000.0
    x_max_m: float = 1000.0
    y_max_m: float = 1000.0

    def __post_init__(self) -> None:
        if not (self.x_min_m < self.x_max_m and self.y_min_m < self.y_max_m):
            raise ConfigError("floor plan: x_max_m must be above x_min_m, and y_max_m above y_min_m")
        for index, wall in enumerate(self.walls):
            for x, y in ((wall.x1_m, wall.y1_m), (wall.x2_m, wall.y2_m)):
                if not (self.x_min_m <= x <= self.x_max_m and self.y_min_m <= y <= self.y_max_m):
                    raise ConfigError(
                        f"walls[{index}]: ({x}, {y}) lies outside the plan, which is x {self.x_min_m} to "
                        f"{self.x_max_m} m, y {self.y_min_m} to {self.y_max_m} m"
                    )

    def crossed(self, ax: float, ay: float, bx: float, by: float) -> tuple[int, float]:
        """Walls that the straight path from a to b crosses, and their loss in dB."""
        count, loss = 0, 0.0
        for wall in self.walls:
            if _crosses(ax, ay, bx, by, wall):
                count += 1
                loss += wall.loss_db
        return count, loss

    def loss_db(self, ax: Any, ay: Any, bx: Any, by: Any) -> Array:
        """Loss of straight paths, for arrays of end points (broadcast against each other)."""
        import numpy as np

        ax, ay, bx, by = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (ax, ay, bx, by)))
        total = np.zeros(ax.shape)
        for wall in self.walls:
            total += wall.loss_db * _crosses(ax, ay, bx, by, wall)
        return total


def load_floor_plan(path: Path) -> FloorPlan:
    """A floor plan from a TOML file: [[walls]] with x1_m, y1_m, x2_m, y2_m and loss_db, and the extent if wanted.

    Raises:
        ConfigError: the file cannot be read, or is no floor plan; names the file and what is wrong.
    """
    try:
        return msgspec.toml.decode(path.read_bytes(), type=FloorPlan)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (msgspec.DecodeError, ConfigError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error


def _crosses(ax: Any, ay: Any, bx: Any, by: Any, wall: Wall) -> Any:
    """Whether the segments cross; touching counts from one side only, so that a path along a joint counts once."""
    ux, uy = wall.x2_m - wall.x1_m, wall.y2_m - wall.y1_m
    side_a = ux * (ay - wall.y1_m) - uy * (ax - wall.x1_m) >= 0
    side_b = ux * (by - wall.y1_m) - uy * (bx - wall.x1_m) >= 0
    vx, vy = bx - ax, by - ay
    side_1 = vx * (wall.y1_m - ay) - vy * (wall.x1_m - ax) >= 0
    side_2 = vx * (wall.y2_m - ay) - vy * (wall.x2_m - ax) >= 0
    return (side_a != side_b) & (side_1 != side_2)

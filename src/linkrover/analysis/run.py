"""One run in memory: the samples of both ends on one clock, as columns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from linkrover.records import LinkEvent, Manifest, ScanSnapshot

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .window import Window

    Floats = NDArray[np.float64]
    Column = NDArray[Any]
    Columns = dict[str, Column]  # "t_s" seconds of the run, "wall_ns" of the end's own clock, then record fields

HOLD_S = 3.0  # an end that has been silent for longer than this says nothing about now


@dataclass(slots=True)
class End:
    """What one end recorded. A missing topic is `None` or an empty dictionary."""

    role: str
    manifest: Manifest | None = None
    utilization: dict[str, Columns] = field(default_factory=dict)
    errors: dict[str, Columns] = field(default_factory=dict)
    wireless: dict[str, Columns] = field(default_factory=dict)
    probe: Columns | None = None
    delays: dict[str, Columns] = field(default_factory=dict)  # application delay by method
    offset: Columns | None = None
    pose: Columns | None = None
    command: Columns | None = None
    events: tuple[tuple[float, LinkEvent], ...] = ()
    traffic: dict[tuple[str, str, str, str], Columns] = field(default_factory=dict)  # (topic, direction, peer, node)
    stations: dict[str, Columns] = field(default_factory=dict)  # every peer of an interface, by "peer"
    surveys: dict[tuple[str, int], Columns] = field(default_factory=dict)  # (interface, MHz)
    connections: dict[str, Columns] = field(default_factory=dict)  # every TCP connection of an interface
    scans: tuple[tuple[float, ScanSnapshot], ...] = ()
    account: Columns | None = None
    alive: Window | None = None  # when this end was heard of within HOLD_S

    @property
    def interfaces(self) -> list[str]:
        """Names of all interfaces there is anything about."""
        return sorted({*self.utilization, *self.errors, *self.wireless})

    @property
    def primary(self) -> str | None:
        """The interface that carried the most bytes; without counters the one with readings."""
        import numpy as np

        def weight(iface: str) -> tuple[float, int]:
            moved = self.utilization.get(iface)
            carried = float(np.nansum(moved["bits"])) if moved is not None else 0.0
            heard = self.wireless.get(iface)
            return carried, int(np.isfinite(heard["rssi_dbm"]).sum()) if heard is not None else 0

        return max(self.interfaces, key=weight, default=None)


@dataclass(slots=True)
class Clock:
    """How the station's clock was brought onto the robot's."""

    method: str = "none"  # "probe", "same machine", "wall clocks as they are"
    offset_ns: int | None = None  # station minus robot at the start
    error_bound_ns: int | None = None


@dataclass(slots=True)
class Run:
    """Both ends of one run. `problems`: damaged or missing; `repairs`: mended at import."""

    name: str
    path: str
    ends: dict[str, End]
    origin_ns: int  # wall time of t_s = 0 on the robot's clock
    span: Window
    clock: Clock
    case: str | None = None
    trial: int | None = None
    factors: dict[str, str] = field(default_factory=dict)
    published_2021: bool = False  # messages of the 2021 package: throughput per loop, pings one after the other
    problems: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()
    truth: dict[str, Columns] = field(default_factory=dict)
    summary_rows: dict[str, list[float]] = field(default_factory=dict)
    rows_in_file: int | None = None

    @property
    def robot(self) -> End | None:
        """The moving end."""
        return self.ends.get("robot")

    @property
    def station(self) -> End | None:
        """The standing end."""
        return self.ends.get("station")

    @property
    def pose(self) -> Columns | None:
        """Odometry, wherever it was recorded."""
        for end in self.ends.values():
            if end.pose is not None:
                return end.pose
        return None

"""What a drawing needs of one run: lines over time, the path, outages and words, free of how it was measured."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from .page import Table

Floats = npt.NDArray[np.float64]

UNITS = {"rssi": "dBm", "throughput": "Mbit/s", "delay": "ms", "one-way": "ms", "channel": "%", "noise": "dBm"}


@dataclass(frozen=True)
class Line:
    """One quantity over time. t_s: seconds since the run began; value in UNITS[kind]; NaN = unknown."""

    kind: str
    name: str
    end: str
    t_s: Floats
    value: Floats
    iface: str = ""
    direction: str = ""
    method: str = ""


@dataclass(frozen=True)
class Path:
    """Where the robot was: metres in its odometry frame at t_s."""

    t_s: Floats
    x_m: Floats
    y_m: Floats

    def at(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Position at times t_s (s), linear between poses, NaN outside the path."""
        x = np.interp(t_s, self.t_s, self.x_m, left=np.nan, right=np.nan)
        y = np.interp(t_s, self.t_s, self.y_m, left=np.nan, right=np.nan)
        return x, y


@dataclass(frozen=True)
class OutageView:
    """A stretch without a successful probe, seconds since the run began."""

    start_s: float
    end_s: float


@dataclass(frozen=True)
class EventView:
    """One line of the timeline."""

    t_s: float
    end: str
    kind: str
    text: str


@dataclass(frozen=True)
class PartView:
    """A part of a run's section: a heading, sentences, tables."""

    heading: str
    words: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True)
class RunView:
    """Everything the report shows of one run. `summary` is the run's object of the JSON report."""

    name: str
    case: str
    trial: int | None
    duration_s: float
    summary: dict[str, Any]
    lines: tuple[Line, ...] = ()
    lost_t_s: Floats = field(default_factory=lambda: np.empty(0))
    path: Path | None = None
    outages: tuple[OutageView, ...] = ()
    events: tuple[EventView, ...] = ()
    recoveries: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    parts: tuple[PartView, ...] = ()
    setup: dict[str, dict[str, str]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()
    kind: str = "measured"  # measured, emulated, simulated, imported

    def of(self, kind: str) -> list[Line]:
        """The lines of one kind that hold at least one value, over time: throughput by direction."""
        return [line for line in self._known(kind) if line.direction != "both"]

    def over_floor(self, kind: str) -> list[Line]:
        """The lines of one kind to colour a path with, the busiest interface of the robot first: throughput of both
        directions together.
        """
        lines = [line for line in self._known(kind) if line.direction in ("", "both") and line.end != "truth"]
        return sorted(lines, key=lambda x: (x.end != "robot", -float(np.nanmean(x.value)) if x.direction else 0.0))

    def _known(self, kind: str) -> list[Line]:
        return [line for line in self.lines if line.kind == kind and np.isfinite(line.value).any()]

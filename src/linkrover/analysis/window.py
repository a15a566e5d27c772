"""Sets of time: the part of a run a figure is taken over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Window:
    """Disjoint, ordered, half-open stretches of time [begin, end), in seconds of the run."""

    begins: Floats
    ends: Floats

    @staticmethod
    def of(begin: float, end: float) -> Window:
        """One stretch."""
        import numpy as np

        return Window(np.array([begin], float), np.array([max(begin, end)], float))

    @staticmethod
    def from_flags(times: Floats, flags: NDArray[np.bool_], end: float) -> Window:
        """The stretches over which a step function is true: `flags[i]` holds from `times[i]` to the next time."""
        import numpy as np

        if not len(times):
            return Window(np.zeros(0), np.zeros(0))
        edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
        stops = np.append(times, max(end, times[-1]))
        begins, ends = times[np.flatnonzero(edges == 1)], stops[np.flatnonzero(edges == -1)]
        kept = ends > begins
        return Window(begins[kept], ends[kept])

    @property
    def seconds(self) -> float:
        """Total length."""
        return float((self.ends - self.begins).sum())

    def measure(self, starts: Floats, stops: Floats) -> Floats:
        """Seconds of each interval [start, stop) that lie in this set."""
        import numpy as np

        if not len(self.begins):
            return np.zeros(len(starts))
        edges = np.stack([self.begins, self.ends], axis=1).ravel()
        total = np.concatenate(([0.0], np.cumsum(self.ends - self.begins)))
        level = np.stack([total[:-1], total[1:]], axis=1).ravel()
        return np.asarray(np.interp(stops, edges, level) - np.interp(starts, edges, level), dtype=np.float64)

    def contains(self, times: Floats) -> NDArray[np.bool_]:
        """Which instants lie in this set; its very last instant does too, so that a run's last sample counts."""
        import numpy as np

        if not len(self.begins):
            return np.zeros(len(times), bool)
        at = np.searchsorted(self.begins, times, side="right") - 1
        inside = (times < self.ends[np.maximum(at, 0)]) | (times == self.ends[-1])
        return np.asarray((at >= 0) & inside, dtype=np.bool_)

    def intersect(self, other: Window) -> Window:
        """What both have in common."""
        import numpy as np

        cuts = np.unique(np.concatenate([self.begins, self.ends, other.begins, other.ends]))
        if len(cuts) < 2:
            return Window(np.zeros(0), np.zeros(0))
        middle = (cuts[:-1] + cuts[1:]) / 2
        return Window.from_flags(cuts[:-1], self.contains(middle) & other.contains(middle), float(cuts[-1]))

    def without(self, other: Window) -> Window:
        """This set minus another."""
        import numpy as np

        cuts = np.unique(np.concatenate([self.begins, self.ends, other.begins, other.ends]))
        if len(cuts) < 2:
            return Window(np.zeros(0), np.zeros(0))
        middle = (cuts[:-1] + cuts[1:]) / 2
        return Window.from_flags(cuts[:-1], self.contains(middle) & ~other.contains(middle), float(cuts[-1]))

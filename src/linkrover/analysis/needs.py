"""Which set-up carries which traffic: needs such as "camera: 30 Mbit/s, commands: p99 below 100 ms, loss below 1 %"."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from linkrover.errors import ConfigError

from .effects import main_interface
from .run import Run
from .summary import RunSummary

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FIGURES = {
    "throughput": ("Mbit/s", True),
    "mean": ("ms", False),
    "median": ("ms", False),
    "p95": ("ms", False),
    "p99": ("ms", False),
    "loss": ("%", False),
    "outage": ("%", False),
}
_CONDITION = re.compile(
    r"(?:(?:delay\.)?(throughput|rate|mean|median|p95|p99|loss|outages?|outage time|time out))?\s*"
    r"(>=|<=|>|<|=|above|below|under|over|at least|at most)?\s*(\d+(?:\.\d+)?)\s*(mbit/s|mbps|ms|%)?",
    re.IGNORECASE,
)
AREA_CELL_M = 2.0


class Condition(msgspec.Struct, frozen=True):
    """One figure at least (throughput) or at most (delay, loss, time without answer) so much."""

    figure: str
    limit: float

    @property
    def at_least(self) -> bool:
        """Whether more is needed rather than less."""
        return FIGURES[self.figure][1]

    def text(self) -> str:
        """The condition in words."""
        unit = FIGURES[self.figure][0]
        return f"{self.figure} {'at least' if self.at_least else 'at most'} {self.limit:g} {unit}"


class Need(msgspec.Struct, frozen=True):
    """What one kind of traffic asks of the link."""

    name: str
    conditions: tuple[Condition, ...]


class Fit(msgspec.Struct, frozen=True, kw_only=True):
    """How a case meets a need. `certainty`: chance that the next trial meets all of it; `None` with one trial."""

    case: str
    need: str
    trials: int
    met: int  # trials that met every condition
    certainty: float | None = None
    worst: str | None = None  # the condition that is nearest to failing, with its figure
    area_percent: float | None = None  # share of the driven area where the need was met
    verdict: str = ""


def parse_needs(texts: Sequence[str]) -> list[Need]:
    """Several texts, each with one or several needs separated by commas; a name ends with a colon.

    "30 Mbit/s" alone is a throughput, "100 ms" the 99th percentile of the round trip. Raises ConfigError.
    """
    needs: list[tuple[str, list[Condition]]] = []
    for text in texts:
        for piece in re.split(r"[,;]", text):
            part = piece.strip()
            if ":" in part:
                name, part = (p.strip() for p in part.split(":", 1))
                needs.append((name or f"need {len(needs) + 1}", []))
            elif not needs or piece is text:
                needs.append((f"need {len(needs) + 1}", []))
            if part:
                needs[-1][1].append(_condition(part, text))
    for name, conditions in needs:
        if not conditions:
            raise ConfigError(f"need '{name}' states no condition, for example '{name}: p99 below 100 ms'")
    return [Need(name, tuple(conditions)) for name, conditions in needs]


def _condition(part: str, text: str) -> Condition:
    match = _CONDITION.fullmatch(part)
    example = 'write for example "camera: 30 Mbit/s, commands: p99 below 100 ms, loss below 1 %"'
    if match is None:
        raise ConfigError(f'"{part}" in need "{text}" is not understood; {example}')
    figure, comparison, number, unit = match.groups()
    unit = (unit or "").lower().replace("mbps", "mbit/s")
    figure = (figure or {"mbit/s": "throughput", "ms": "p99", "%": "loss"}.get(unit, "")).lower()
    figure = {"rate": "throughput", "outages": "outage", "outage time": "outage", "time out": "outage"}.get(
        figure, figure
    )
    if figure not in FIGURES:
        raise ConfigError(f'"{part}" names no figure; there are: {", ".join(FIGURES)}; {example}')
    wanted_unit, at_least = FIGURES[figure]
    if unit and unit != wanted_unit.lower():
        raise ConfigError(f'"{part}": {figure} is in {wanted_unit}')
    says_least = comparison in (">", ">=", "above", "over", "at least")
    if comparison and comparison != "=" and says_least != at_least:
        raise ConfigError(f'"{part}": a need asks for {figure} {"at least" if at_least else "at most"} so much')
    return Condition(figure, float(number))


def value_of(summary: RunSummary, condition: Condition) -> float | None:
    """A run's figure for a condition."""
    robot = main_interface(summary)
    delay = summary.delay_ms
    values = {
        "throughput": robot.throughput_mbps.mean if robot is not None else None,
        "mean": delay.censored_mean,
        "median": delay.median,
        "p95": delay.p95,
        "p99": delay.p99,
        "loss": delay.loss_percent,
        "outage": delay.time_out_percent,
    }
    return values[condition.figure]


def recommend(summaries: Sequence[RunSummary], needs: Sequence[Need], runs: Sequence[Run] = ()) -> list[Fit]:
    """Every need against every case, best first: by certainty, then by share of trials."""
    cases: dict[str, list[int]] = {}
    for i, summary in enumerate(summaries):
        cases.setdefault(summary.case or summary.run, []).append(i)
    fits = []
    for need in needs:
        found = [
            _fit(case, need, [summaries[i] for i in members], [runs[i] for i in members] if runs else [])
            for case, members in cases.items()
        ]
        fits += sorted(found, key=lambda f: (-(f.certainty if f.certainty is not None else f.met / f.trials), f.case))
    return fits


def _fit(case: str, need: Need, summaries: Sequence[RunSummary], runs: Sequence[Run]) -> Fit:
    met, unknown = 0, set[str]()
    for summary in summaries:
        values = [(c, value_of(summary, c)) for c in need.conditions]
        unknown |= {c.figure for c, v in values if v is None}
        met += all(v is not None and (v >= c.limit if c.at_least else v <= c.limit) for c, v in values)
    chances, worst = [], None
    for condition in need.conditions:
        series = [v for s in summaries if (v := value_of(s, condition)) is not None]
        if not series:
            continue
        margin = min(
            (v - condition.limit) * (1 if condition.at_least else -1) / max(condition.limit, 1e-9) for v in series
        )
        shown = min(series) if condition.at_least else max(series)
        if worst is None or margin < worst[0]:
            worst = (margin, f"{condition.text()}: {shown:.3g}")
        chances.append(next_trial_chance(series, condition))
    known = [c for c in chances if c is not None]
    certainty = min(known) if len(known) == len(need.conditions) else None
    areas = [a for run in runs if (a := area_share(run, need)) is not None]
    if unknown:
        verdict = f"cannot be judged: {', '.join(sorted(unknown))} unknown"
    elif certainty is None:
        verdict = f"{'met' if met == len(summaries) else 'not met'}, one trial: says little of the next drive"
    elif certainty >= 0.95:
        verdict = "met"
    elif certainty <= 0.05:
        verdict = "not met"
    else:
        verdict = "open"
    return Fit(
        case=case,
        need=need.name,
        trials=len(summaries),
        met=met,
        certainty=certainty,
        worst=worst[1] if worst else None,
        area_percent=sum(areas) / len(areas) if areas else None,
        verdict=verdict,
    )


def next_trial_chance(values: Sequence[float], condition: Condition) -> float | None:
    """Chance that a further trial meets a condition (predictive t distribution over the trials); one trial: `None`."""
    import statistics

    n = len(values)
    if n < 2:
        return None
    mean, spread = statistics.fmean(values), statistics.stdev(values)
    side = 1.0 if condition.at_least else -1.0
    if spread == 0:
        return 1.0 if side * (mean - condition.limit) >= 0 else 0.0
    from scipy.special import stdtr

    return float(stdtr(n - 1, side * (mean - condition.limit) / (spread * math.sqrt(1 + 1 / n))))


def area_share(run: Run, need: Need) -> float | None:
    """Percent of the driven area (cells of 2 m) in which a need was met; `None` without odometry or figures."""
    from .space import cell_figures

    cells = cell_figures(run, AREA_CELL_M)
    judged = good = 0
    for cell in cells:
        values = [(c, getattr(cell, c.figure, None)) for c in need.conditions]
        if any(v is None for _, v in values):
            continue
        judged += 1
        good += all(v is not None and (v >= c.limit if c.at_least else v <= c.limit) for c, v in values)
    return 100.0 * good / judged if judged else None

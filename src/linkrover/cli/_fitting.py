"""From runs to fits: which samples go into which, and the table of results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from linkrover.analysis.link import signal_steps
from linkrover.analysis.load import load_run
from linkrover.analysis.motion import position_at
from linkrover.errors import LinkRoverError
from linkrover.radio.estimate import Estimate, FitError
from linkrover.radio.fit_nakagami import fit_nakagami_along
from linkrover.radio.fit_path_loss import fit_path_loss
from linkrover.radio.fit_position import fit_position
from linkrover.radio.fit_throughput import fit_throughput

if TYPE_CHECKING:
    from rich.table import Table

    from linkrover.analysis.run import Run
    from linkrover.radio.values import Array

NAMES = {
    "access_point_x_m": "access point x",
    "access_point_y_m": "access point y",
    "rss_1m_dbm": "RSS at 1 m",
    "exponent": "path-loss exponent",
    "sigma_db": "shadowing sigma",
    "decorrelation_m": "decorrelation distance",
    "nakagami_m": "Nakagami m",
    "alpha_b_hz": "alpha_T * B",
    "noise_dbm": "noise",
    "cap_bps": "cap",
}
SHOWN_AS = {"Hz": ("MHz", 1e-6), "bit/s": ("Mbit/s", 1e-6), "1": ("", 1.0)}


class RunFit(msgspec.Struct, frozen=True, kw_only=True):
    """All fits of one run (or of several together)."""

    name: str
    end: str
    samples: int
    figures: dict[str, Estimate]
    notes: tuple[str, ...]


class _Samples:
    """RSSI with places along a drive, and throughput with RSSI by second."""

    def __init__(self, run: Run, end: str | None) -> None:
        self.end, table = _readings(run, end)
        starts, _, valid, _ = signal_steps(table, run.published_2021)
        rssi = np.asarray(table["rssi_dbm"], float)
        x, y = position_at(run, starts)
        known = valid & np.isfinite(x)
        if int(known.sum()) < 20:
            raise FitError(
                f"{run.name}: {int(valid.sum())} RSSI readings, {int(known.sum())} of them with odometry near; "
                "at least 20 are needed: was odometry recorded (a feed, /odom)?"
            )
        self.places: Array = np.column_stack([x[known], y[known]])
        self.rssi: Array = rssi[known]
        self.level, self.rate = _throughput(run, starts[valid], rssi[valid])


def _readings(run: Run, end: str | None) -> tuple[str, Any]:
    best: tuple[int, str, Any] | None = None
    for role, each in run.ends.items():
        for table in each.wireless.values():
            count = int(np.isfinite(np.asarray(table["rssi_dbm"], float)).sum())
            if (end is None or role == end) and count and (best is None or count > best[0]):
                best = (count, role, table)
    if best is None:
        raise FitError(f"{run.name}: no RSSI readings{f' at the {end}' if end else ''}")
    return best[1], best[2]


def _throughput(run: Run, times: Array, rssi: Array) -> tuple[Array, Array]:
    """Mean RSSI and throughput of every measured interval of the robot's (else the station's) busiest interface."""
    for end in (run.robot, run.station):
        if end is None or end.primary is None or end.primary not in end.utilization:
            continue
        table = end.utilization[end.primary]
        good = np.asarray(table["has_base"], bool)
        start, stop = np.asarray(table["begin_s"], float)[good], np.asarray(table["t_s"], float)[good]
        rate = np.asarray(table["bits"], float)[good] / np.maximum(stop - start, 1e-6)
        low, high = np.searchsorted(times, start), np.searchsorted(times, stop)
        total = np.concatenate([[0.0], np.cumsum(rssi)])
        heard = np.isfinite(rate) & (high > low)
        return (total[high[heard]] - total[low[heard]]) / (high[heard] - low[heard]), rate[heard]
    return np.empty(0), np.empty(0)


def fit_runs(
    paths: Sequence[Path], access_point: tuple[float, float] | None, end: str | None, together: bool
) -> list[RunFit]:
    """One fit a run, or one of all.

    Raises:
        LinkRoverError: a run cannot be read, or holds nothing that could be fitted.
    """
    runs = [load_run(path) for path in paths]
    samples = [_Samples(run, end) for run in runs]
    groups = [(", ".join(run.name for run in runs), samples)] if together else [
        (run.name, [each]) for run, each in zip(runs, samples, strict=True)
    ]  # fmt: skip
    return [_fit(name, group, access_point) for name, group in groups]


def _fit(name: str, group: list[_Samples], access_point: tuple[float, float] | None) -> RunFit:
    places = np.vstack([each.places for each in group])
    rssi = np.concatenate([each.rssi for each in group])
    figures: dict[str, Estimate] = {}
    notes: list[str] = []

    def attempt(what: str, work: Any) -> None:
        try:
            figures.update(work())
        except FitError as error:
            notes.append(f"{what}: not fitted: {error}")

    def place() -> dict[str, Estimate]:
        nonlocal access_point
        found = fit_position(places, rssi)
        notes.append(
            f"access point: 95 % region of {found.region_area_m2:.1f} m2"
            + (f"; {found.note}" if found.note else "")
            + ("" if access_point is None else "; the line is of distances from the place you gave")
        )
        if access_point is None:
            assert found.x_m.value is not None
            assert found.y_m.value is not None
            access_point = (found.x_m.value, found.y_m.value)
            notes.append("path loss: distances are from the fitted place; its doubt is not in the line's intervals")
        return {"access_point_x_m": found.x_m, "access_point_y_m": found.y_m}

    def line() -> dict[str, Estimate]:
        if access_point is None:
            raise FitError("the access point's place is not known; give --access-point X Y")
        found = fit_path_loss(places, access_point, rssi)
        notes.append(f"path loss: {found.samples} readings at {found.places} places 0.5 m apart, "
                     f"{found.distance_low_m:.1f} to {found.distance_high_m:.1f} m")  # fmt: skip
        return {
            "rss_1m_dbm": found.rss_1m_dbm,
            "exponent": found.exponent,
            "sigma_db": found.sigma_db,
            "decorrelation_m": found.decorrelation_m,
        }

    def fading() -> dict[str, Estimate]:
        # drives one after the other: no pair of readings is taken across two of them
        along, start = [], 0.0
        for each in group:
            way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(each.places, axis=0).T))]) + start
            along.append(way)
            start = float(way[-1]) + 10.0
        return {"nakagami_m": fit_nakagami_along(rssi, np.concatenate(along))}

    def share() -> dict[str, Estimate]:
        level = np.concatenate([each.level for each in group])
        rate = np.concatenate([each.rate for each in group])
        found = fit_throughput(level, rate)
        notes.append(
            f"throughput: {found.samples} intervals worth {found.worth:.0f} independent ones; only right if the link "
            "was full (traffic wanted more than it got)"
        )
        return {"alpha_b_hz": found.alpha_b_hz, "noise_dbm": found.noise_dbm, "cap_bps": found.cap_bps}

    attempt("access point", place)
    attempt("path loss", line)
    attempt("multipath", fading)
    attempt("throughput", share)
    if not figures:
        raise LinkRoverError(f"{name}: nothing could be fitted. " + " ".join(notes))
    notes += [f"{NAMES[key]}: {each.note}" for key, each in figures.items() if each.note]
    return RunFit(name=name, end=group[0].end, samples=len(rssi), figures=figures, notes=tuple(notes))


def table(result: RunFit) -> Table:
    """The figures with their intervals."""
    from rich.table import Table

    out = Table(title=f"{result.name}: RSSI at the {result.end}, {result.samples} readings", title_justify="left")
    out.add_column("figure")
    out.add_column("estimate", justify="right")
    out.add_column("95 % interval", justify="right")
    out.add_column("unit")
    for key, estimate in result.figures.items():
        unit, factor = SHOWN_AS.get(estimate.unit, (estimate.unit, 1.0))
        low, high = (_number(each, factor) for each in (estimate.low, estimate.high))
        out.add_row(NAMES[key], _number(estimate.value, factor), f"{low} to {high}", unit)
    return out


def _number(value: float | None, factor: float) -> str:
    return "not known" if value is None else f"{value * factor:.4g}"

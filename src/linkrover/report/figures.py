"""The figures for print: PNG, SVG or PDF by matplotlib, one quantity a figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from . import palette
from .thin import thin, thin_points
from .view import UNITS, RunView

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
TITLES = {"rssi": "RSSI", "throughput": "throughput", "delay": "round trip"}


def write_figures(views: Sequence[RunView], folder: FilePath, formats: Sequence[str] = ("png",)) -> list[FilePath]:
    """Draw all figures that the runs hold values for into `folder`; returns the files written.

    Raises:
        ValueError: a format is not one of FORMATS.
    """
    wrong = [f for f in formats if f not in FORMATS]
    if wrong:
        raise ValueError(f"figure format {wrong[0]!r} is not one of {', '.join(FORMATS)}")
    import matplotlib as mpl

    mpl.use("agg")
    folder.mkdir(parents=True, exist_ok=True)
    written: list[FilePath] = []

    def save(figure: Figure | None, name: str) -> None:
        if figure is None:
            return
        for suffix in formats:
            path = folder / f"{name}.{suffix}"
            figure.savefig(path, dpi=150, bbox_inches="tight")
            written.append(path)

    for view in views:
        stem = "".join(c if c.isalnum() or c in "-_" else "-" for c in view.name)
        save(_run_figure(view), f"{stem}-time-series")
        save(_path_figure(view), f"{stem}-path")
    if len(views) > 1:
        for kind in TITLES:
            save(_cases_figure(views, kind), f"cases-{kind}")
        save(_bars_figure(views), "cases-compared")
    return written


def _figure(height_in: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure as MplFigure

    figure = MplFigure(figsize=(7.2, height_in), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex="col" if columns == 1 else False)
    return figure, list(axes.ravel())


def _run_figure(view: RunView) -> Figure | None:
    kinds = [kind for kind in TITLES if view.of(kind)]
    if not kinds:
        return None
    figure, axes = _figure(1.1 + 1.6 * len(kinds), rows=len(kinds))
    for ax, kind in zip(axes, kinds, strict=True):
        for line in view.of(kind):
            t_s, value = (thin_points if kind == "delay" else thin)(line.t_s, line.value)
            colour = palette.end_colour(line.end)
            if kind == "delay":
                ax.plot(t_s, value, ".", ms=2, color=colour, label=line.name)
            else:
                style = ":" if line.direction == "tx" else "-"
                ax.plot(t_s, value, style, lw=1, color=colour, label=line.name)
        for outage in view.outages:
            ax.axvspan(outage.start_s, outage.end_s, color=palette.OUTAGE, alpha=0.25, lw=0)
        if kind == "delay":
            ax.set_yscale("log")
        ax.set_ylabel(f"{TITLES[kind]}\n{UNITS[kind]}")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=7, loc="upper right", ncols=2)
    axes[-1].set_xlabel("time since the run began, s")
    axes[0].set_title(view.name, fontsize=10)
    return figure


def _path_figure(view: RunView) -> Figure | None:
    if view.path is None or len(view.path.t_s) < 2:
        return None
    lines = next((lines for kind in TITLES if (lines := view.over_floor(kind))), [])
    figure, (ax,) = _figure(5.4)
    ax.plot(view.path.x_m, view.path.y_m, color="0.7", lw=0.8)
    if lines:
        line = lines[0]
        t_s, value = thin_points(line.t_s, line.value)
        x, y = view.path.at(t_s)
        dots = ax.scatter(x, y, c=value, s=10, cmap="cividis")
        figure.colorbar(dots, ax=ax, label=f"{TITLES[line.kind]}: {line.name}, {UNITS[line.kind]}", shrink=0.8)
    starts = np.array([o.start_s for o in view.outages])
    if len(starts):
        ax.plot(*view.path.at(starts), "x", ms=8, color=palette.OUTAGE, label="outage begins")
        ax.legend(fontsize=8)
    ax.set_aspect("equal")
    ax.set_xlabel("x, m")
    ax.set_ylabel("y, m")
    ax.set_title(view.name, fontsize=10)
    ax.grid(alpha=0.3)
    return figure


def _cases_figure(views: Sequence[RunView], kind: str) -> Figure | None:
    shown = [(view, view.over_floor(kind)) for view in views if view.over_floor(kind)]
    if not shown:
        return None
    figure, (ax,) = _figure(3.2)
    cases = list(dict.fromkeys(view.case for view, _ in shown))
    for view, lines in shown:
        line = lines[0]
        t_s, value = thin(line.t_s, line.value)
        index = cases.index(view.case)
        label = view.case if view is next(v for v, _ in shown if v.case == view.case) else None
        style = {"ls": "", "marker": ".", "ms": 2} if kind == "delay" else {"lw": 0.9}
        ax.plot(t_s, value, color=palette.case_colour(index), label=label, **style)
    if kind == "delay":
        ax.set_yscale("log")
    ax.set_xlabel("time since the run began, s")
    ax.set_ylabel(f"{TITLES[kind]} at the robot, {UNITS[kind]}")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=7, ncols=2)
    return figure


def _bars_figure(views: Sequence[RunView]) -> Figure | None:
    wanted: tuple[tuple[str, Callable[[RunView], tuple[float | None, tuple[float, float] | None]]], ...] = (
        ("throughput at the robot, Mbit/s", _throughput),
        ("mean round trip, ms", _mean_delay),
    )
    figure, axes = _figure(0.9 + 0.32 * len(views), columns=2)
    drawn = False
    cases = list(dict.fromkeys(view.case for view in views))
    for ax, (title, pick) in zip(axes, wanted, strict=True):
        for i, view in enumerate(views):
            mean, ci = pick(view)
            if mean is None:
                continue
            drawn = True
            ax.barh(i, mean, color=palette.case_colour(cases.index(view.case)), alpha=0.8)
            if ci:
                ax.plot(ci, [i, i], color=palette.INK, lw=1.5)
        ax.set_yticks(range(len(views)), [view.name for view in views] if ax is axes[0] else [], fontsize=7)
        ax.invert_yaxis()
        ax.set_xlabel(f"{title} (95 % interval)", fontsize=8)
        ax.grid(alpha=0.3, axis="x")
    return figure if drawn else None


def _throughput(view: RunView) -> tuple[float | None, tuple[float, float] | None]:
    interfaces = ((view.summary.get("ends") or {}).get("robot") or {}).get("interfaces") or {}
    best: tuple[float | None, tuple[float, float] | None] = (None, None)
    for values in interfaces.values():
        throughput = values.get("throughput_mbps") or {}
        mean = throughput.get("mean")
        if mean is not None and (best[0] is None or mean > best[0]):
            best = (float(mean), throughput.get("mean_ci95"))
    return best


def _mean_delay(view: RunView) -> tuple[float | None, tuple[float, float] | None]:
    delay = view.summary.get("delay_ms") or {}
    mean = delay.get("mean")
    return (None if mean is None else float(mean)), delay.get("mean_ci95")

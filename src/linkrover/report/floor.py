"""Figures over the floor: estimated maps with their standard error, and all runs' paths on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from linkrover.analysis.space import Anchor, DeadZone, Surface

from . import palette
from .interactive import BASE_LAYOUT, TITLES, Figure, numbers
from .thin import thin_points
from .view import UNITS, RunView

Wall = tuple[float, float, float, float]


def estimated_maps(
    surfaces: Sequence[Surface], anchor: Anchor | None, zones: Sequence[DeadZone], walls: Sequence[Wall] = ()
) -> Figure | None:
    """Each quantity's map beside its standard error, a row a quantity; None without any surface."""
    if not surfaces:
        return None
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {**BASE_LAYOUT, "hovermode": "closest", "showlegend": False, "annotations": []}
    rows = len(surfaces)
    height = 1 / rows
    for row, surface in enumerate(surfaces):
        for column, (values, what) in enumerate(((surface.mean, "estimate"), (surface.standard_error, "std error"))):
            suffix = "" if row == column == 0 else str(2 * row + column + 1)
            top = 1 - row * height
            domain_y = [top - height + 0.2 / rows, top - 0.07 / rows]
            domain_x = [0.0, 0.41] if column == 0 else [0.55, 0.96]
            traces.append(_heat(surface, values, suffix, domain_x[1], domain_y, error=column == 1))
            traces += _marks(suffix, anchor, zones)
            layout[f"xaxis{suffix}"] = {
                "domain": domain_x, "anchor": f"y{suffix}", "title": {"text": "x, m"}, "constrain": "domain",
            }  # fmt: skip
            layout[f"yaxis{suffix}"] = {
                "domain": domain_y, "anchor": f"x{suffix}", "scaleanchor": f"x{suffix}", "constrain": "domain",
                "title": {"text": "y, m" if column == 0 else ""},
            }  # fmt: skip
            layout["annotations"].append(
                {
                    "text": f"{TITLES[surface.quantity]}: {what}, {surface.unit}",
                    "xref": "paper", "yref": "paper", "x": sum(domain_x) / 2, "y": top, "yanchor": "top",
                    "showarrow": False,
                }
            )  # fmt: skip
            layout.setdefault("shapes", []).extend(_wall_shapes(walls, suffix))
    layout["height"] = 40 + 400 * rows
    return {"data": traces, "layout": layout}


def _heat(
    surface: Surface, values: list[list[float]], suffix: str, right: float, domain_y: list[float], *, error: bool
) -> dict[str, Any]:
    return {
        "type": "heatmap",
        "x": [round(v, 2) for v in surface.x_m],
        "y": [round(v, 2) for v in surface.y_m],
        "z": [[round(v, 3) for v in line] for line in values],
        "xaxis": f"x{suffix}",
        "yaxis": f"y{suffix}",
        "colorscale": "Greys" if error else palette.MAP_SCALE,
        "reversescale": error,
        "colorbar": {"x": right + 0.005, "y": sum(domain_y) / 2, "len": domain_y[1] - domain_y[0], "thickness": 10},
        "hovertemplate": f"%{{z:.3g}} {surface.unit} at (%{{x:.1f}}, %{{y:.1f}}) m<extra></extra>",
    }


def _marks(suffix: str, anchor: Anchor | None, zones: Sequence[DeadZone]) -> list[dict[str, Any]]:
    marks: list[dict[str, Any]] = []
    if anchor is not None:
        marks.append(
            {
                "type": "scatter", "mode": "markers", "x": [round(anchor.x_m, 2)], "y": [round(anchor.y_m, 2)],
                "xaxis": f"x{suffix}", "yaxis": f"y{suffix}",
                "marker": {"symbol": "star", "size": 14, "color": palette.STATION, "line": {"width": 1}},
                "hovertemplate": f"fixed antenna, estimated, ± {anchor.radius_m:.1f} m<extra></extra>",
            }
        )  # fmt: skip
    if zones:
        marks.append(
            {
                "type": "scatter", "mode": "markers",
                "x": [round(z.x_m, 2) for z in zones], "y": [round(z.y_m, 2) for z in zones],
                "xaxis": f"x{suffix}", "yaxis": f"y{suffix}",
                "marker": {"symbol": "x", "size": 11, "color": palette.OUTAGE},
                "text": [f"dead zone, {z.area_m2:.0f} m² driven, {z.seconds:.0f} s" for z in zones],
                "hovertemplate": "%{text}<extra></extra>",
            }
        )  # fmt: skip
    return marks


def _wall_shapes(walls: Sequence[Wall], suffix: str) -> list[dict[str, Any]]:
    return [
        {
            "type": "line", "xref": f"x{suffix}", "yref": f"y{suffix}", "x0": x1, "y0": y1, "x1": x2, "y1": y2,
            "line": {"color": palette.INK, "width": 2},
        }
        for x1, y1, x2, y2 in walls
    ]  # fmt: skip


def side_by_side(views: Sequence[RunView], kind: str, walls: Sequence[Wall] = (), most: int = 300) -> Figure | None:
    """All runs' paths coloured by one quantity on one scale, three a row; None where fewer than two have both."""
    shown = []
    for view in views:
        line = next(iter(view.over_floor(kind)), None)
        if view.path is not None and line is not None:
            t_s, value = thin_points(line.t_s, line.value, most)
            x, y = view.path.at(t_s)
            good = np.isfinite(x)
            if good.any():
                shown.append((view.name, x[good], y[good], value[good]))
    if len(shown) < 2:
        return None
    every = np.concatenate([value for *_, value in shown])
    if kind == "delay":
        every = np.log10(np.maximum(every, 1e-3))
    low, high = (float(v) for v in np.quantile(every, (0.01, 0.99)))
    columns = 3
    rows = -(-len(shown) // columns)
    bar: dict[str, Any] = {"title": {"text": UNITS[kind]}, "thickness": 12}
    if kind == "delay":
        ticks = [v for v in (0.1, 1, 10, 100, 1000, 10000) if low - 1 <= np.log10(v) <= high + 1]
        bar |= {"tickvals": [float(np.log10(v)) for v in ticks], "ticktext": [f"{v:g}" for v in ticks]}
    layout: dict[str, Any] = {
        **BASE_LAYOUT,
        "hovermode": "closest",
        "showlegend": False,
        "height": 60 + 260 * rows,
        "annotations": [],
        "shapes": [],
        "coloraxis": {"cmin": round(low, 3), "cmax": round(high, 3), "colorscale": palette.MAP_SCALE, "colorbar": bar},
    }
    traces: list[dict[str, Any]] = []
    for i, (name, x, y, value) in enumerate(shown):
        suffix = "" if i == 0 else str(i + 1)
        row, column = divmod(i, columns)
        left, top = column / columns, 1 - row / rows
        colour = np.log10(np.maximum(value, 1e-3)) if kind == "delay" else value
        traces.append(
            {
                "type": "scatter", "mode": "markers", "x": numbers(x, 2), "y": numbers(y, 2),
                "xaxis": f"x{suffix}", "yaxis": f"y{suffix}",
                "text": [f"{v:.4g} {UNITS[kind]}" for v in value], "hovertemplate": "%{text}<extra></extra>",
                "marker": {"size": 5, "color": numbers(colour, 3), "coloraxis": "coloraxis"},
            }
        )  # fmt: skip
        layout[f"xaxis{suffix}"] = {
            "domain": [left, left + 0.9 / columns], "anchor": f"y{suffix}",
            **({"matches": "x"} if i else {}), "tickfont": {"size": 10},
        }  # fmt: skip
        layout[f"yaxis{suffix}"] = {
            "domain": [max(0.0, top - 0.82 / rows), top - 0.08 / rows], "anchor": f"x{suffix}",
            **({"matches": "y"} if i else {}), "tickfont": {"size": 10},
        }  # fmt: skip
        layout["annotations"].append(
            {
                "text": name if len(name) < 34 else name[:33] + "…", "xref": "paper", "yref": "paper",
                "x": left, "xanchor": "left", "y": top, "yanchor": "top", "showarrow": False, "font": {"size": 11},
            }
        )  # fmt: skip
        layout["shapes"] += _wall_shapes(walls, suffix)
    return {"data": traces, "layout": layout}

"""The figures of the HTML report as plain plotly.js dictionaries: no drawing library is needed to make them."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import palette
from .thin import thin, thin_points
from .view import UNITS, Floats, Line, RunView

Figure = dict[str, Any]

_ROWS = (("rssi", "RSSI"), ("throughput", "throughput"), ("delay", "round trip"))
TITLES = dict(_ROWS)
# Over time there are more: noise beside the RSSI, and how busy the channel was.
_TIME_ROWS = (
    (("rssi", "noise"), "RSSI"),
    (("channel",), "channel busy"),
    (("throughput",), "throughput"),
    (("delay",), "round trip"),
)
BASE_LAYOUT: dict[str, Any] = {
    "margin": {"l": 62, "r": 12, "t": 12, "b": 44},
    "paper_bgcolor": "rgba(0,0,0,0)",
    "plot_bgcolor": "rgba(0,0,0,0)",
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": palette.INK},
    "hovermode": "x unified",
    "legend": {"orientation": "h", "y": -0.1, "yanchor": "top"},
}


def numbers(values: Floats, digits: int) -> list[float | None]:
    """Rounded for the page; NaN becomes null."""
    return [None if not np.isfinite(v) else round(float(v), digits) for v in values]


def _trace(line: Line, axis: str, dash: str, most: int) -> dict[str, Any]:
    cloud = line.kind == "delay"  # a line through its extremes would show two bands where there is one cloud
    t_s, value = thin_points(line.t_s, line.value, 3 * most) if cloud else thin(line.t_s, line.value, most)
    trace: dict[str, Any] = {
        "type": "scatter",
        "x": numbers(t_s, 3),
        "y": numbers(value, 3),
        "name": line.name,
        "xaxis": "x",
        "yaxis": axis,
        "connectgaps": False,
        "hovertemplate": f"%{{y:.4g}} {UNITS[line.kind]}",
    }
    colour = palette.end_colour(line.end)
    if cloud:
        trace |= {"mode": "markers", "marker": {"size": 4, "color": colour, "opacity": 0.7}}
        if line.method.startswith("ros"):
            trace["marker"]["symbol"] = "x-thin-open"
    else:
        trace |= {"mode": "lines", "line": {"color": colour, "width": 1.6, "dash": dash}}
        if line.kind == "noise":
            trace["line"] |= {"width": 1.0, "dash": "dot"}
        if line.kind in ("throughput", "channel"):
            trace["line"]["shape"] = "vh"  # a rate belongs to the interval that ends at its stamp
        if line.kind == "channel":  # few drivers survey without a break: a single value shows too
            trace |= {"mode": "lines+markers", "marker": {"size": 4, "color": colour}}
    return trace


def time_series(view: RunView, most: int = 2000) -> Figure | None:
    """RSSI and noise, channel, throughput and round trip over time, one above the other, outages shaded.

    Rows without values are left out; None if there is nothing.
    """
    rows = [
        (kinds[0], f"{title}, noise" if "noise" in kinds and view.of("noise") else title, lines)
        for kinds, title in _TIME_ROWS
        if (lines := [line for kind in kinds for line in view.of(kind)])
    ]
    if not rows:
        return None
    layout: dict[str, Any] = dict(BASE_LAYOUT)
    height = 0.94 / len(rows)
    traces: list[dict[str, Any]] = []
    for i, (kind, title, lines) in enumerate(rows):
        axis = "y" if i == 0 else f"y{i + 1}"
        top = 1 - i * (height + 0.06 / max(1, len(rows) - 1) if len(rows) > 1 else height)
        layout["yaxis" if i == 0 else f"yaxis{i + 1}"] = {
            "title": {"text": f"{title}<br>{UNITS[kind]}"},
            "domain": [max(0.0, top - height), min(1.0, top)],
            "gridcolor": "rgba(128,128,128,.25)",
            "zeroline": False,
            **({"type": "log", "dtick": 1} if kind == "delay" else {}),
            **({"rangemode": "tozero"} if kind in ("throughput", "channel") else {}),
        }
        seen: dict[str, int] = {}
        for line in lines:
            count = seen.setdefault(line.end, 0)
            seen[line.end] += 1
            traces.append(_trace(line, axis, palette.DASHES[count % len(palette.DASHES)], most))
        if kind == "delay" and len(view.lost_t_s):
            # On the log axis a lost probe has no height: it is drawn at the longest answered delay.
            high = max(float(np.nanmax(line.value)) for line in lines)
            lost = view.lost_t_s[:: max(1, len(view.lost_t_s) // most)]
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": "lost probe",
                    "x": numbers(lost, 3),
                    "y": [high] * len(lost),
                    "yaxis": axis,
                    "xaxis": "x",
                    "marker": {"symbol": "line-ns-open", "size": 8, "color": palette.OUTAGE},
                    "hovertemplate": "lost",
                }
            )
    layout["xaxis"] = {
        "title": {"text": "time since the run began, s"},
        "anchor": "y" if len(rows) == 1 else f"y{len(rows)}",
        "gridcolor": "rgba(128,128,128,.25)",
        "zeroline": False,
    }
    layout["shapes"] = [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": round(outage.start_s, 3),
            "x1": round(outage.end_s, 3),
            "y0": 0,
            "y1": 1,
            "line": {"width": 0},
            "fillcolor": palette.OUTAGE,
            "opacity": 0.22,
            "layer": "below",
        }
        for outage in view.outages
    ]
    layout["height"] = 130 + 190 * len(rows)
    return {"data": traces, "layout": layout}


def path_map(view: RunView, most: int = 1500) -> Figure | None:
    """The robot's path coloured by RSSI, throughput or round trip (a menu chooses); None without a path.

    customdata of each point is its time in s, which links it to the time series.
    """
    path = view.path
    if path is None or len(path.t_s) < 2:
        return None
    keep = np.linspace(0, len(path.t_s) - 1, min(most, len(path.t_s))).astype(int)
    ground: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(path.x_m[keep], 3),
        "y": numbers(path.y_m[keep], 3),
        "line": {"color": "rgba(128,128,128,.5)", "width": 1},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    traces: list[dict[str, Any]] = [ground]
    buttons: list[dict[str, Any]] = []
    coloured: list[tuple[str, dict[str, Any]]] = []
    for kind, title in _ROWS:
        for line in view.over_floor(kind):
            if not np.nanmax(np.abs(line.value)):
                continue  # an interface that carried nothing
            coloured.append((f"{title}: {line.name}", _coloured_path(view, line, most)))
    for i, (title, trace) in enumerate(coloured):
        trace["visible"] = i == 0
        traces.append(trace)
        visible = [True, *(j == i for j in range(len(coloured))), True, True]
        buttons.append({"label": title, "method": "restyle", "args": [{"visible": visible}]})
    traces.append(_outage_starts(view))
    traces.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "cursor",
            "x": [],
            "y": [],
            "showlegend": False,
            "hoverinfo": "skip",
            "marker": {"size": 15, "color": "rgba(0,0,0,0)", "line": {"color": palette.INK, "width": 3}},
        }
    )
    layout: dict[str, Any] = {
        **BASE_LAYOUT,
        "hovermode": "closest",
        "margin": {"l": 52, "r": 12, "t": 52, "b": 44},
        "xaxis": {"title": {"text": "x, m"}, "gridcolor": "rgba(128,128,128,.25)", "zeroline": False},
        "yaxis": {
            "title": {"text": "y, m"},
            "scaleanchor": "x",
            "gridcolor": "rgba(128,128,128,.25)",
            "zeroline": False,
        },
        "height": 460,
        "showlegend": False,
    }
    if len(buttons) > 1:
        layout["updatemenus"] = [{"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.14, "yanchor": "top"}]
    return {"data": traces, "layout": layout}


def _coloured_path(view: RunView, line: Line, most: int) -> dict[str, Any]:
    assert view.path is not None
    t_s, value = thin_points(line.t_s, line.value, most)
    x, y = view.path.at(t_s)
    shown = np.isfinite(x) & np.isfinite(value)
    unit = UNITS[line.kind]
    colour = np.log10(np.maximum(value[shown], 1e-3)) if line.kind == "delay" else value[shown]
    bar: dict[str, Any] = {"title": {"text": unit}, "thickness": 12}
    if line.kind == "delay":
        ticks = np.array([0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000])
        bar |= {"tickvals": np.log10(ticks).round(3).tolist(), "ticktext": [f"{v:g}" for v in ticks]}
    return {
        "type": "scatter",
        "mode": "markers",
        "name": line.name,
        "x": numbers(x[shown], 3),
        "y": numbers(y[shown], 3),
        "customdata": numbers(t_s[shown], 3),
        "text": [f"{v:.4g} {unit}" for v in value[shown]],
        "hovertemplate": "%{text} at %{customdata:.1f} s<extra></extra>",
        "marker": {"size": 7, "color": numbers(colour, 4), "colorscale": palette.MAP_SCALE, "colorbar": bar},
    }


def _outage_starts(view: RunView) -> dict[str, Any]:
    assert view.path is not None
    starts = np.array([o.start_s for o in view.outages], dtype=np.float64)
    x, y = view.path.at(starts)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "outage begins",
        "x": numbers(x, 3),
        "y": numbers(y, 3),
        "customdata": numbers(starts, 3),
        "hovertemplate": "outage begins at %{customdata:.1f} s<extra></extra>",
        "marker": {"symbol": "x", "size": 11, "color": palette.OUTAGE},
    }


def distributions(view: RunView, points: int = 400) -> Figure | None:
    """Share of values at or below x (empirical distribution) of round trip and RSSI; None if there is neither."""
    kinds = [kind for kind in ("delay", "rssi") if view.of(kind)]
    if not kinds:
        return None
    layout: dict[str, Any] = {
        **BASE_LAYOUT,
        "hovermode": "closest",
        "height": 380,
        "legend": {"orientation": "h", "y": -0.24, "yanchor": "top"},
    }
    traces: list[dict[str, Any]] = []
    width = 1 / len(kinds)
    for i, kind in enumerate(kinds):
        suffix = "" if i == 0 else str(i + 1)
        for line in view.of(kind):
            known = np.sort(line.value[np.isfinite(line.value)])
            share = np.arange(1, len(known) + 1) / len(known)
            keep = np.unique(np.linspace(0, len(known) - 1, min(points, len(known))).astype(int))
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": f"{kind}: {line.name}",
                    "x": numbers(known[keep], 3),
                    "y": numbers(share[keep], 4),
                    "xaxis": f"x{suffix}",
                    "yaxis": f"y{suffix}",
                    "line": {"color": palette.end_colour(line.end), "shape": "hv"},
                    "hovertemplate": "%{y:.1%} at or below %{x:.4g}",
                }
            )
        layout[f"xaxis{suffix}"] = {
            "title": {"text": f"{'round trip' if kind == 'delay' else 'RSSI'}, {UNITS[kind]}"},
            "domain": [i * width + (0.04 if i else 0), (i + 1) * width - 0.02],
            "anchor": f"y{suffix}",
            "gridcolor": "rgba(128,128,128,.25)",
            **({"type": "log", "dtick": 1} if kind == "delay" else {}),
        }
        layout[f"yaxis{suffix}"] = {
            "title": {"text": "share at or below" if i == 0 else ""},
            "anchor": f"x{suffix}",
            "range": [0, 1.01],
            "gridcolor": "rgba(128,128,128,.25)",
        }
    return {"data": traces, "layout": layout}

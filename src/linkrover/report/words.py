"""What happened in a run, in sentences; each figure with its unit, and with its interval where there is one."""

from __future__ import annotations

from typing import Any

import numpy as np

from .view import RunView


def number(value: float | None, digits: int = 3) -> str:
    """A figure for a reader: `digits` significant digits without an exponent, "unknown" for None or NaN."""
    if value is None or not np.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    places = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{places}f}"


def interval(pair: list[float] | tuple[float, float] | None) -> str:
    """A 95 % interval in brackets, or nothing where it is unknown."""
    if not pair or pair[0] is None or pair[1] is None:
        return ""
    return f" [{number(pair[0])}, {number(pair[1])}]"


def sentences(view: RunView) -> list[str]:
    """The run in a few sentences, from its summary."""
    summary = view.summary
    said = [_drive(view)]
    for end, figures in (summary.get("ends") or {}).items():
        for iface, values in (figures.get("interfaces") or {}).items():
            line = _interface(end, iface, values)
            if line:
                said.append(line)
    said.append(_delay(summary.get("delay_ms") or {}))
    said.append(_outages(view))
    return [sentence for sentence in said if sentence]


def _drive(view: RunView) -> str:
    text = f"The run lasted {number(view.duration_s)} s"
    if view.path is not None and len(view.path.t_s) > 1:
        way = float(np.hypot(np.diff(view.path.x_m), np.diff(view.path.y_m)).sum())
        far = float(np.hypot(view.path.x_m - view.path.x_m[0], view.path.y_m - view.path.y_m[0]).max())
        text += f"; the robot drove {number(way)} m and was at most {number(far)} m from its start"
    return text + "."


def _interface(end: str, iface: str, values: dict[str, Any]) -> str:
    throughput = values.get("throughput_mbps") or {}
    rssi = values.get("rssi_dbm") or {}
    parts = []
    if not throughput.get("mean") and rssi.get("mean") is None:
        return ""  # an interface that carried nothing and heard nothing
    if throughput.get("mean") is not None:
        parts.append(
            f"carried {number(throughput['mean'])} Mbit/s on average{interval(throughput.get('mean_ci95'))}"
            f" (sent {number(throughput.get('tx_mean'))}, received {number(throughput.get('rx_mean'))})"
        )
    if rssi.get("mean") is not None:
        parts.append(f"read an RSSI of {number(rssi['mean'])} dBm (std {number(rssi.get('std'), 2)} dB)")
    return f"At the {end}, {iface} " + " and ".join(parts) + "." if parts else ""


def _delay(delay: dict[str, Any]) -> str:
    if delay.get("median") is None:
        return "No round trip was answered." if delay.get("loss_percent") == 100 else ""
    return (
        f"A round trip took {number(delay['median'])} ms at the median, {number(delay.get('mean'))} ms on average"
        f"{interval(delay.get('mean_ci95'))} and {number(delay.get('p95'))} ms at the 95th percentile; "
        f"{number(delay.get('loss_percent'))} % of the probes were lost."
    )


def _outages(view: RunView) -> str:
    if not view.outages:
        return "There was no outage." if view.of("delay") else ""
    lengths = [o.end_s - o.start_s for o in view.outages]
    longest = view.outages[int(np.argmax(lengths))]
    times = "once" if len(lengths) == 1 else f"{len(lengths)} times"
    text = (
        f"The link was out {times}, {number(sum(lengths))} s in all "
        f"({number(100 * sum(lengths) / view.duration_s, 2)} % of the time); the longest outage, "
        f"{number(max(lengths))} s, began {number(longest.start_s)} s into the run"
    )
    if view.path is not None:
        x, y = view.path.at(np.array([longest.start_s]))
        if np.isfinite(x[0]):
            text += f" at x = {number(float(x[0]))} m, y = {number(float(y[0]))} m"
    return text + "."

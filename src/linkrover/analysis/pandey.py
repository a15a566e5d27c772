"""The figures of "Pandey et al. 2022" by the paper's own formulas, row by row.

A row is one odometry message with the last value of every topic; a value that stood for two seconds weighs as many
rows as were written meanwhile, and rows of an outage are left out of throughput. Kept so that a reader can see what
the choice of method does: the figures are not time-weighted and have no intervals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .delay import DelayFigures
from .link import SignalFigures, SpreadFigures, ThroughputFigures
from .motion import BY_COMMAND, motion_figures, still_window
from .run import End, Run
from .summary import (
    EndFigures,
    InterfaceFigures,
    PartFigures,
    RunSummary,
    _identity_reason,
    clock_figures,
    setups,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .run import Columns

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

THROUGHPUT_LIMIT_MBPS = 200.0
RSSI_LIMITS_DBM = (-200.0, -4.0)
NO_ODOMETRY = "the paper's method weighs by odometry rows, and no odometry was recorded"
FIRST_STANDSTILL_LEFT_OUT = frozenset({"2", "3"})  # the cases of Table III made without the first standstill


class Rows:
    """The run as the paper's CSV rows: one per odometry message, each topic's last value held."""

    def __init__(self, run: Run) -> None:
        import numpy as np

        pose = run.pose
        self.run = run
        self.times = pose["time_ns"] if pose is not None else np.zeros(0, np.int64)
        self._places: dict[int, tuple[NDArray[np.int64], NDArray[np.intp], Flags]] = {}
        self.delay = self._delays()
        self.lost = self.delay == -1
        command = run.robot.command if run.robot is not None else None
        if command is not None:
            forward = self.hold(command["time_ns"], command["forward_m_per_s"])
            turn = self.hold(command["time_ns"], command["turn_rad_per_s"])
            self.static: Flags | None = (forward == 0) & (turn == 0)
        else:
            self.static = None

    def hold(self, times: NDArray[np.int64], values: Floats) -> Floats:
        """Each row's last value of a topic; NaN before the first."""
        import numpy as np

        found = self._places.get(id(times))
        if found is None or found[0] is not times:
            at = np.searchsorted(times, self.times, side="right") - 1
            found = self._places[id(times)] = times, np.maximum(at, 0), at < 0
        held = np.asarray(values, np.float64)[found[1]]
        held[found[2]] = np.nan
        return held

    def _delays(self) -> Floats:
        """The delay column: ms, -1 for a lost ping, NaN before the first."""
        import numpy as np

        from .delay import find_probes

        probes = find_probes(self.run, application=True)
        if probes is None:
            return np.full(len(self.times), np.nan)
        order = np.argsort(probes.known_s, kind="stable")
        # whole nanoseconds, so that a sample counts in the very row in which it appeared
        known = self.run.origin_ns + np.rint(probes.known_s[order] * 1e9).astype(np.int64)
        value = np.where(np.isnan(probes.delay_ms[order]), -1.0, probes.delay_ms[order])
        return self.hold(known, value)

    def without_first_standstill(self) -> Flags | None:
        """Static rows without the first run of them."""
        import numpy as np

        if self.static is None or not self.static.any():
            return None
        first = int(np.argmax(self.static))
        moved = np.flatnonzero(~self.static[first:])
        out = self.static.copy()
        out[first : first + int(moved[0]) if len(moved) else len(out)] = False
        return np.asarray(out, dtype=np.bool_)


def mean_std(values: Floats) -> tuple[float | None, float | None]:
    """Mean and sample standard deviation (ddof 1)."""
    if not len(values):
        return None, None
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else None


def summarise_pandey(run: Run) -> RunSummary:
    """The paper's Table II and Table III figures of one run."""
    import numpy as np

    rows = Rows(run)
    every = np.ones(len(rows.times), bool)
    whole = _part(rows, every, extra=True)
    still, _ = still_window(run)
    no_lead = rows.without_first_standstill()
    known = rows.static is not None
    moving = ~rows.static if rows.static is not None else None
    return RunSummary(
        method="pandey2022",
        run=run.name,
        case=run.case,
        trial=run.trial,
        factors=run.factors,
        duration_s=run.span.seconds,
        delay_ms=whole.delay_ms,
        ends=whole.ends,
        static=_sub(rows, rows.static),
        moving=_sub(rows, moving),
        static_no_lead=_sub(rows, no_lead),
        motion=motion_figures(run, still, BY_COMMAND if known else None),
        clock=clock_figures(run),
        setup=setups(run),
        problems=run.problems if len(rows.times) else (*run.problems, NO_ODOMETRY),
        repairs=run.repairs,
        reason=_identity_reason(run),
    )


def _sub(rows: Rows, mask: Flags | None) -> PartFigures:
    if mask is None or not mask.any():
        reason = "no velocity commands were recorded" if rows.static is None else "no such rows"
        return PartFigures(delay_ms=DelayFigures(reason=reason), ends={}, reason=reason)
    return _part(rows, mask, extra=False)


def _part(rows: Rows, mask: Flags, *, extra: bool) -> PartFigures:
    import numpy as np

    seconds = np.append(np.diff(rows.times), 0) / 1e9 if len(rows.times) else np.zeros(0)
    return PartFigures(
        duration_s=float(seconds[mask].sum()),
        delay_ms=_delay(rows, mask, extra=extra),
        ends={role: _end(rows, end, mask, extra=extra) for role, end in rows.run.ends.items()},
        reason=None if len(rows.times) else NO_ODOMETRY,
    )


def _delay(rows: Rows, mask: Flags, *, extra: bool) -> DelayFigures:
    import numpy as np

    delay = rows.delay[mask]
    valid = delay[delay > 0]
    mean, std = mean_std(valid)
    lost, received = int((delay == -1).sum()), int(np.isfinite(delay).sum())
    values = np.sort(valid)
    median, p95 = (float(np.quantile(values, q)) for q in (0.5, 0.95)) if len(values) else (None, None)
    read = rows.run.rows_in_file if extra else None
    return DelayFigures(
        source="rows",
        answered=len(valid),
        lost=lost,
        mean=mean,
        std=std,
        median=median,
        p95=p95,
        loss_percent=100.0 * lost / received if received else None,
        time_out_percent=100.0 * lost / (read or len(delay)) if len(delay) else None,
        reason="mean_ci95, censored_mean: the paper's method has none" if len(delay) else NO_ODOMETRY,
    )


def _end(rows: Rows, end: End, mask: Flags, *, extra: bool) -> EndFigures:
    if not end.interfaces:
        return EndFigures(reason="no interface was recorded at this end")
    found = {i: _interface(rows, end, i, mask, extra=extra) for i in end.interfaces}
    return EndFigures(interfaces=found, primary=end.primary)


def _interface(rows: Rows, end: End, iface: str, mask: Flags, *, extra: bool) -> InterfaceFigures:
    wireless = end.wireless.get(iface)
    errors = end.errors.get(iface)
    machine = errors if errors is not None else next(iter(end.errors.values()), None)
    retransmits, retries = _risen(rows, machine, "tcp_retransmits", mask), _risen(rows, errors, "mac_tx_retries", mask)
    lqi = _held(rows, wireless, "link_quality")[mask]
    quality_mean, quality_std = mean_std(lqi[lqi > 0])
    rssi = _held(rows, wireless, "rssi_dbm")[mask]
    rssi_mean, rssi_std = mean_std(rssi[(rssi > RSSI_LIMITS_DBM[0]) & (rssi < RSSI_LIMITS_DBM[1])])
    return InterfaceFigures(
        throughput_mbps=_throughput(rows, end, iface, mask, extra=extra),
        rssi_dbm=SignalFigures(
            mean=rssi_mean,
            std=rssi_std,
            reason="rssi: no valid reading" if rssi_mean is None else "mean_ci95: the paper's method has none",
        ),
        link_quality=SpreadFigures(mean=quality_mean, std=quality_std),
        retransmits=float(retransmits.sum()) if retransmits is not None else None,
        mac_retries=float(retries.sum()) if retries is not None else None,
        spread={
            name: SpreadFigures(mean=mean_std(kept)[0], std=mean_std(kept)[1])
            for name, steps in (("retransmits", retransmits), ("mac_retries", retries))
            if steps is not None and len(kept := steps)
        },
        reason=None if machine is not None else "retransmits: no error counters were recorded",
    )


def _held(rows: Rows, table: Columns | None, name: str) -> Floats:
    import numpy as np

    if table is None or name not in table:
        return np.full(len(rows.times), np.nan)
    return rows.hold(table["time_ns"], table[name])


def _risen(rows: Rows, table: Columns | None, name: str, mask: Flags) -> Floats | None:
    """Row differences of a counter that are not negative, in the paper's way: a fall is no difference at all."""
    import numpy as np

    if table is None or name not in table:
        return None
    held = _held(rows, table, name)[mask]
    steps = np.diff(held[held >= 0])
    return np.asarray(steps[steps >= 0], dtype=np.float64)


def _throughput(rows: Rows, end: End, iface: str, mask: Flags, *, extra: bool) -> ThroughputFigures:
    import numpy as np

    table = end.utilization.get(iface)
    if table is None:
        return ThroughputFigures(reason="throughput: no counters of this interface were recorded")
    figures: dict[str, float | None] = {}
    prefix, suffix = ("c" if end.role == "robot" else "s"), iface.removeprefix("iface").replace("1", "")
    for key, columns in (("tx_", ("tx",)), ("rx_", ("rx",)), ("", ("tx", "rx"))):
        if rows.run.published_2021:
            value = sum(table[f"{c}_published"] for c in columns)  # Mbit per loop, as the 2021 package published it
        else:
            length = np.maximum(table["t_s"] - table["begin_s"], 1e-9)
            good = table["has_base"]
            value = sum(np.where(good, table[f"{c}_bits"] / length / 1e6, np.nan) for c in columns)
        held = rows.hold(table["time_ns"], np.asarray(value, np.float64))[mask & ~rows.lost]
        if extra:  # the spreadsheet's own sums and means below the last row went into the paper's averages
            cells = rows.run.summary_rows.get(f"{prefix}_total_{key}mbps{suffix}", [])
            held = np.concatenate([held, np.asarray(cells, np.float64)])
        kept = held[(held >= 0) & (held < THROUGHPUT_LIMIT_MBPS)]
        figures[f"{key}mean"], figures[f"{key}std"] = mean_std(kept)
    return ThroughputFigures(
        **figures,  # type: ignore[arg-type]
        samples=len(table["t_s"]),
        reason="connected_mean, mean_ci95, ess: the paper's method has none",
    )

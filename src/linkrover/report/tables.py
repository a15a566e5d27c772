"""The tables of a report: one run in detail, and the paper's Table II and Table III over cases."""

from __future__ import annotations

from collections.abc import Sequence

from linkrover.analysis.delay import DelayFigures
from linkrover.analysis.summary import EndFigures, InterfaceFigures, PartFigures, RunSummary

from .table import Column, Table

CASE_WORDS = {"router": "AP a router", "robot": "AP on robot", "station": "AP on station"}


def label(summary: RunSummary) -> str:
    """A run's name for a table row: case, factors and trial where they are known, else the run's name."""
    if summary.case is None:
        return summary.run
    words = [CASE_WORDS.get(summary.factors.get("ap", ""), ""), *(summary.factors.get(k, "") for k in _FACTORS)]
    known = ", ".join(w for w in words if w)
    trial = f", trial {summary.trial}" if summary.trial is not None else ""
    return f"{summary.case}{f' ({known})' if known else ''}{trial}"


_FACTORS = ("adapter", "band")


def main_interface(end: EndFigures | None) -> InterfaceFigures | None:
    """The interface of an end that carried the traffic."""
    if end is None or end.primary is None:
        return None
    return end.interfaces.get(end.primary)


def run_table(summary: RunSummary) -> Table:
    """One run: every end and direction."""
    columns = (
        Column("figure"),
        Column("unit"),
        Column("value", 2),
        Column("std", 2),
        Column("95 % interval"),
        Column("moving", 2),
        Column("still", 2),
    )
    table = Table(f"Run {label(summary)}", columns, name=f"run-{summary.run}")
    rows = table.rows
    delay, moving, still = summary.delay_ms, summary.moving, summary.static
    parts = (moving.delay_ms, still.delay_ms)
    source = {"stamp": "round trip (probe)", "rows": "round trip (rows)"}.get(delay.source or "", "round trip")
    rows.append([f"{source}, mean", "ms", delay.mean, delay.std, interval(delay.mean_ci95), *(p.mean for p in parts)])
    rows.append(["median", "ms", delay.median, None, interval(delay.median_ci95), *(p.median for p in parts)])
    rows.append(["95th percentile", "ms", delay.p95, None, interval(delay.p95_ci95), *(p.p95 for p in parts)])
    rows.append(["99th percentile", "ms", delay.p99, None, interval(delay.p99_ci95), *(p.p99 for p in parts)])
    rows.append(
        ["time-outs at the deadline, mean", "ms", delay.censored_mean, None, "", *_each(parts, "censored_mean")]
    )
    rows.append(
        ["probes lost", "%", delay.loss_percent, None, interval(delay.loss_ci95), *_each(parts, "loss_percent")]
    )
    if delay.loss_forward_percent is not None:
        rows.append(["  lost on the way there", "%", delay.loss_forward_percent, None, "", None, None])
        rows.append(["  lost on the way back", "%", delay.loss_back_percent, None, "", None, None])
    rows.append(["time without answer", "%", delay.time_out_percent, None, "", *_each(parts, "time_out_percent")])
    if delay.jitter is not None:
        rows.append(["jitter (RFC 3550)", "ms", delay.jitter, None, "", None, None])
        rows.append(["delay variation (PDV), 99th percentile", "ms", delay.pdv_p99, None, "", None, None])
    for name, way in (("there", delay.forward), ("back", delay.back)):
        if way is not None:
            bound = f"± {way.error_bound_ms:.2f} (clock)" if way.error_bound_ms is not None else ""
            rows.append([f"one way {name}, median", "ms", way.median, None, bound, None, None])
    for role, end in summary.ends.items():
        for iface, figures in end.interfaces.items():
            _interface_rows(table, role, iface, figures, (moving, still))
    if delay.source is None and delay.reason:
        table.notes.append(delay.reason)
    return table


def _each(parts: Sequence[DelayFigures], name: str) -> list[float | None]:
    return [getattr(part, name) for part in parts]


def _interface_rows(
    table: Table, role: str, iface: str, figures: InterfaceFigures, parts: tuple[PartFigures, PartFigures]
) -> None:
    thr, rssi = figures.throughput_mbps, figures.rssi_dbm
    others = [part.ends[role].interfaces.get(iface) if role in part.ends else None for part in parts]
    where = f"{role} {iface}"
    means = [o.throughput_mbps.mean if o else None for o in others]
    table.rows.append([f"{where}: throughput", "Mbit/s", thr.mean, thr.std, interval(thr.mean_ci95), *means])
    table.rows.append([f"{where}: sent", "Mbit/s", thr.tx_mean, thr.tx_std, "", *_of(others, "tx_mean")])
    table.rows.append([f"{where}: received", "Mbit/s", thr.rx_mean, thr.rx_std, "", *_of(others, "rx_mean")])
    if thr.connected_mean is not None:
        table.rows.append([f"{where}: while connected", "Mbit/s", thr.connected_mean, None, "", None, None])
    signal = [o.rssi_dbm.mean if o else None for o in others]
    table.rows.append([f"{where}: RSSI", "dBm", rssi.mean, rssi.std, interval(rssi.mean_ci95), *signal])
    again = [o.retransmits if o else None for o in others]
    table.rows.append([f"{where}: TCP retransmits (whole machine)", "", figures.retransmits, None, "", *again])
    for reason in (
        thr.reason if thr.mean is None else None,
        rssi.reason if rssi.mean is None else None,
        (figures.reason or "").split("; link_quality")[0] if figures.retransmits is None else None,
    ):
        if reason:
            table.notes.append(f"{where}: {reason}")


def _of(others: Sequence[InterfaceFigures | None], name: str) -> list[float | None]:
    return [getattr(o.throughput_mbps, name) if o else None for o in others]


def interval(pair: tuple[float, float] | None, decimals: int = 2) -> str:
    """[low, high]."""
    return f"[{pair[0]:.{decimals}f}, {pair[1]:.{decimals}f}]" if pair else ""


def table_two(summaries: Sequence[RunSummary]) -> Table:
    """The paper's Table II: throughput, delay, loss, RSSI of both ends, retransmits; one row a run."""
    paper = all(s.method == "pandey2022" for s in summaries)
    columns = (
        Column("case"),
        Column("throughput mean (Mbit/s)", short="Mbit/s", better="high", truncate=paper),
        Column("std", truncate=paper),
        Column("delay mean (ms)", short="ms", better="low", truncate=paper),
        Column("std ", truncate=paper),
        Column("loss (%)", better="low", truncate=paper),
        Column("RSSI robot (dBm)", short="robot dBm", better="high", truncate=paper),
        Column("std  ", truncate=paper),
        Column("RSSI station (dBm)", short="station dBm", better="high", truncate=paper),
        Column("std   ", truncate=paper),
        Column("retransmits", 0, short="retr.", better="low"),
    )
    table = Table("Table II: the whole drive", columns, name="table2")
    for summary in summaries:
        robot, station = (main_interface(summary.ends.get(role)) for role in ("robot", "station"))
        delay = summary.delay_ms
        loss = delay.loss_percent if paper else delay.time_out_percent
        again = [i.retransmits for i in (robot, station) if i is not None and i.retransmits is not None]
        table.rows.append(
            [
                label(summary),
                robot.throughput_mbps.mean if robot else None,
                robot.throughput_mbps.std if robot else None,
                delay.mean,
                delay.std,
                loss,
                robot.rssi_dbm.mean if robot else None,
                robot.rssi_dbm.std if robot else None,
                station.rssi_dbm.mean if station else None,
                station.rssi_dbm.std if station else None,
                max(again) if again else None,
            ]
        )
    if paper:
        table.notes.append(
            "By the formulas of Pandey et al. 2022, cut after one decimal as printed there; rows of an outage are left "
            "out of throughput. Retransmits: of the end that sent more of them again."
        )
    else:
        table.notes.append(
            "Time-weighted; throughput is bytes over all elapsed time, delay of answered probes, loss the share of "
            "time without an answer. Retransmits: of the end that sent more of them again. Best value in bold; see "
            "the intervals before reading a difference into it."
        )
    return table


def table_three(summaries: Sequence[RunSummary]) -> Table:
    """The paper's Table III: throughput and delay while the robot stood still; one row a run."""
    paper = all(s.method == "pandey2022" for s in summaries)
    columns = (
        Column("case"),
        Column("throughput still (Mbit/s)", short="Mbit/s", better="high", truncate=paper),
        Column("std", truncate=paper),
        Column("delay still (ms)", short="ms", better="low", truncate=paper),
        Column("std ", truncate=paper),
        Column("share of time still (%)", short="still %"),
    )
    table = Table("Table III: standing still", columns, name="table3")
    for summary in summaries:
        part = still_part(summary)
        robot = main_interface(part.ends.get("robot"))
        if robot is None and (whole := summary.ends.get("robot")) is not None and whole.primary is not None:
            end = part.ends.get("robot")
            robot = end.interfaces.get(whole.primary) if end is not None else None
        table.rows.append(
            [
                label(summary),
                robot.throughput_mbps.mean if robot else None,
                robot.throughput_mbps.std if robot else None,
                part.delay_ms.mean,
                part.delay_ms.std,
                summary.motion.static_percent,
            ]
        )
    if paper:
        table.notes.append("Cases 2 and 3 without the first standstill, as in the paper.")
    table.notes.append("Standing still and being near go together: see the matched comparison before crediting rest.")
    return table


def still_part(summary: RunSummary) -> PartFigures:
    """The part of Table III: for cases 2 and 3 the paper left the first standstill out."""
    from linkrover.analysis.pandey import FIRST_STANDSTILL_LEFT_OUT

    if summary.static_no_lead is not None and summary.case in FIRST_STANDSTILL_LEFT_OUT:
        return summary.static_no_lead
    return summary.static

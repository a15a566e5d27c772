"""All figures of all runs as one long CSV: a row a figure, for spreadsheets and scripts."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

import msgspec

from linkrover.analysis.summary import EndFigures, PartFigures, RunSummary

HEADER = ("run", "case", "trial", "method", "part", "end", "interface", "figure", "value", "low95", "high95")
_Row = tuple[str, str, str, float, float | None, float | None]


def tidy_csv(summaries: Sequence[RunSummary]) -> str:
    """RFC 4180; unknown figures have no row. Units are in the figures' names, as in the JSON."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(HEADER)
    for summary in summaries:
        head = (summary.run, summary.case, summary.trial, summary.method)
        whole = PartFigures(duration_s=summary.duration_s, delay_ms=summary.delay_ms, ends=summary.ends)
        parts = {"whole": whole, "static": summary.static, "moving": summary.moving}
        if summary.static_no_lead is not None:
            parts["static_no_lead"] = summary.static_no_lead
        for name, part in parts.items():
            for end, iface, figure, value, low, high in _part(part):
                writer.writerow(["" if v is None else v for v in (*head, name, end, iface, figure, value, low, high)])
        for name, end, iface, which, figures in _details(summary):
            for figure, value, *_ in _numbers(which, figures):
                writer.writerow(["" if v is None else v for v in (*head, name, end, iface, figure, value, "", "")])
    return out.getvalue()


def _details(summary: RunSummary) -> Iterator[tuple[str, str, str, str, msgspec.Struct]]:
    """(part, end, interface, which one, its figures) of what only some recordings hold."""
    for station in summary.stations:
        yield "stations", station.end, station.iface, station.peer, station
    for channel in summary.channels:
        yield "channels", channel.end, channel.iface, f"{channel.frequency_mhz} MHz", channel
    for hood in summary.neighbourhoods:
        yield "neighbourhoods", hood.end, hood.iface, "", hood
        for near in hood.neighbours:
            yield "neighbours", hood.end, hood.iface, near.bssid, near
    for connection in summary.connections:
        which = f"{connection.local} > {connection.remote}"
        yield "connections", connection.end, connection.iface, which, connection
    for topic in summary.topics:
        yield "topics", topic.end, "", f"{topic.topic} {topic.direction} {topic.node} {topic.peer}", topic
    for end, balance in summary.balance.items():
        yield "balance", end, balance.iface, "", balance
    for end, account in summary.account.items():
        yield "account", end, "", "", account


def _part(part: PartFigures) -> Iterator[_Row]:
    if part.duration_s is not None:
        yield "", "", "duration_s", part.duration_s, None, None
    for figure, value, low, high in _numbers("delay_ms", part.delay_ms):
        yield "", "", figure, value, low, high
    for role, end in part.ends.items():
        yield from _end(role, end)


def _end(role: str, end: EndFigures) -> Iterator[_Row]:
    for iface, figures in end.interfaces.items():
        for group in ("throughput_mbps", "rssi_dbm", "link_quality"):
            for figure, value, low, high in _numbers(group, getattr(figures, group)):
                yield role, iface, figure, value, low, high
        counters = {"retransmits": figures.retransmits, "mac_retries": figures.mac_retries, **figures.counters}
        for name, count in counters.items():
            if count is not None:
                yield role, iface, name, count, None, None


def _numbers(group: str, figures: msgspec.Struct | None) -> Iterator[tuple[str, float, float | None, float | None]]:
    if figures is None:
        return
    values = {f.name: getattr(figures, f.name) for f in msgspec.structs.fields(figures)}
    for name, value in values.items():
        if isinstance(value, msgspec.Struct):
            yield from _numbers(f"{group}.{name}", value)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            low, high = values.get(f"{name}_ci95") or (None, None)
            yield f"{group}.{name}" if group else name, float(value), low, high

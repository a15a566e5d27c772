"""What measuring cost and how punctual it was, for the reader who asks whether the instrument disturbed."""

from __future__ import annotations

from linkrover.analysis.summary import RunSummary

from .section import Section
from .table import Column, Table

MUCH_MISSED_PERCENT = 1.0


def cost_section(summary: RunSummary) -> Section:
    """One row an end, and a warning where samples or records are missing."""
    section = Section("What measuring cost")
    if not summary.account:
        return section
    columns = (
        Column("agent at"),
        Column("CPU (% of a core)", 2, short="CPU %"),
        Column("busiest account (%)", 1, short="max %", spare=True),
        Column("memory (MB)", 1, short="MB", spare=True),
        Column("samples", 0, spare=True),
        Column("slots missed", 0, short="missed"),
        Column("late, median (ms)", 2, short="late ms", spare=True),
        Column("late, worst (ms)", 1, short="worst ms"),
        Column("records", 0, spare=True),
        Column("records lost", 0, short="lost"),
        Column("recording (kbit/s)", 1, short="kbit/s", spare=True),
    )
    table = Table("The instrument's own account", columns, name=f"account-{summary.run}")
    for role, a in summary.account.items():
        row: list[str | float | int | None] = [role, a.cpu_percent, a.cpu_max_percent, a.memory_max_mb, a.samples]
        row += [a.missed_slots, a.lateness_median_ms, a.lateness_max_ms, a.records_written, a.records_lost]
        table.rows.append([*row, a.recorded_kbps])
        if a.missed_percent is not None and a.missed_percent >= MUCH_MISSED_PERCENT:
            section.words.append(
                f"The {role}'s agent missed {a.missed_slots} of {a.samples + a.missed_slots} slots "
                f"({a.missed_percent:.0f} %): the machine was too busy for it, and figures of short events have gaps."
            )
        if a.records_lost:
            section.words.append(
                f"The {role}'s agent lost {a.records_lost} records on their way to the disk or the graph."
            )
    table.notes.append("By the agents themselves; late is how long after its slot a sample was taken.")
    section.tables.append(table)
    return section

"""What measuring cost, and how punctual it was: the instrument's own account."""

from __future__ import annotations

import msgspec

from .run import End, Run


class AccountFigures(msgspec.Struct, frozen=True, kw_only=True):
    """One end's agent. cpu_percent: of one core. Lateness: how long after its slot a sample was taken, ms."""

    cpu_percent: float | None = None
    cpu_max_percent: float | None = None  # of one account, usually a second
    memory_max_mb: float | None = None  # resident
    samples: int = 0
    missed_slots: int = 0
    missed_percent: float | None = None
    lateness_median_ms: float | None = None  # median over the accounts' medians
    lateness_max_ms: float | None = None
    records_written: int | None = None
    records_lost: int | None = None
    recorded_mb: float | None = None
    recorded_kbps: float | None = None  # what the recording grew by, kbit/s
    reason: str | None = None


def account_figures(run: Run) -> dict[str, AccountFigures]:
    """By end, where the agent kept its account."""
    return {role: found for role, end in run.ends.items() if (found := _account(end)) is not None}


def _account(end: End) -> AccountFigures | None:
    import numpy as np

    table = end.account
    if table is None or not len(table["t_s"]):
        return None
    nothing = np.full(len(table["t_s"]), np.nan)

    def known(name: str) -> np.ndarray:
        column = table.get(name, nothing)
        return column[np.isfinite(column)]

    def largest(name: str, scale: float = 1.0) -> float | None:
        column = known(name)
        return float(column.max()) * scale if len(column) else None

    seconds, cpu = table["interval_ns"] / 1e9, table["cpu_ns"] / 1e9
    used = (seconds > 0) & np.isfinite(cpu)
    total = float(seconds[used].sum())
    full = used & (seconds > 0.5 * np.median(seconds[used])) if used.any() else used
    samples, missed = int(known("samples").sum()), int(known("missed_slots").sum())
    slots = samples + missed
    late = known("lateness_median_ns")
    octets, written, lost = (largest(name) for name in ("bytes_written", "records_written", "records_lost"))
    return AccountFigures(
        cpu_percent=100.0 * float(cpu[used].sum()) / total if total > 0 else None,
        cpu_max_percent=100.0 * float((cpu[full] / seconds[full]).max()) if full.any() else None,
        memory_max_mb=largest("rss_bytes", 1e-6),
        samples=samples,
        missed_slots=missed,
        missed_percent=100.0 * missed / slots if slots else None,
        lateness_median_ms=float(np.median(late)) / 1e6 if len(late) else None,
        lateness_max_ms=largest("lateness_max_ns", 1e-6),
        records_written=int(written) if written is not None else None,
        records_lost=int(lost) if lost is not None else None,
        recorded_mb=octets / 1e6 if octets is not None else None,
        recorded_kbps=octets * 8e-3 / total if octets is not None and total > 0 else None,
    )

"""After an interruption: when each layer was back - the radio, the first probe, the first application answer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np

from linkrover.records import EventKind, LinkEvent

from .delay import Probes, application_probes
from .motion import position_at
from .run import Run
from .window import Window

if TYPE_CHECKING:
    from numpy.typing import NDArray

BACK = (EventKind.ASSOCIATED, EventKind.ROAMED)
# A packet sent just before the radio went may be the one whose loss opens the outage.
NEAR_S = 1.0


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """One interruption. Gaps in seconds from `begin_s`; `None` = not seen or not back before the recording ended."""

    begin_s: float
    cause: str  # "roam", "disconnection" or "no answer" (the radio said nothing)
    end: str | None = None  # where the radio's event was seen
    previous_bssid: str | None = None
    bssid: str | None = None
    radio_back_s: float | None = None
    probe_back_s: float | None = None
    application_back_s: dict[str, float] = {}
    x_m: float | None = None
    y_m: float | None = None


def recoveries(run: Run, probes: Probes | None, outages: Window) -> list[Recovery]:
    """Interruptions in order: each radio gap, and each outage during which the radio told of none."""
    applications = {
        method: application_probes(end, method, run.published_2021)
        for end in run.ends.values()
        for method in end.delays
        if probes is None or method != probes.source
    }
    found: list[Recovery] = []
    for role, end in run.ends.items():
        for t_s, event in end.events:
            if event.kind in BACK and event.gap_ns is not None:
                found.append(_recovery(run, t_s - event.gap_ns / 1e9, role, event, probes, applications))
    gaps = [(r.begin_s, r.begin_s + (r.radio_back_s or 0.0)) for r in found]
    for begin, stop in zip(outages.begins.tolist(), outages.ends.tolist(), strict=True):
        if not any(a < stop and begin - NEAR_S < b for a, b in gaps):
            found.append(_recovery(run, begin, None, None, probes, applications))
    return sorted(found, key=lambda r: r.begin_s)


def first_answer_after(probes: Probes, begin_s: float) -> float | None:
    """Seconds from begin_s to the arrival of the first answer to a probe sent after it; None = none came."""
    answered = np.isfinite(probes.delay_ms) & (probes.sent_s >= begin_s)
    arrived: NDArray[np.float64] = probes.sent_s[answered] + probes.delay_ms[answered] / 1e3
    return float(arrived.min() - begin_s) if len(arrived) else None


def _recovery(
    run: Run,
    begin_s: float,
    role: str | None,
    event: LinkEvent | None,
    probes: Probes | None,
    applications: dict[str, Probes],
) -> Recovery:
    x, y = position_at(run, np.array([begin_s]))
    backs = {method: first_answer_after(found, begin_s) for method, found in applications.items()}
    cause = "no answer"
    if event is not None:
        cause = "roam" if event.kind is EventKind.ROAMED else "disconnection"
    return Recovery(
        begin_s=begin_s,
        cause=cause,
        end=role,
        previous_bssid=event.previous_bssid if event else None,
        bssid=event.bssid if event else None,
        radio_back_s=event.gap_ns / 1e9 if event and event.gap_ns is not None else None,
        probe_back_s=first_answer_after(probes, begin_s) if probes is not None else None,
        application_back_s={method: back for method, back in backs.items() if back is not None},
        x_m=float(x[0]) if np.isfinite(x[0]) else None,
        y_m=float(y[0]) if np.isfinite(y[0]) else None,
    )


def recovery_sentence(recovery: Recovery) -> str:
    """For example: "roam at 12.3 s: radio back after 0.50 s, first probe 0.90 s, ros1 action 2.40 s"."""
    parts = []
    if recovery.radio_back_s is not None:
        parts.append(f"radio back after {recovery.radio_back_s:.2f} s")
    if recovery.probe_back_s is not None:
        parts.append(f"first probe {recovery.probe_back_s:.2f} s")
    parts += [f"{method} {back:.2f} s" for method, back in recovery.application_back_s.items()]
    return f"{recovery.cause} at {recovery.begin_s:.1f} s: " + (", ".join(parts) or "nothing came back")

"""Sentences about the figures: what was seen, how sure it is, what is missing."""

from __future__ import annotations

from collections.abc import Sequence

from linkrover.analysis.summary import RunSummary

from .tables import label, main_interface

PAPER = (
    "Method pandey2022: the formulas of the 2022 paper, row by row, kept for comparison. A row is an odometry message, "
    "so a one-second sample weighs as many rows as were written while it stood; rows of an outage are left out of "
    "throughput; there are no intervals."
)
OURS = (
    (
        "Throughput is bytes over all elapsed time at the interface, both directions unless said; it is what was sent, "
        "not what could have been."
    ),
    (
        "Intervals are 95 %, from a stationary block bootstrap with blocks of twice the autocorrelation time; they "
        "speak of this run only, not of the next drive."
    ),
    (
        "Delay mean, median and percentiles are of answered probes; the line with time-outs counts each lost one as "
        "the deadline."
    ),
)


def overview(summaries: Sequence[RunSummary]) -> list[str]:
    """One sentence a run."""
    return [run_sentence(summary) for summary in summaries]


def run_sentence(summary: RunSummary) -> str:
    """The main figures of a run in one sentence."""
    parts = [f"{label(summary)}: {summary.duration_s:.0f} s"]
    if summary.motion.driven_m is not None:
        parts.append(f"{summary.motion.driven_m:.0f} m driven")
    robot = main_interface(summary.ends.get("robot"))
    if robot is not None and robot.throughput_mbps.mean is not None:
        text = f"{robot.throughput_mbps.mean:.1f} Mbit/s"
        if (ci := robot.throughput_mbps.mean_ci95) is not None:
            text += f" (95 %: {ci[0]:.1f} to {ci[1]:.1f})"
        parts.append(text)
    delay = summary.delay_ms
    if delay.median is not None:
        tail = f", 95 % below {delay.p95:.1f}" if delay.p95 is not None else ""
        parts.append(f"round trip {delay.median:.1f} ms at the median{tail}")
    if delay.loss_percent is not None:
        parts.append(f"{delay.loss_percent:.1f} % of probes lost")
    if summary.outages:
        longest = max(o.duration_s for o in summary.outages)
        several = "outages" if len(summary.outages) > 1 else "outage"
        parts.append(f"{len(summary.outages)} {several}, the longest {longest:.1f} s")
    elif summary.method == "linkrover" and delay.source is not None:
        parts.append("no outage")
    return ", ".join(parts) + "."


def summary_words(summary: RunSummary) -> list[str]:
    """What a reader must know about one run beside its table."""
    words: list[str] = []
    clock = summary.clock
    if clock.error_bound_ms is not None and clock.offset_ms is not None:
        words.append(
            f"Clocks: the station's was {clock.offset_ms:+.3f} ms from the robot's, known to "
            f"{clock.error_bound_ms:.3f} ms ({clock.method})."
        )
    else:
        words.append(f"Clocks: {clock.method}.")
    if summary.motion.rule:
        words.append(f"Standing still by {summary.motion.rule}.")
    for role, end in summary.ends.items():
        for iface, figures in end.interfaces.items():
            if figures.rssi_dbm.disagreeing:
                words.append(
                    f"{role} {iface}: {figures.rssi_dbm.disagreeing} signal readings contradict their connection "
                    "status and are left out."
                )
            if figures.counter_resets:
                words.append(
                    f"{role} {iface}: counters fell {figures.counter_resets} times (restarts, or two publishers); "
                    "the increases allow for it."
                )
    for method, delay in summary.application_delay_ms.items():
        if summary.delay_ms.source not in (None, method) and delay.median is not None:
            probe = summary.delay_ms.median
            more = f", {delay.median - probe:+.2f} ms beyond the probe's" if probe is not None else ""
            words.append(f"Application round trip ({method}): {delay.median:.2f} ms at the median{more}.")
    words += [f"Missing: {problem}" for problem in summary.problems]
    words += [f"Mended at import: {repair}" for repair in summary.repairs]
    return words


def limits(summaries: Sequence[RunSummary]) -> list[str]:
    """How the figures were made and what they do not say."""
    if all(s.method == "pandey2022" for s in summaries):
        return [PAPER]
    words = list(OURS)
    threshold = next((s.outage_threshold_s for s in summaries if s.outage_threshold_s is not None), None)
    if threshold is not None:
        words.append(f"An outage is a stretch of more than {threshold:g} s without an answered probe.")
    if any(s.setup and any(e.emulated for e in s.setup.values()) for s in summaries):
        words.append("The radio was emulated: real packets, modelled channel.")
    return words

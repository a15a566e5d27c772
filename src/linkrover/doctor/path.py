"""Checks of clocks and of the path to the peer. Pure: facts in, findings out."""

from __future__ import annotations

from linkrover.probe.summary import ProbeSummary
from linkrover.records import ClockOffset

from .finding import Finding, Status, judged, ok, unknown

OFFSET_GOOD_NS, OFFSET_BAD_NS = 10_000_000, 500_000_000
LOSS_GOOD, LOSS_BAD = 0.01, 0.1
RTT_GOOD_NS, RTT_BAD_NS = 50_000_000, 200_000_000
BLOAT_GOOD_NS, BLOAT_BAD_NS = 50_000_000, 200_000_000
_GOOD_SOURCES = {"tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "riscv_clocksource", "xen"}


def clock_source(current: str | None) -> Finding:
    """The kernel's clock source."""
    why = "a slow clock source costs microseconds a time stamp; hpet or acpi_pm hints at an unstable processor clock"
    if current is None:
        return unknown("clock source", "the kernel does not say", why)
    status = Status.OK if current in _GOOD_SOURCES or current.endswith("_timer") else Status.WARN
    mend = "see /sys/devices/system/clocksource/clocksource0/available_clocksource; `dmesg | grep -i tsc` says why"
    return judged("clock source", status, current, why, mend)


def synchronized(yes: bool, error_ns: float) -> Finding:
    """Whether the wall clock follows a time server."""
    why = "two unsynchronised machines disagree about when: transforms are refused as too old, logs cannot be joined"
    if yes:
        return ok("clock synchronised", f"yes, to within {error_ns / 1e6:.1f} ms by the kernel's own estimate", why)
    mend = "sudo apt-get install chrony (or: sudo timedatectl set-ntp true); in a container, on its host"
    return judged("clock synchronised", Status.WARN, "no time server disciplines this clock", why, mend)


def offset(found: ClockOffset | None, peer: str) -> Finding:
    """The peer's clock against ours."""
    why = "tf and message filters drop what seems to come from the past or the future"
    if found is None:
        return unknown("clock offset", f"{peer}: not known without answered probes", why)
    size = max(0, abs(found.offset_ns) - found.error_bound_ns)
    if size < OFFSET_GOOD_NS:
        status = Status.OK
    else:
        status = Status.WARN if size < OFFSET_BAD_NS else Status.FAIL
    value = f"{peer} is {_ms(found.offset_ns)} ahead of us, +- {_ms(found.error_bound_ns)}"
    return judged("clock offset", status, value, why, "run chrony at both ends, the robot following the station")


def answers(summary: ProbeSummary, peer: str, hint: str) -> list[Finding]:
    """Reachability, loss and round trip."""
    why = "everything else about the link rests on this"
    if not summary.answered and not summary.late:
        return [
            judged("peer", Status.FAIL, f"{peer}: none of {summary.sent + summary.not_sent} probes answered", why, hint)
        ]
    loss = summary.loss or 0.0
    status = Status.OK if loss <= LOSS_GOOD else Status.WARN if loss <= LOSS_BAD else Status.FAIL
    count = summary.sent + summary.not_sent
    where = f" (there {summary.lost_forward}, back {summary.lost_back})" if summary.lost else ""
    found = [
        judged(
            "peer", status, f"{peer}: {loss * 100:.1f} % of {count} probes without an answer in time{where}",
            "a lost packet costs TCP at least 200 ms, an unreliable topic a sample",
            "look at signal, power save and channel above; then at the access point",
        )
    ]  # fmt: skip
    if summary.rtt is not None:
        median = summary.rtt.median_ns
        status = Status.OK if median < RTT_GOOD_NS else Status.WARN if median < RTT_BAD_NS else Status.FAIL
        value = f"median {_ms(median)}, p95 {_ms(summary.rtt.p95_ns)}, max {_ms(summary.rtt.max_ns)}"
        found.append(
            judged(
                "round trip", status, value,
                "teleoperation feels more than 100 ms; the distance driven blind is speed times delay",
                "look at power save, the queue and the channel's load above",
            )
        )  # fmt: skip
    return found


def large_messages(answered: int, sent: int, octets: int) -> Finding:
    """Whether datagrams that must be cut into fragments come through."""
    why = "ROS 2 sends large messages as fragmented UDP; a firewall or NAT that drops fragments drops every image"
    value = f"{answered} of {sent} datagrams of {octets} octets came back"
    if sent and answered >= sent - 1:
        return ok("large messages", value, why)
    status = Status.FAIL if not answered else Status.WARN
    return judged(
        "large messages", status, value, why, "let IP fragments pass in firewalls on the way; look at the MTU above"
    )


def version(ours: str, theirs: str | None, peer: str) -> Finding:
    """LinkRover at the other end."""
    why = "both ends should measure and record the same way"
    if theirs is None:
        return unknown("peer's version", f"{peer}: does not tell (another make of reflector, or none)", why)
    if theirs == ours:
        return ok("peer's version", f"{theirs} at both ends", why)
    return judged(
        "peer's version",
        Status.WARN,
        f"{theirs} there, {ours} here",
        why,
        f"pip install linkrover=={ours} at the other end",
    )


def bufferbloat(idle_ns: float | None, loaded_ns: float | None, way: str) -> Finding:
    """Round trip under load against idle (RFC 6349 buffer delay)."""
    why = "when the camera fills the queue, a velocity command waits as long as the queue is deep"
    name = f"buffer delay {way}"
    if idle_ns is None or loaded_ns is None or idle_ns <= 0:
        return unknown(name, "no answered probes while idle or loaded", why)
    added = loaded_ns - idle_ns
    status = Status.OK if added < BLOAT_GOOD_NS else Status.WARN if added < BLOAT_BAD_NS else Status.FAIL
    value = f"{_ms(idle_ns)} idle, {_ms(loaded_ns)} loaded ({added / idle_ns * 100:+.0f} %)"
    mend = "fair queueing (fq_codel or cake) at the end that sends; a lower rate limit on camera topics"
    return judged(name, status, value, why, mend)


def _ms(ns: float) -> str:
    return f"{ns / 1e6:.1f} ms" if abs(ns) < 9_995e6 else f"{ns / 1e9:.1f} s"

"""`linkrover probe`: one-off probing of a reflector, like ping."""

from __future__ import annotations

import json as json_module
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from linkrover.errors import ConfigError
from linkrover.loop import Loop
from linkrover.probe.address import load_key, resolve, split_host_port
from linkrover.probe.packet import DEFAULT_PORT
from linkrover.probe.sender import StampSender
from linkrover.probe.summary import Direction, Distribution, ProbeSummary, summarise
from linkrover.records import ClockSource, ProbeResult, ProbeState

from . import _units

EACH_PROBE_UP_TO_HZ = 10.0
DRAIN_EXTRA_NS = 50_000_000
RESULTS_MOST = 500_000


def probe(
    host: str,
    *,
    count: int | None = None,
    duration: float | None = None,
    rate: float = 10.0,
    deadline: float = 2.0,
    port: int | None = None,
    size: int = 0,
    key_file: Path | None = None,
    dscp: int = 0,
    interface: str | None = None,
    source: str | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> int:
    """Probe a reflector: round trip, loss in each direction, jitter, delay variation, one-way delay.

    The other end runs `linkrover reflect`, an agent with `--reflect`, or any
    STAMP (RFC 8762) or TWAMP-Light responder. Probes leave on a fixed schedule
    and never wait for each other. Without --count or --duration it goes on
    until Ctrl-C, which ends it with the summary. Exit status: 0 answered, 1
    nothing answered, 130 --count or --duration interrupted.

    linkrover probe station

    linkrover probe 10.0.0.2 --rate 100 --duration 30

    linkrover probe router --port 862      (other vendors' gear)

    Args:
        host: Reflector: name, address, HOST:PORT or [V6ADDRESS]:PORT.
        count: Stop after this many probes.
        duration: Stop after this many seconds.
        rate: Probes a second, 1 to 1000. Up to 10 each probe has a line, above that each second.
        deadline: Seconds after which a probe without an answer is lost, and an answer late.
        port: UDP port of the reflector, 8620 by default. STAMP's own, used by other vendors' gear, is 862.
        size: Octets of UDP payload; probes are padded up to it. Default and least: 44, with a key 112.
        key_file: File with the shared key: authenticated mode (HMAC-SHA-256). The reflector needs the same.
        dscp: Differentiated services code point, 0 to 63. Wi-Fi gives 46 the voice and 0 the best-effort queue.
        interface: Network device to send through.
        source: Local address to send from.
        json: Print one JSON object at the end and nothing else.
        quiet: Print the summary only.
    """
    if count is not None and count < 1:
        raise ConfigError(f"--count {count}: must be at least 1")
    if duration is not None and duration <= 0:
        raise ConfigError(f"--duration {duration:g}: must be above 0 s")
    if not 1 <= rate <= 1000:
        raise ConfigError(f"--rate {rate:g}: must be from 1 to 1000 probes a second")
    name, given_port = split_host_port(host, port or DEFAULT_PORT)
    endpoint = resolve(name, port or given_port)
    slots = [n for n in (count, max(1, round(duration * rate)) if duration is not None else None) if n is not None]
    loop = Loop()
    run = _Run(rate, quiet=quiet or json)
    sender = StampSender(
        loop,
        endpoint.host,
        endpoint.address[1],
        on_result=run.take,
        period_ns=round(1e9 / rate),
        deadline_ns=round(deadline * 1e9),
        count=min(slots) if slots else None,
        key=load_key(key_file) if key_file else None,
        size=size,
        dscp=dscp,
        interface=interface,
        source=source,
    )
    if not (quiet or json):
        print(f"probing {name} ({endpoint}), {sender.packet_bytes} octets at {rate:g} Hz, session {sender.session}")
    run.reason = lambda: (sender.last_error and sender.last_error.strerror) or "refused"
    interrupted = _go(loop, sender, run, deadline_ns=round(deadline * 1e9))
    summary = summarise(run.results)
    if json:
        document = {
            "summary": msgspec.to_builtins(summary),
            "sender": msgspec.to_builtins(sender.counters),
            "packet_bytes": sender.packet_bytes,
            "reflector": {"restarts": sender.reflector_restarts, "stateless": sender.reflector_stateless},
        }
        print(json_module.dumps(document, indent=2))
    else:
        print(f"\n--- {endpoint}, {summary.duration_ns / 1e9:.1f} s ---")
        if len(run.results) == RESULTS_MOST:
            print(f"of the last {RESULTS_MOST} probes:")
        print("\n".join(render(summary, stateless=sender.reflector_stateless)))
        if sender.counters.missed_slots:
            print(f"slots of the schedule missed, this machine was busy: {sender.counters.missed_slots}")
    if summary.answered + summary.late == 0:
        print(f"linkrover: {_why_silent(sender, endpoint.address[1])}", file=sys.stderr)
        return 1
    return 130 if interrupted and slots else 0


def _go(loop: Loop, sender: StampSender, run: _Run, *, deadline_ns: int) -> bool:
    """Send and wait for the last answers; True if it was interrupted."""
    state = {"interrupted": False, "ends_ns": 0}

    def interrupt() -> None:
        state["interrupted"] = True
        loop.stop()

    def watch() -> None:
        now_ns = time.monotonic_ns()
        if not sender.sending:
            state["ends_ns"] = state["ends_ns"] or now_ns + deadline_ns + DRAIN_EXTRA_NS
            if sender.in_flight == 0 or now_ns >= state["ends_ns"]:
                loop.stop()
                return
        loop.at(now_ns + 20_000_000, watch)

    restore = _units.on_interrupt(interrupt)
    try:
        sender.start()
        loop.call_soon(watch)
        loop.every(1_000_000_000, lambda _slot: run.second(), start_ns=time.monotonic_ns() + 1_000_000_000)
        loop.run()
    finally:
        sender.stop()
        loop.close()
        restore()
    return bool(state["interrupted"])


class _Run:
    """Keeps the results and prints the live lines."""

    def __init__(self, rate: float, *, quiet: bool) -> None:
        self.results: deque[ProbeResult] = deque(maxlen=RESULTS_MOST)
        self.reason: Callable[[], str] = str
        self._quiet = quiet
        self._each = rate <= EACH_PROBE_UP_TO_HZ
        self._fresh: list[ProbeResult] = []

    def take(self, result: ProbeResult) -> None:
        self.results.append(result)
        if self._quiet:
            return
        if self._each:
            reason = f" ({self.reason()})" if result.state is ProbeState.NOT_SENT else ""
            print(line(result) + reason, flush=True)
        else:
            self._fresh.append(result)

    def second(self) -> None:
        if self._each or self._quiet:
            return
        fresh, self._fresh = self._fresh, []
        states = [r.state for r in fresh]
        rtts = sorted(r.rtt_ns for r in fresh if r.rtt_ns is not None and not r.duplicates)
        lost = sum(s in (ProbeState.LOST, ProbeState.LOST_FORWARD, ProbeState.LOST_BACK) for s in states)
        text = f"last second: {len(rtts)} answered, {lost} lost, {states.count(ProbeState.NOT_SENT)} not sent"
        if rtts:
            middle = rtts[len(rtts) // 2]
            text += (
                f"; rtt min {_units.duration(rtts[0])}, median {_units.duration(middle)}, "
                f"max {_units.duration(rtts[-1])}"
            )
        print(text, flush=True)


def line(result: ProbeResult) -> str:
    """One probe's fate in one line."""
    text = f"seq={result.sequence} "
    if result.rtt_ns is None:
        return text + result.state.value
    text += f"rtt={_units.duration(result.rtt_ns)}"
    if result.state is ProbeState.LATE:
        text += " late"
    if result.duplicates:
        text += f" duplicate x{result.duplicates}"
    if result.reordered:
        text += " out of order"
    clocks = (result.send_clock, result.receive_clock)
    if clocks != (ClockSource.KERNEL, ClockSource.KERNEL):
        text += f" (clocks: sent {clocks[0].value}, received {clocks[1].value})"
    return text


def render(summary: ProbeSummary, *, stateless: bool = False) -> list[str]:
    """The summary as lines of text."""
    s = summary
    first = (
        f"sent {s.sent}, answered {s.answered}, lost {s.lost}, late {s.late} ({_units.share(s.loss)} without an answer "
        f"in time); duplicates {s.duplicates}, out of order {s.reordered}, not sent {s.not_sent}"
    )
    lines = [first]
    if s.lost and stateless:
        lines.append("lost where: unknown, the reflector is stateless (it does not count what it receives)")
    elif s.lost:
        lines.append(f"lost on the way there {s.lost_forward}, on the way back {s.lost_back}, unknown {s.lost_unknown}")
    if s.rtt is None:
        return lines
    lines.append(_spread("round trip", s.rtt))
    for name, way in (("there", s.forward), ("back", s.back)):
        lines.extend(_way_lines(name, way))
    if s.offset is not None:
        drift = "" if s.offset.drift_ppb is None else f", drift {s.offset.drift_ppb / 1e3:+.2f} ppm"
        lines.append(
            f"peer's clock minus ours: {_units.duration(s.offset.offset_ns)} +- "
            f"{_units.duration(s.offset.error_bound_ns)}{drift}"
        )
    else:
        lines.append("peer's clock minus ours: unknown (no steady offset fits: a clock was set meanwhile)")
    clocks = "; ".join(
        f"{name} " + ", ".join(f"{clock} {n}" for clock, n in sorted(found.items()))
        for name, found in (("sent", s.send_clocks), ("received", s.receive_clocks))
    )
    lines.append(f"clocks: {clocks}")
    if s.lateness is not None:
        middle, worst = _units.duration(s.lateness.median_ns), _units.duration(s.lateness.max_ns)
        lines.append(f"our own lateness: median {middle}, max {worst}")
    return lines


def _spread(name: str, d: Distribution, *, extra: str = "") -> str:
    parts = (("min", d.min_ns), ("mean", d.mean_ns), ("median", d.median_ns), ("p95", d.p95_ns), ("p99", d.p99_ns))
    text = ", ".join(f"{label} {_units.duration(value)}" for label, value in (*parts, ("max", d.max_ns)))
    return f"{name}: {text}" + (f", std {_units.duration(d.std_ns)}" if d.std_ns is not None else "") + extra


def _way_lines(name: str, way: Direction) -> list[str]:
    lines = []
    if way.delay is not None:
        lines.append(_spread(f"one way {name}", way.delay, extra=f" (each +- {_units.duration(way.delay_bound_ns)})"))
    if way.pdv is not None:
        text = f"variation {name}: PDV p95 {_units.duration(way.pdv.p95_ns)}, p99 {_units.duration(way.pdv.p99_ns)}"
        if way.ipdv is not None:
            text += f"; IPDV mean {_units.duration(way.ipdv.mean_ns)}, p99 {_units.duration(way.ipdv.p99_ns)}"
        lines.append(f"{text}; jitter {_units.duration(way.jitter_ns)}")
    return lines


def _why_silent(sender: StampSender, port: int) -> str:
    counters = sender.counters
    if counters.refused:
        return f"nothing answered: nothing listens on UDP port {port} there. Start `linkrover reflect` on that machine"
    if counters.unauthenticated:
        return "answers came with a wrong HMAC: both ends need the same --key-file"
    if counters.sent == 0 and sender.last_error is not None:
        return f"no probe could be sent: {sender.last_error.strerror}. See `ip route get` for that address"
    return (
        "nothing answered. Is `linkrover reflect` (or an agent with --reflect) running there, does a firewall pass "
        f"UDP port {port}, and have both ends the same key or none?"
    )

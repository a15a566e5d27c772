"""Probes over the air, through mac80211: kernel stamps, and losses told by direction."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from linkrover.loop import Loop
from linkrover.probe.reflector import StampReflector
from linkrover.probe.sender import StampSender
from linkrover.probe.summary import summarise
from linkrover.records import ClockSource, ProbeResult, ProbeState

from .air import Air, Radio, datagrams, inside, run

MS = 1_000_000


@pytest.fixture(scope="module", autouse=True)
def cell(air: Air, station: Radio, robot: Radio) -> None:
    air.access_point(station, "probing", 36)
    air.station(robot, "probing", [36])
    datagrams("robot", "10.1.0.2", 3)


def run_until(loop: Loop, condition: Callable[[], bool], timeout_s: float = 40.0) -> None:
    ends = time.monotonic_ns() + round(timeout_s * 1e9)
    while not condition():
        assert time.monotonic_ns() < ends, "the condition was not met in time"
        loop.run(time.monotonic_ns() + 10 * MS)


def test_probes_over_the_air_have_kernel_stamps_and_an_outage_has_a_direction(robot: Radio, station: Radio):
    loop = Loop()
    reflector = StampReflector(loop, "10.1.0.2", 0)
    out: list[ProbeResult] = []
    with inside("station"):
        reflector.start()
    with inside("robot"):
        sender = StampSender(
            loop, "10.1.0.2", reflector.port, on_result=out.append, period_ns=50 * MS, deadline_ns=500 * MS
        )
        sender.start()
        run_until(loop, lambda: sum(r.state is ProbeState.ANSWERED for r in out) >= 30)
        run("tc", "qdisc", "add", "dev", station.iface, "root", "netem", "loss", "100%", ns="station")
        run_until(loop, lambda: any(r.state is ProbeState.LOST for r in out))
        run("tc", "qdisc", "del", "dev", station.iface, "root", ns="station")
        run_until(loop, lambda: any(r.state is ProbeState.LOST_BACK for r in out))
        sender.stop()
    reflector.stop()
    loop.close()
    answered = [r for r in out if r.state is ProbeState.ANSWERED]
    assert {(r.send_clock, r.receive_clock) for r in answered} == {(ClockSource.KERNEL, ClockSource.KERNEL)}
    assert all(r.t1_ns < r.t2_ns <= r.t3_ns < r.t4_ns for r in answered), "both radios share this guest's clock"
    summary = summarise(out)
    assert summary.lost_forward == 0
    assert summary.lost_back > 0
    assert abs(summary.offset.offset_ns) <= summary.offset.error_bound_ns, "one clock: the true offset is 0"

from __future__ import annotations

import numpy as np
import pytest

from linkrover.analysis.delay import Probes
from linkrover.analysis.recovery import first_answer_after, recoveries, recovery_sentence
from linkrover.analysis.run import Clock, End, Run
from linkrover.analysis.window import Window
from linkrover.records import EventKind, LinkEvent

NOTHING = Window(np.zeros(0), np.zeros(0))


def probes(delay_ms: list[float], period_s: float = 0.1, source: str = "stamp") -> Probes:
    sent_s = np.arange(len(delay_ms)) * period_s
    delay = np.array(delay_ms)
    return Probes(source, sent_s, delay, np.full(len(delay), 2000.0), sent_s, serial=False)


def run(events: list[tuple[float, LinkEvent]], delays: dict[str, dict[str, np.ndarray]] | None = None) -> Run:
    end = End("robot", events=tuple(events), delays=delays or {})
    return Run("r", "r", {"robot": end}, 0, Window.of(0, 20), Clock())


def roam(gap_ns: int) -> LinkEvent:
    return LinkEvent(
        wall_ns=0, mono_ns=0, iface="wlan0", kind=EventKind.ROAMED, bssid="b", previous_bssid="a", gap_ns=gap_ns
    )


def test_a_roam_shows_the_radio_gap_beside_the_first_probe_and_the_first_application_answer():
    lost = float("nan")
    delay = [5.0] * 100 + [lost] * 8 + [100.0] + [5.0] * 91  # nothing from 10.0 s until the probe sent at 10.8 s
    action = {"t_s": np.arange(20.0), "delay_ns": np.array([5e6] * 10 + [np.nan, np.nan, 400e6] + [5e6] * 7)}
    action["deadline_ns"] = np.full(20, 2e9)
    (found,) = recoveries(run([(10.5, roam(500_000_000))], {"ros1 action": action}), probes(delay), NOTHING)
    assert found.cause == "roam"
    assert (found.previous_bssid, found.bssid) == ("a", "b")
    assert found.begin_s == pytest.approx(10.0)
    assert found.radio_back_s == pytest.approx(0.5)
    assert found.probe_back_s == pytest.approx(0.9)
    assert found.application_back_s == {"ros1 action": pytest.approx(2.4)}
    assert recovery_sentence(found) == (
        "roam at 10.0 s: radio back after 0.50 s, first probe 0.90 s, ros1 action 2.40 s"
    )


def test_an_outage_the_radio_told_of_is_not_listed_twice_and_a_silent_one_is_listed():
    delay = probes([5.0] * 200)
    outages = Window(np.array([10.2, 15.0]), np.array([12.0, 17.0]))
    found = recoveries(run([(10.5, roam(500_000_000))]), delay, outages)
    assert [(r.cause, round(r.begin_s, 1)) for r in found] == [("roam", 10.0), ("no answer", 15.0)]
    assert found[1].radio_back_s is None


def test_without_any_later_answer_the_gap_is_unknown():
    assert first_answer_after(probes([5.0, float("nan"), float("nan")]), 0.05) is None

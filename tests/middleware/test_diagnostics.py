from __future__ import annotations

from typing import Any, cast

import pytest

from linkrover.middleware import Middleware
from linkrover.middleware.diagnostics import ERROR, OK, STALE, WARN, Diagnostics, Thresholds
from linkrover.records import (
    EventKind,
    LinkEvent,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    SelfAccount,
    WirelessLink,
)

from .recording import Recording

S = 1_000_000_000


def levels(records: list[Any], at_s: float = 10.0, thresholds: Thresholds | None = None) -> dict[str, int]:
    diagnostics = Diagnostics(cast("Middleware", Recording()), "robot", thresholds)
    for record in records:
        diagnostics.take(record)
    return {s.name: s.level for s in diagnostics.statuses(int(at_s * S))}


def link(rssi_dbm: float | None, at_s: float = 10.0, **more: Any) -> WirelessLink:
    return WirelessLink(wall_ns=0, mono_ns=int(at_s * S), iface="wlan0", source="nl80211", rssi_dbm=rssi_dbm, **more)


def delay(at_s: float, delay_ms: float | None, method: str = "ros1 action") -> NetworkDelay:
    ns = None if delay_ms is None else int(delay_ms * 1e6)
    return NetworkDelay(
        wall_ns=0, mono_ns=int(at_s * S), iface="wlan0", peer="p", method=method, delay_ns=ns, alive=ns is not None
    )


@pytest.mark.parametrize(("rssi_dbm", "level"), [(-50, OK), (-72, WARN), (-82, ERROR), (None, OK)])
def test_signal_is_graded(rssi_dbm: float | None, level: int) -> None:
    assert levels([link(rssi_dbm)])["wlan0 link"] == level


def test_thresholds_can_be_set() -> None:
    assert levels([link(-50)], thresholds=Thresholds(rssi_warn_dbm=-40))["wlan0 link"] == WARN


def test_not_connected_is_an_error_and_silence_is_stale() -> None:
    assert levels([link(None, connected=False)])["wlan0 link"] == ERROR
    assert levels([link(-50, at_s=1.0)])["wlan0 link"] == STALE


def test_an_interface_that_is_gone_is_an_error() -> None:
    assert levels([LinkUtilization(wall_ns=0, mono_ns=10 * S, iface="wlan0")])["wlan0 traffic"] == ERROR


def test_loss_and_delay_are_graded_over_the_window() -> None:
    fine = [delay(t, 5) for t in range(11)]
    assert levels(fine)["delay, ros1 action to p"] == OK
    assert levels([*fine[:-1], delay(10, None)])["delay, ros1 action to p"] == WARN
    assert levels([delay(t, None) for t in range(11)])["delay, ros1 action to p"] == ERROR
    assert levels([delay(t, 150) for t in range(11)])["delay, ros1 action to p"] == WARN
    assert levels([delay(t, 900) for t in range(11)])["delay, ros1 action to p"] == ERROR


def test_an_outage_seen_by_the_probe_shows_at_once() -> None:
    fine = [delay(t, 5, "stamp") for t in range(11)]
    began = LinkEvent(wall_ns=0, mono_ns=10 * S, iface="wlan0", kind=EventKind.OUTAGE_BEGAN, peer="p")
    assert levels([*fine, began])["delay, stamp to p"] == ERROR
    ended = LinkEvent(wall_ns=0, mono_ns=10 * S, iface="wlan0", kind=EventKind.OUTAGE_ENDED, peer="p")
    assert levels([*fine, began, ended])["delay, stamp to p"] == OK


def test_retransmits_are_a_rate_over_the_window() -> None:
    def errors(at_s: float, count: int) -> NetworkErrors:
        return NetworkErrors(wall_ns=0, mono_ns=int(at_s * S), iface="wlan0", tcp_retransmits=count)

    assert levels([errors(t, 1000 + t) for t in range(11)])["wlan0 errors"] == OK
    assert levels([errors(t, 1000 + 20 * t) for t in range(11)])["wlan0 errors"] == WARN
    assert levels([errors(t, 1000 + 300 * t) for t in range(11)])["wlan0 errors"] == ERROR


def test_lost_records_are_a_warning() -> None:
    account = SelfAccount(wall_ns=0, mono_ns=10 * S, interval_ns=S, cpu_ns=1, rss_bytes=1, records_lost=1)
    assert levels([account])["recording"] == WARN


def test_names_are_stable_and_carry_the_end() -> None:
    middleware = Recording()
    diagnostics = Diagnostics(cast("Middleware", middleware), "robot")
    diagnostics.take(link(-50))
    diagnostics.publish()
    topic, kind, message, _ = middleware.messages[0]
    assert (topic, kind) == ("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    assert [s["name"] for s in message["status"]] == ["linkrover/robot: recording", "linkrover/robot: wlan0 link"]
    assert [s["hardware_id"] for s in message["status"]] == ["robot", "wlan0"]

"""The timeline of a link from a real kernel's messages: joined, thrown out, back, roamed, channel, power cut."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import EventKind, LinkEvent, Now
from linkrover.sources.netlink import pack, u32
from linkrover.sources.nl80211_events import CONNECT, DISCONNECT, NOTIFY_CQM, ROAM, LinkTimeline, parse_event

CAPTURED: dict[str, Any] = json.loads((Path(__file__).parent / "captured" / "nl80211.json").read_text())
S = 1_000_000_000
FIRST, SECOND, PEER = "02:00:00:00:00:00", "02:00:00:00:02:00", "02:00:00:00:01:00"


def told(end: str) -> list[LinkEvent]:
    timeline = LinkTimeline("wlan0", mode="ap" if end == "robot" else "station")
    events = []
    for place, payload in enumerate(CAPTURED["events"][end]):
        events += timeline.take(parse_event(bytes.fromhex(payload)), Now(place * S, place * S))
    return events


def event(command: int, *attributes: tuple[int, bytes]) -> bytes:
    return bytes([command, 1, 0, 0]) + b"".join(pack(*one) for one in attributes)


def mac(text: str) -> bytes:
    return bytes.fromhex(text.replace(":", ""))


def test_a_clients_day_is_told_in_order():
    kinds = [one.kind for one in told("station") if one.kind not in (EventKind.SCAN, EventKind.REGULATORY)]
    assert kinds == [
        EventKind.ASSOCIATED,
        EventKind.DISCONNECTED,
        EventKind.ASSOCIATED,
        EventKind.CQM_HIGH,
        EventKind.CQM_LOW,
        EventKind.DISCONNECTED,
        EventKind.ROAMED,
        EventKind.CQM_HIGH,
        EventKind.CHANNEL_SWITCH,
        EventKind.BEACON_LOSS,
        EventKind.DISCONNECTED,
        EventKind.ROAMED,
        EventKind.DISCONNECTED,
    ]


def test_being_thrown_out_has_its_reason_and_the_return_its_gap():
    lost, back = [one for one in told("station") if one.kind in (EventKind.DISCONNECTED, EventKind.ASSOCIATED)][1:3]
    assert (lost.reason_code, lost.locally_generated, lost.bssid) == (5, False, FIRST)
    assert (back.bssid, back.previous_bssid) == (FIRST, FIRST)
    assert back.gap_ns == back.mono_ns - lost.mono_ns


def test_a_roam_is_disconnected_then_another_access_point():
    roam = next(one for one in told("station") if one.kind is EventKind.ROAMED)
    assert (roam.previous_bssid, roam.bssid) == (FIRST, SECOND)
    assert roam.gap_ns == 4 * S
    low = next(one for one in told("station") if one.kind is EventKind.CQM_LOW)
    assert low.rssi_dbm == -66


def test_a_channel_switch_and_a_power_cut_are_told():
    events = told("station")
    assert next(one for one in events if one.kind is EventKind.CHANNEL_SWITCH).frequency_mhz == 2462
    place = [one.kind for one in events].index(EventKind.BEACON_LOSS)
    lost = events[place + 1]
    assert (lost.kind, lost.reason_code, lost.locally_generated) == (EventKind.DISCONNECTED, 4, True)


def test_countries_are_told_with_who_set_them():
    details = [one.detail for one in told("station") if one.kind is EventKind.REGULATORY]
    assert details[:2] == ["DE, set by a user", "US, set by a user"]


def test_scans_by_anybody_are_told_with_their_length():
    assert all(one.gap_ns == S for one in told("station") if one.kind is EventKind.SCAN)


def test_an_access_point_tells_who_came_and_went():
    events = [one for one in told("robot") if one.kind in (EventKind.PEER_JOINED, EventKind.PEER_LEFT)]
    assert [one.kind for one in events[:3]] == [EventKind.PEER_JOINED, EventKind.PEER_LEFT, EventKind.PEER_JOINED]
    assert {one.peer for one in events} == {PEER}
    assert events[2].gap_ns == events[2].mono_ns - events[1].mono_ns
    assert events[1].rssi_dbm == -61


def test_another_access_point_after_a_long_time_is_an_association():
    timeline = LinkTimeline("wlan0", mode="station", bssid=FIRST)
    timeline.take(parse_event(event(DISCONNECT)), Now(0, 0))
    (back,) = timeline.take(parse_event(event(CONNECT, (6, mac(SECOND)), (72, b"\0\0"))), Now(60 * S, 60 * S))
    assert back.kind is EventKind.ASSOCIATED
    assert (back.previous_bssid, back.gap_ns) == (FIRST, 60 * S)


def test_messages_read_at_once_have_no_gap():
    timeline = LinkTimeline("wlan0", mode="station", bssid=FIRST)
    timeline.take(parse_event(event(DISCONNECT)), Now(5, 5))
    (roam,) = timeline.take(parse_event(event(CONNECT, (6, mac(SECOND)))), Now(5, 5))
    assert roam.kind is EventKind.ROAMED
    assert roam.gap_ns is None


def test_a_refused_or_timed_out_join_is_no_association():
    timeline = LinkTimeline("wlan0", mode="station")
    (refused,) = timeline.take(parse_event(event(CONNECT, (6, mac(FIRST)), (72, b"\x11\0"))), Now(1, 1))
    assert (refused.kind, refused.detail) == (EventKind.DISCONNECTED, "joining refused with status 17")
    (late,) = timeline.take(parse_event(event(CONNECT, (6, mac(FIRST)), (65, b""))), Now(2, 2))
    assert late.detail == "joining timed out"


def test_a_drivers_own_roam_keeps_the_way():
    timeline = LinkTimeline("wlan0", mode="station", bssid=FIRST)
    (roam,) = timeline.take(parse_event(event(ROAM, (6, mac(SECOND)))), Now(1, 1))
    assert (roam.previous_bssid, roam.bssid, roam.gap_ns) == (FIRST, SECOND, None)


def test_frames_without_acknowledgement_are_told():
    timeline = LinkTimeline("wlan0", mode="ap")
    (lost,) = timeline.take(parse_event(event(NOTIFY_CQM, (6, mac(PEER)), (94, pack(4, u32(50))))), Now(1, 1))
    assert "50 frames" in lost.detail
    assert lost.peer == PEER


@given(st.lists(st.integers(0, 65), max_size=30), st.sampled_from(["station", "ap", None]))
@settings(max_examples=60)
def test_any_order_of_real_messages_gives_events(places: list[int], mode: str | None):
    every = [bytes.fromhex(one) for end in ("robot", "station") for one in CAPTURED["events"][end]]
    timeline = LinkTimeline("wlan0", mode=mode)
    for step, place in enumerate(places):
        for one in timeline.take(parse_event(every[place % len(every)]), Now(step, step)):
            assert one.gap_ns is None or one.gap_ns > 0


@given(data=st.data())
@settings(max_examples=200, deadline=None)
def test_a_damaged_message_is_an_event_or_a_parse_error(data: st.DataObject):
    whole = bytes.fromhex(data.draw(st.sampled_from(CAPTURED["events"]["station"] + CAPTURED["events"]["robot"])))
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)))])
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=5)):
        if place < len(damaged):
            damaged[place] = data.draw(st.integers(0, 255))
    try:
        raw = parse_event(bytes(damaged))
    except ParseError:
        return
    LinkTimeline("wlan0", mode="ap").take(raw, Now(1, 1))


def test_a_short_message_names_what_is_missing():
    with pytest.raises(ParseError, match="header of 4 bytes"):
        parse_event(b"\x2e")

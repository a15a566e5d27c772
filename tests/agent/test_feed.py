from __future__ import annotations

import contextlib
import json
import os
import socket
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.agent.feed import FeedReceiver, FeedSender, parse_fed
from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Loop
from linkrover.records import EventKind, LinkEvent, Pose, VelocityCommand

POSE = Pose(wall_ns=5, mono_ns=6, x_m=1.0, y_m=2.0, heading_rad=0.5)


@pytest.fixture
def loop():
    loop = Loop()
    yield loop
    loop.close()


def until(loop, condition):
    deadline = time.monotonic_ns() + 20_000_000_000
    while not condition():
        assert time.monotonic_ns() < deadline
        loop.run(time.monotonic_ns() + 10_000_000)


def test_records_arrive_as_they_were_sent(loop, tmp_path):
    got = []
    receiver = FeedReceiver(loop, str(tmp_path / "feed"), got.append)
    sender = FeedSender(receiver.path)
    sent = [
        POSE,
        VelocityCommand(wall_ns=1, mono_ns=2, forward_m_per_s=0.5, turn_rad_per_s=0.0),
        LinkEvent(wall_ns=1, mono_ns=2, iface="wlan0", kind=EventKind.ROAMED, detail="x"),
    ]
    assert all(sender.send(record) for record in sent)
    until(loop, lambda: len(got) == 3)
    assert got == sent
    receiver.close()
    assert not os.path.exists(receiver.path)  # noqa: PTH110
    sender.close()


def test_times_that_are_left_out_are_those_of_arrival():
    before = time.time_ns()
    record = parse_fed(b'{"type": "Pose", "x_m": 1, "y_m": 2, "heading_rad": 0}')
    assert before <= record.wall_ns <= time.time_ns()
    assert record.mono_ns <= time.monotonic_ns()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "one JSON object"),
        (b"[1]", "one JSON object"),
        (b"{}", "one of Pose"),
        (b'{"type":"Manifest"}', "one of Pose"),
        (b'{"type":["Pose"]}', "one of Pose"),
        (b'{"type":"Pose","x_m":1,"y_m":2,"heading_rad":0,"speed":1}', "got speed"),
        (b'{"type":"Pose","x_m":"1","y_m":2,"heading_rad":0}', "x_m"),
        (b'{"type":"Pose","x_m":1,"y_m":2,"heading_rad":0,"wall_ns":1}', "mono_ns"),
        (b'{"type":"Pose","x_m":1,"y_m":2,"heading_rad":0,"wall_ns":99999999999999999999,"mono_ns":1}', "64 bit"),
        (b"[" * 60000, "one JSON object"),
        (b'{"type":"Pose","x_m":1e999,"y_m":2,"heading_rad":0}', "Pose|JSON"),
    ],
)
def test_a_bad_datagram_is_refused_with_what_was_expected(data, words):
    with pytest.raises(ParseError, match=words):
        parse_fed(data)


@given(st.binary(max_size=200))
@settings(max_examples=150)
def test_any_bytes_give_a_record_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        parse_fed(data)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=5), inner, max_size=2),
    max_leaves=4,
)


@given(st.dictionaries(st.sampled_from(["x_m", "y_m", "heading_rad", "wall_ns", "mono_ns", "unknown", "frame"]), JSON))
@settings(max_examples=150)
def test_any_fields_give_a_record_or_a_parse_error(fields):
    with contextlib.suppress(ParseError):
        parse_fed(json.dumps({"type": "Pose", **fields}).encode())


def test_bad_datagrams_are_counted_and_good_ones_still_come(loop, tmp_path):
    got = []
    receiver = FeedReceiver(loop, str(tmp_path / "feed"), got.append)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.sendto(b"rubbish", receiver.path)
        sock.sendto(b"", receiver.path)
    FeedSender(receiver.path).send(POSE)
    until(loop, lambda: got)
    assert (receiver.refused, receiver.received, got) == (2, 1, [POSE])
    receiver.close()


def test_a_sender_without_an_agent_drops_and_does_not_wait(tmp_path):
    sender = FeedSender(str(tmp_path / "feed"))
    assert not sender.send(POSE)
    assert (sender.sent, sender.dropped) == (0, 1)


def test_a_sender_whose_agent_is_busy_keeps_a_bounded_number_and_does_not_wait(loop, tmp_path):
    got = []
    receiver = FeedReceiver(loop, str(tmp_path / "feed"), got.append)
    sender = FeedSender(receiver.path)
    for _ in range(1500):
        sender.send(POSE)
    assert 0 < sender.dropped < 500
    until(loop, lambda: sender.flush() and len(got) == 1500 - sender.dropped)
    assert sender.sent == len(got)
    receiver.close()


def test_a_path_left_by_a_killed_agent_is_taken_over_and_a_live_one_is_not(loop, tmp_path):
    path = str(tmp_path / "feed")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as killed:
        killed.bind(path)
    receiver = FeedReceiver(loop, path, lambda _: None)
    with pytest.raises(ConfigError, match="another agent listens"):
        FeedReceiver(loop, path, lambda _: None)
    receiver.close()


def test_a_file_at_the_path_is_left_alone(loop, tmp_path):
    path = tmp_path / "feed"
    path.write_text("mine")
    with pytest.raises(ConfigError, match="something else"):
        FeedReceiver(loop, str(path), lambda _: None)
    assert path.read_text() == "mine"

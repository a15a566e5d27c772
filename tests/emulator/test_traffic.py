from __future__ import annotations

import asyncio
import contextlib
import socket

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.emulator.traffic import HEADER, MAGIC, Received, Sender, Stream, Traffic, every, receive
from linkrover.errors import ConfigError


def pair():
    ends = socket.socketpair()
    for end in ends:
        end.setblocking(False)
    return ends


def message(sequence, payload):
    return HEADER.pack(MAGIC, len(payload), sequence, 0) + payload


async def received(data):
    """What a stream of octets, closed after, is read as."""
    near, far = pair()
    stats, payloads = Received(), []
    with near, far:
        reading = asyncio.ensure_future(receive(far, stats, payloads.append))
        await asyncio.get_running_loop().sock_sendall(near, data)
        near.shutdown(socket.SHUT_WR)
        await asyncio.wait_for(reading, 10)
    return stats, payloads


def test_messages_arrive_whole_and_missing_ones_are_counted():
    data = message(1, b"a") + message(2, b"b" * 300_000) + message(7, b"c")
    stats, payloads = asyncio.run(received(data))
    assert [len(p) for p in payloads] == [1, 300_000, 1]
    assert (stats.messages, stats.octets, stats.missing) == (3, 300_002, 4)


@settings(max_examples=60)
@given(st.binary(max_size=200) | st.binary(max_size=60).map(lambda b: message(1, b"x") + b))
def test_any_octets_are_messages_or_refused(data):
    with contextlib.suppress(ValueError):
        asyncio.run(received(data))


def test_a_sender_that_is_held_up_drops_the_oldest_and_sends_the_newest():
    async def run():
        sender = Sender()
        for index in range(5):
            sender.offer(bytes([index]))
        near, far = socket.create_server(("127.0.0.1", 0)), None
        with near:
            far = socket.create_connection(near.getsockname())
            accepted, _ = near.accept()
        with far, accepted:
            far.setblocking(False)
            accepted.setblocking(False)
            stats, payloads = Received(), []
            tasks = [
                asyncio.ensure_future(sender.pump(far)),
                asyncio.ensure_future(receive(accepted, stats, payloads.append)),
            ]
            while not payloads:
                await asyncio.sleep(0.005)
            for task in tasks:
                task.cancel()
        return sender.stats, payloads

    stats, payloads = asyncio.run(asyncio.wait_for(run(), 10))
    assert payloads == [b"\x04"]
    assert (stats.made, stats.sent, stats.dropped_oldest) == (5, 1, 4)


def test_a_schedule_skips_what_is_past_and_never_bursts():
    async def run():
        times = []

        def work():
            times.append(asyncio.get_running_loop().time())
            if len(times) == 2:
                import time

                time.sleep(0.1)

        task = asyncio.ensure_future(every(100, work))
        while len(times) < 6:
            await asyncio.sleep(0.005)
        task.cancel()
        return times

    times = asyncio.run(asyncio.wait_for(run(), 10))
    assert times[2] - times[1] >= 0.1
    assert times[-1] - times[2] > 0.015


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Stream(octets=0, rate_hz=1), "octets"),
        (lambda: Stream(octets=10**9, rate_hz=1), "octets"),
        (lambda: Stream(octets=1, rate_hz=-1), "rate_hz"),
        (lambda: Traffic(command_hz=0), "command_hz"),
    ],
)
def test_impossible_traffic_is_refused_by_name(make, key):
    with pytest.raises(ConfigError, match=key):
        make()

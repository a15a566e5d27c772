"""A node's own account of its connections (ROS slave API getBusStats and getBusInfo), rospy's and roscpp's shapes.

rospy: publishers [topic, bytes, [[id, bytes, messages, connected]]], subscribers [topic, [[id, bytes, messages, -1,
connected]]], both inside (1, "", ...). roscpp: [topic, [[id, bytes, bytes, messages, 0]]] and [topic, [[id, bytes,
messages, drops, 0]]], bare. Counters are 32 bits wide on the wire: roscpp's turn negative at 2^31, rospy answers
with a fault from there on.
"""

from __future__ import annotations

import re
from typing import Any

import msgspec

from linkrover.errors import ParseError

SPAN = 1 << 32
OVERFLOW = "int exceeds XML-RPC limits"
"""What rospy answers once a counter has passed 2^31 - 1."""
_INFO = re.compile(r"connection on port (\d+) to \[(.+):(\d+) on socket \S+\]")


class BusCount(msgspec.Struct, frozen=True):
    """Raw counters of one connection; direction "in" or "out" as the node sees it."""

    connection: int
    topic: str
    direction: str
    bytes: int
    messages: int


class BusLink(msgspec.Struct, frozen=True):
    """Where one connection leads. peer: the other node's name, or its XML-RPC address on the subscriber's side."""

    connection: int
    topic: str
    direction: str
    peer: str
    transport: str
    local_port: int | None = None
    remote_host: str | None = None
    remote_port: int | None = None


def _payload(answer: Any, method: str) -> Any:
    """The value with or without the (code, message, value) around it."""
    if isinstance(answer, list) and len(answer) == 3 and isinstance(answer[0], int) and isinstance(answer[1], str):
        if answer[0] != 1:
            raise ParseError(method, "status code", "1", f"{answer[0]} ({answer[1]})")
        return answer[2]
    return answer


def parse_bus_stats(answer: Any, file: str = "getBusStats") -> list[BusCount]:
    """Counters of every topic connection of a node. Raises ParseError."""
    value = _payload(answer, file)
    if not isinstance(value, list) or len(value) < 2:
        raise ParseError(file, "answer", "[publishers, subscribers, services]", repr(value)[:80])
    found: list[BusCount] = []
    try:
        for entry in value[0] or []:
            bare = len(entry) == 2  # roscpp leaves the topic's own total out
            for c in entry[-1] or []:
                count, messages = (c[1], c[3]) if bare else (c[1], c[2])
                found.append(BusCount(int(c[0]), str(entry[0]), "out", int(count) % SPAN, int(messages) % SPAN))
        for entry in value[1] or []:
            for c in entry[-1] or []:
                found.append(BusCount(int(c[0]), str(entry[0]), "in", int(c[1]) % SPAN, int(c[2]) % SPAN))  # noqa: PERF401
    except (TypeError, ValueError, IndexError, KeyError) as error:
        raise ParseError(file, "connection statistics", "rospy's or roscpp's shape", str(error)) from None
    return found


def parse_bus_info(answer: Any, file: str = "getBusInfo") -> list[BusLink]:
    """Peers and ports of every connection of a node. Raises ParseError."""
    value = _payload(answer, file)
    if not isinstance(value, list):
        raise ParseError(file, "answer", "a list of connections", repr(value)[:80])
    found: list[BusLink] = []
    try:
        for entry in value:
            direction = {"i": "in", "o": "out"}.get(entry[2])
            if direction is None:
                continue  # both ways: a service
            match = _INFO.search(entry[6]) if len(entry) > 6 and isinstance(entry[6], str) else None
            local, host, remote = (int(match[1]), match[2], int(match[3])) if match else (None, None, None)
            found.append(
                BusLink(int(entry[0]), str(entry[4]), direction, str(entry[1]), str(entry[3]), local, host, remote)
            )
    except (TypeError, ValueError, IndexError, KeyError) as error:
        raise ParseError(file, "connection", "[id, peer, direction, transport, topic, ...]", str(error)) from None
    return found


def increment(before: int, after: int) -> int | None:
    """How far a 32-bit counter went; None: it was set back (a fall of more than half its span is a wrap)."""
    step = (after - before) % SPAN
    return step if step < SPAN // 2 else None

"""A program that does one thing with a middleware and says what happened, one JSON object a line.

usage: python -m tests.middleware.driver MODULE:FACTORY VERB ARGUMENT...
The factory takes a node name and gives a started Middleware.
"""

from __future__ import annotations

import importlib
import json
import logging
import sys
import time
from typing import Any

import msgspec

from linkrover.loop import Loop
from linkrover.middleware import DelayProber, Middleware

WAIT_S = 20.0


def say(kind: str, **values: Any) -> None:
    print(json.dumps({"kind": kind, **values}), flush=True)


def wait_joined(node: Middleware) -> None:
    until = time.monotonic() + WAIT_S
    while not node.joined and time.monotonic() < until:
        time.sleep(0.02)
    say("joined", joined=node.joined, describe=node.describe())


def answer(node: Middleware, action: str, seconds: str) -> None:
    end = node.answer_pings(action)
    wait_joined(node)
    time.sleep(float(seconds))
    end()


def ping(node: Middleware, action: str, count: str, period_ms: str, deadline_ms: str, start_when: str) -> None:
    """start_when: "connected" = the first ping that reaches a server counts as the first."""
    loop = Loop()
    state = {"begun": start_when != "connected"}

    def take(record: Any) -> None:
        if record.alive:
            state["begun"] = True
        if state["begun"]:
            say("delay", **msgspec.to_builtins(record))

    prober = DelayProber(
        loop,
        lambda on_answer: node.pinger(action, on_answer),
        take,
        iface="test",
        peer="peer",
        method=f"{node.name} action",
        period_ns=int(float(period_ms) * 1e6),
        deadline_ns=int(float(deadline_ms) * 1e6),
    )
    wait_joined(node)
    job = prober.start()
    until = time.monotonic_ns() + int(WAIT_S * 1e9)
    while prober.answered + prober.lost < int(count) and time.monotonic_ns() < until:
        if not state["begun"]:
            prober.lost = 0
        loop.run(time.monotonic_ns() + 20_000_000)
    job.cancel()  # or one is in flight when they are counted
    loop.run(time.monotonic_ns() + int(float(deadline_ms) * 1e6) + 100_000_000)
    say(
        "counts",
        answered=prober.answered,
        lost=prober.lost,
        late=prober.late,
        duplicates=prober.duplicates,
        in_flight=prober.in_flight,
    )
    prober.close()


def publish(node: Middleware, topic: str, type_name: str, fields: str, rate: str, seconds: str) -> None:
    longest_ns, refused = 0, 0
    until = time.monotonic() + float(seconds)
    say("begun")
    while time.monotonic() < until:
        began = time.monotonic_ns()
        refused += not node.publish(topic, type_name, json.loads(fields))
        longest_ns = max(longest_ns, time.monotonic_ns() - began)
        time.sleep(1 / float(rate))
    say("published", longest_ns=longest_ns, refused=refused, lost=node.lost_messages, joined=node.joined)


def listen(node: Middleware, what: str, topic: str, seconds: str) -> None:
    subscribe = {"odometry": node.odometry, "velocity": node.velocity}[what]
    end = subscribe(topic, lambda record: say("record", **msgspec.to_builtins(record)))
    wait_joined(node)
    time.sleep(float(seconds))
    end()


def graph(node: Middleware) -> None:
    wait_joined(node)
    say("graph", **msgspec.to_builtins(node.graph()))


def instant(node: Middleware) -> None:
    """How long each call takes that must return at once, whatever the network does."""
    took: dict[str, int] = {}
    for name, call in {
        "odometry": lambda: node.odometry("odom", print),
        "velocity": lambda: node.velocity("cmd_vel", print),
        "answer_pings": lambda: node.answer_pings("Ping"),
        "pinger": lambda: node.pinger("Ping", print),
        "publish": lambda: node.publish("cmd_vel", "geometry_msgs/Twist", {}),
        "set_parameter": lambda: node.set_parameter("a", "b"),
    }.items():
        began = time.monotonic_ns()
        call()
        took[name] = time.monotonic_ns() - began
    say("took", joined=node.joined, ns=took)


def main() -> None:
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    mine = logging.getLogger("linkrover")
    handler = logging.StreamHandler(sys.stderr)
    mine.addHandler(handler)
    mine.setLevel(logging.INFO)
    mine.propagate = False
    factory, verb, *arguments = sys.argv[1:]
    module, _, name = factory.partition(":")
    node: Middleware = getattr(importlib.import_module(module), name)(f"driver_{verb}")
    try:
        globals()[verb](node, *arguments)
    finally:
        node.close()


if __name__ == "__main__":
    main()

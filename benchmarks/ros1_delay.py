"""Round trips over veth in one run: ICMP, STAMP, our ping action, actionlib's clients and servers; and recovery."""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks._ros1 import ADDRESS, LINKROVER, Pair

COUNT = 250
PERIOD_MS = 20
DRIVER = [sys.executable, "-m", "tests.middleware.driver", "tests.ros1.test_contract:started"]

SIMPLE_CLIENT = r"""
import sys, time
import actionlib, rospy
from linkrover.ros1.types import message_class
count, period_s = int(sys.argv[1]), float(sys.argv[2]) / 1e3
rospy.init_node("simple_client")
client = actionlib.SimpleActionClient("Ping", message_class("network_analysis/PingAction"))
client.wait_for_server(rospy.Duration(10))
goal = message_class("network_analysis/PingGoal")(inp=True)
for _ in range(count):
    began = time.monotonic()
    client.send_goal(goal)
    done = client.wait_for_result(rospy.Duration(2))
    print(f"{'SUCCEEDED' if done else 'LOST'} {(time.monotonic() - began) * 1e3:.4f}", flush=True)
    time.sleep(max(0.0, began + period_s - time.monotonic()))
"""
SIMPLE_SERVER = r"""
import actionlib, rospy
from linkrover.ros1.types import message_class
rospy.init_node("simple_server")
result = message_class("network_analysis/PingResult")
server = actionlib.SimpleActionServer("Ping", message_class("network_analysis/PingAction"),
                                      lambda goal: server.set_succeeded(result(outp=goal.inp)), auto_start=False)
server.start()
rospy.spin()
"""


def main() -> None:
    if os.geteuid() != 0:
        print("needs root, to make network namespaces")
        return
    from tests.ros1.conftest import build_peers

    peers = build_peers()
    with Pair() as pair:
        _round_trips(pair, peers)
    with Pair() as pair:
        _recovery(pair)


def _round_trips(pair: Pair, peers: Path) -> None:
    cpp_server, cpp_client = [str(peers / "ping_server")], [str(peers / "ping_client"), str(COUNT), str(PERIOD_MS)]
    simple = [sys.executable, "-c", SIMPLE_CLIENT, str(COUNT), str(PERIOD_MS)]
    ours = [*DRIVER, "ping", "Ping", str(COUNT), str(PERIOD_MS), "2000", "connected"]
    our_server = [*LINKROVER, "ping-server", "--reflect", "0"]
    rows: tuple[tuple[str, list[str] | None, list[str], Callable[[str], list[float]]], ...] = (
        ("ICMP (ping)", None, ["ping", "-i", str(PERIOD_MS / 1e3), "-c", str(COUNT), ADDRESS["station"]], _icmp),
        ("C++ client, C++ server (actionlib)", cpp_server, cpp_client, _words),
        ("our client, C++ server", cpp_server, ours, _driver),
        ("our client, our server", our_server, ours, _driver),
        ("C++ client, our server", our_server, cpp_client, _words),
        ("rospy simple client, C++ server", cpp_server, simple, _words),
        ("rospy simple client, rospy simple server", [sys.executable, "-c", SIMPLE_SERVER], simple, _words),
    )
    print(f"{'round trip over veth, one at a time every 20 ms':<46} {'median ms':>10} {'p95':>8} {'over ICMP':>10}")
    base = 0.0
    for title, server, client, read in rows:
        running = None if server is None else pair.start("station", server)
        time.sleep(0.0 if server is None else 2.0)
        found = sorted(read(pair.run("robot", client)))
        if running is not None:
            pair.stop(running)
            time.sleep(0.5)
        if len(found) < COUNT // 2:
            print(f"{title:<46} only {len(found)} answers")
            continue
        median = statistics.median(found)
        base = base or median
        p95 = found[int(len(found) * 0.95)]
        print(f"{title:<46} {median:>10.3f} {p95:>8.3f} {median - base:>+10.3f}", flush=True)
    print("aim: our client at most 1.5 ms above ICMP at the median\n")


def _icmp(text: str) -> list[float]:
    return [float(ms) for ms in re.findall(r"time=([\d.]+) ms", text)]


def _words(text: str) -> list[float]:
    return [float(line.split()[1]) for line in text.splitlines() if line.startswith("SUCCEEDED")]


def _driver(text: str) -> list[float]:
    lines = [json.loads(line) for line in text.splitlines()]
    return [line["delay_ns"] / 1e6 for line in lines if line["kind"] == "delay" and line["alive"]]


def _recovery(pair: Pair) -> None:
    """Every packet silently lost for a while: how much later does each method say that the link is back?"""
    print(f"{'silent drop of':<16} {'ICMP back after':>16} {'STAMP':>10} {'ros1 action':>12}   (s after the end)")
    pair.start("station", [*LINKROVER, "ping-server"])
    time.sleep(2.0)
    for seconds in (5.0, 15.0):
        run = Path(pair.folder.name) / f"run{seconds:.0f}"
        client = pair.start(
            "robot",
            [*LINKROVER, "client", "-i", pair.devices["robot"], "--delay-rate", "10", "--record", str(run)],
        )
        time.sleep(6.0)
        icmp: list[float] = []
        stop = threading.Event()
        watcher = threading.Thread(target=_watch_icmp, args=(pair, icmp, stop))
        watcher.start()
        time.sleep(1.0)
        pair.silent(True)
        time.sleep(seconds)
        pair.silent(False)
        ended_s = time.time()
        time.sleep(seconds + 20.0)
        stop.set()
        watcher.join()
        pair.stop(client)
        back = _first_after(run / "robot", ended_s)
        first_icmp = next((t - ended_s for t in icmp if t > ended_s), float("nan"))
        print(f"{seconds:>14.0f} s {first_icmp:>16.2f} {back['stamp']:>10.2f} {back['ros1 action']:>12.2f}", flush=True)
    print("both are recorded; the state of the link is the probe's, the action's silence beyond it is TCP's back-off")


def _watch_icmp(pair: Pair, answered: list[float], stop: threading.Event) -> None:
    command = pair.command("robot", ["ping", "-D", "-i", "0.1", ADDRESS["station"]])
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            match = re.match(r"\[([\d.]+)\].*time=", line)
            if match:
                answered.append(float(match[1]))
            if stop.is_set():
                break
        process.terminate()


def _first_after(recording: Path, ended_s: float) -> dict[str, float]:
    from linkrover.bag import read_recording
    from linkrover.records import NetworkDelay

    found = {"stamp": float("nan"), "ros1 action": float("nan")}
    delays = [r for r in read_recording(recording).records(NetworkDelay) if isinstance(r, NetworkDelay)]
    for method in found:
        times = [
            (r.wall_ns + r.delay_ns) / 1e9 - ended_s
            for r in delays
            if r.method.removesuffix(" late") == method and r.delay_ns is not None
        ]
        found[method] = min((t for t in times if t > 0), default=float("nan"))
    return found


if __name__ == "__main__":
    main()

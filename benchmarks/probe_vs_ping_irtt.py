"""Round trip over a veth pair of two namespaces: our probe against ping and irtt, all in one run, three rounds.

All three send every 10 ms. ping times in the kernel for the echo and in user space for itself; irtt reports its own
user-level times; ours subtracts the reflector's time and takes kernel stamps where there are any.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

ROUNDS = 3
SAMPLES = 500
INTERVAL_S = 0.01
STATION = "10.78.0.2"


def run(*args: str) -> str:
    return subprocess.run(args, check=True, capture_output=True, text=True).stdout


@contextmanager
def two_namespaces():
    robot, station = f"lrb{os.getpid()}a", f"lrb{os.getpid()}b"
    try:
        for name in (robot, station):
            run("ip", "netns", "add", name)
        run("ip", "link", "add", "v0", "netns", robot, "type", "veth", "peer", "name", "v0", "netns", station)
        for name, address in ((robot, "10.78.0.1/24"), (station, f"{STATION}/24")):
            run("ip", "-n", name, "address", "add", address, "dev", "v0")
            for device in ("v0", "lo"):
                run("ip", "-n", name, "link", "set", device, "up")
        yield ("ip", "netns", "exec", robot), ("ip", "netns", "exec", station)
    finally:
        for name in (robot, station):
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)


def quantile(values: list[float], q: float) -> float:
    ordered = sorted(values)
    at = q * (len(ordered) - 1)
    below = int(at)
    return ordered[below] + (ordered[min(below + 1, len(ordered) - 1)] - ordered[below]) * (at - below)


def ours(robot: tuple[str, ...], *extra: str) -> tuple[float, float, str]:
    out = run(
        *robot, sys.executable, "-m", "linkrover", "probe", STATION, "--count", str(SAMPLES), "--rate",
        str(1 / INTERVAL_S), "--json", *extra,
    )  # fmt: skip
    summary = json.loads(out)["summary"]
    clocks = f"send {summary['send_clocks']}, receive {summary['receive_clocks']}"
    return summary["rtt"]["median_ns"] / 1e3, summary["rtt"]["p99_ns"] / 1e3, clocks


def ping(robot: tuple[str, ...]) -> tuple[float, float]:
    out = run(*robot, "ping", "-n", "-c", str(SAMPLES), "-i", str(INTERVAL_S), STATION)
    times = [float(t) * 1e3 for t in re.findall(r"time=([\d.]+) ms", out)]
    return quantile(times, 0.5), quantile(times, 0.99)


def irtt(robot: tuple[str, ...]) -> tuple[float, float]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "irtt.json"
        duration = f"{SAMPLES * INTERVAL_S:g}s"
        run(*robot, "irtt", "client", "-i", f"{INTERVAL_S * 1e3:g}ms", "-d", duration, "-o", str(path), "-Q", STATION)
        trips = json.loads(path.read_text())["round_trips"]
    times = [trip["delay"]["rtt"] / 1e3 for trip in trips if "rtt" in trip["delay"]]
    return quantile(times, 0.5), quantile(times, 0.99)


def main() -> None:
    if os.geteuid() != 0:
        print("skipped: needs root to make network namespaces")
        return
    missing = [tool for tool in ("ip", "ping", "irtt") if shutil.which(tool) is None]
    if missing:
        print(f"skipped: not installed: {', '.join(missing)} (scripts/system-packages bench)")
        return
    rows: dict[str, list[tuple[float, float]]] = {"linkrover probe": [], "ping": [], "irtt": []}
    clocks = ""
    with two_namespaces() as (robot, station):
        servers = [
            subprocess.Popen([*station, sys.executable, "-m", "linkrover", "reflect", "--quiet"]),
            subprocess.Popen([*station, "irtt", "server", "-b", f"{STATION}:2112"], stdout=subprocess.DEVNULL),
        ]
        try:
            time.sleep(2)
            for _ in range(ROUNDS):
                median, p99, clocks = ours(robot)
                rows["linkrover probe"].append((median, p99))
                rows["ping"].append(ping(robot))
                rows["irtt"].append(irtt(robot))
        finally:
            for server in servers:
                server.terminate()
            for server in servers:
                server.wait(10)
    best = {name: (quantile([r[0] for r in found], 0.5), quantile([r[1] for r in found], 0.5))
            for name, found in rows.items()}  # fmt: skip
    mine = best["linkrover probe"]
    print(f"RTT in us over a veth pair, {SAMPLES} samples every {INTERVAL_S * 1e3:g} ms, middle of {ROUNDS} rounds")
    print(f"{'tool':<18}{'median':>9}{'p99':>9}   {'times our median':>16}")
    for name, (median, p99) in best.items():
        print(f"{name:<18}{median:>9.1f}{p99:>9.1f}   {median / mine[0]:>16.2f}")
    print(f"our clocks: {clocks}")
    for claim, holds in (
        ("median at or below ping's", mine[0] <= best["ping"][0]),
        ("median at most a fifth of irtt's", mine[0] <= best["irtt"][0] / 5),
        ("p99 below 60 us", mine[1] < 60),
    ):
        print(f"{'reached' if holds else 'MISSED '}  {claim}")


if __name__ == "__main__":
    main()

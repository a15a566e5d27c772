"""How long `linkrover --help` takes from start to end, beside a bare interpreter."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROUNDS = 15


def main() -> None:
    linkrover = str(Path(sys.executable).with_name("linkrover"))
    commands = {
        "python -c pass": [sys.executable, "-c", "pass"],
        "linkrover --version": [linkrover, "--version"],
        "linkrover --help": [linkrover, "--help"],
        "linkrover agent --help": [linkrover, "agent", "--help"],
    }
    walls: dict[str, list[float]] = {name: [] for name in commands}
    cpus: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(ROUNDS):
        # in turn, so that whatever else the machine does falls on all alike
        for name, command in commands.items():
            cpu = _children_cpu_s()
            began = time.perf_counter()
            subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
            walls[name].append((time.perf_counter() - began) * 1e3)
            cpus[name].append((_children_cpu_s() - cpu) * 1e3)
    base = statistics.median(cpus["python -c pass"])
    print(f"{'command':<26} {'wall ms, least':>15} {'median':>8} {'CPU ms, median':>15} {'x bare Python':>14}")
    for name in commands:
        cpu = statistics.median(cpus[name])
        wall = walls[name]
        print(f"{name:<26} {min(wall):>15.0f} {statistics.median(wall):>8.0f} {cpu:>15.0f} {cpu / base:>14.1f}")
    print("aim: linkrover --help below 150 ms")


def _children_cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime

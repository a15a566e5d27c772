"""What a whole agent costs: CPU share of one core and memory, at 1 Hz + 10 Hz with probes at 10 Hz, recording."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

WARM_UP_S = 3.0
MEASURE_S = 20.0
WIRELESS = (
    "Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE\n"
    " face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22\n"
    "    lo: 0000   38.  -72.  -256        0      0      0      0      8        0\n"
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        text = Path(folder) / "wireless"
        text.write_text(WIRELESS)
        port = _free_port()
        common = [
            sys.executable,
            "-m",
            "linkrover",
            "agent",
            "--interface",
            "lo",
            "--wireless-path",
            str(text),
            "--plain",
        ]
        record = ["--record", f"{folder}/run"]
        ends = {
            "station: reflects, records": [*common, "--role", "station", "--reflect", "--port", str(port), *record],
            "robot: probes 10 Hz, records": [*common, "--peer", f"127.0.0.1:{port}", *record],
            "robot: probes 100 Hz, records": [
                *common, "--peer", f"127.0.0.1:{port}", "--probe-rate", "100", "--record", f"{folder}/fast",
            ],
            "robot: wireless 10 Hz only, no recording": [*common],
        }  # fmt: skip
        running = {name: subprocess.Popen(command, stdout=subprocess.DEVNULL) for name, command in ends.items()}
        stop = threading.Event()
        writer = threading.Thread(target=_write_wireless, args=(text, stop))
        writer.start()
        try:
            time.sleep(WARM_UP_S)
            before = {name: (_cpu_ns(process.pid), time.monotonic_ns()) for name, process in running.items()}
            time.sleep(MEASURE_S)
            print(f"{'agent':<42} {'CPU, % of a core':>17} {'resident, MB':>13} {'private, MB':>12}")
            for name, process in running.items():
                cpu_ns, at_ns = before[name]
                share = (_cpu_ns(process.pid) - cpu_ns) / (time.monotonic_ns() - at_ns) * 100
                resident, private = _memory(process.pid)
                print(f"{name:<42} {share:>17.2f} {resident / 1e6:>13.1f} {private / 1e6:>12.1f}")
        finally:
            stop.set()
            writer.join()
            for process in running.values():
                process.terminate()
            for process in running.values():
                process.wait(20)
    print("aim: below 1 % and below 60 MB for the robot that probes at 10 Hz and records")


def _write_wireless(path: Path, stop: threading.Event) -> None:
    """An emulated driver: the file anew ten times a second, in this process, not in the agents' account."""
    while not stop.wait(0.1):
        fresh = path.with_suffix(".new")
        fresh.write_text(WIRELESS)
        fresh.rename(path)


def _free_port() -> int:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as trial:
        trial.bind(("", 0))
        return int(trial.getsockname()[1])


def _cpu_ns(pid: int) -> int:
    """Time on a CPU of all threads (first field of schedstat)."""
    return sum(
        int((Path(f"/proc/{pid}/task") / task / "schedstat").read_text().split()[0])
        for task in os.listdir(f"/proc/{pid}/task")  # noqa: PTH208
    )


def _memory(pid: int) -> tuple[int, int]:
    """Resident set and its private part, bytes."""
    values = {}
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]:
        title, _, amount = line.partition(":")
        values[title] = int(amount.split()[0]) * 1024
    return values["Rss"], values["Private_Clean"] + values["Private_Dirty"]

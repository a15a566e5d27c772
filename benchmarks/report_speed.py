"""A one-hour, two-end recording to the HTML report, and how time and memory grow with the hours.

The recording is made by our own recorder: wireless at 10 Hz at both ends, traffic and errors at 1 Hz, probes at 10 Hz,
odometry at 10 Hz. Time is that of the whole command `linkrover report RUN --format html`, start included. Set
LINKROVER_BENCH_HOURS=1,10,100 for longer ones (100 h need 3 GB of disk and some minutes to make).
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

T0 = 1_790_000_000_000_000_000
SECOND = 1_000_000_000


def make_run(folder: Path, hours: float) -> int:
    """Write the recording; returns the number of records."""
    from linkrover import __version__
    from linkrover.bag import Recorder
    from linkrover.records import (
        ClockOffset,
        LinkUtilization,
        Manifest,
        NetworkErrors,
        Pose,
        ProbeResult,
        ProbeState,
        Role,
        WirelessLink,
    )

    count = 0
    seconds = int(hours * 3600)
    for role in Role:
        manifest = Manifest(
            wall_ns=T0, mono_ns=SECOND, linkrover_version=__version__, role=role, host=role.value, kernel="6.1",
            machine="x86_64", python="3.11", case="1", trial=1,
        )  # fmt: skip
        with Recorder(folder / role.value, manifest, compatible=False) as recorder:
            moved = 0
            for second in range(seconds):
                at = {"wall_ns": T0 + second * SECOND, "mono_ns": SECOND + second * SECOND}
                rate = 2_000_000 + int(1_000_000 * math.sin(second / 30))
                moved += rate
                recorder.take(LinkUtilization(**at, iface="wlan0", rx_bytes=moved // 50, tx_bytes=moved))
                recorder.take(NetworkErrors(**at, iface="wlan0", tcp_retransmits=second // 3))
                if role is Role.ROBOT:
                    recorder.take(ClockOffset(**at, peer="station", offset_ns=1000, error_bound_ns=200_000))
                for tenth in range(10):
                    now = second + tenth / 10
                    at = {"wall_ns": T0 + int(now * 1e9), "mono_ns": SECOND + int(now * 1e9)}
                    far = 10 + 8 * math.sin(now / 60)
                    rssi = -40.0 - round(25 * math.log10(far))
                    recorder.take(WirelessLink(**at, iface="wlan0", source="nl80211", connected=True, rssi_dbm=rssi))
                    if role is Role.STATION:
                        continue
                    recorder.take(Pose(**at, x_m=far, y_m=5 * math.cos(now / 60), heading_rad=0.0, forward_m_per_s=0.4))
                    lost = (second % 600) < 5
                    t1 = at["wall_ns"]
                    rtt = None if lost else int(5e6 + 3e6 * math.sin(now) ** 2 + 1e6 * (tenth % 3))
                    times = (None, None, None) if lost else (t1 + rtt // 2, t1 + rtt // 2, t1 + rtt)
                    recorder.take(
                        ProbeResult(
                            **at,
                            peer="station",
                            session=1,
                            sequence=second * 10 + tenth,
                            state=ProbeState.LOST_FORWARD if lost else ProbeState.ANSWERED,
                            rtt_ns=rtt,
                            t1_ns=t1,
                            t2_ns=times[0],
                            t3_ns=times[1],
                            t4_ns=times[2],
                        )
                    )
            count += recorder.records_written + recorder.records_lost
    return count


def measured(*arguments: str) -> tuple[float, float]:
    """Wall time (s) and peak memory (MB) of a `linkrover` command."""
    code = (
        "import resource, subprocess, sys, time\n"
        "began = time.perf_counter()\n"
        "subprocess.run([sys.executable, '-m', 'linkrover', *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)\n"
        "print(time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    out = subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True, text=True).stdout
    seconds, memory = out.split()
    return float(seconds), float(memory)


def main() -> None:
    from rich.console import Console
    from rich.table import Table

    hours = [float(h) for h in os.environ.get("LINKROVER_BENCH_HOURS", "0.1,1,3").split(",")]
    table = Table(title="A two-end recording to its report (whole command)")
    for heading in ("hours", "recording (MB)", "JSON (s)", "peak (MB)", "HTML (s)", "peak (MB)", "HTML s per hour"):
        table.add_column(heading, justify="right")
    for length in hours:
        with tempfile.TemporaryDirectory() as temporary:
            run = Path(temporary) / "run"
            began = time.monotonic()
            make_run(run, length)
            size = sum(p.stat().st_size for p in run.rglob("*.mcap")) / 1e6
            print(f"made {length:g} h in {time.monotonic() - began:.0f} s", flush=True)
            json_s, json_mb = measured("report", str(run), "--format", "json")
            html_s, html_mb = measured("report", str(run), "--format", "html", "--out", f"{temporary}/report.html")
        cells = (size, json_s, json_mb, html_s, html_mb, html_s / length)
        table.add_row(f"{length:g}", *(f"{c:.1f}" for c in cells))
    Console().print(table)


if __name__ == "__main__":
    main()

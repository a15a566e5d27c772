"""The ten cases of 2021 in virtual time, two trials each to the end of the drive, against the recordings' figures.

Prints throughput (rx + tx at the robot over all the time), share of probes lost, application delay, and the time all
of it took on this machine. CASES=1,4 and DURATION_S=60 make it shorter.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

TRIALS = 2


def one(job):
    number, trial, duration_s, folder = job
    from linkrover.bag import read_recording
    from linkrover.emulator import virtual
    from linkrover.emulator.presets import find
    from linkrover.records import LinkUtilization, NetworkDelay, ProbeResult

    out = Path(folder) / f"{number}-{trial}"
    began = time.process_time()
    virtual.run(find(str(number)), trial, 100 * number + trial, duration_s, out)
    cost = time.process_time() - began
    counters, delays, probes = [], [], []
    for record in read_recording(out / "robot").records():
        if isinstance(record, LinkUtilization):
            counters.append(record)
        elif isinstance(record, NetworkDelay):
            delays.append(record.delay_ns)
        elif isinstance(record, ProbeResult):
            probes.append(record.rtt_ns)
    first, last = counters[0], counters[-1]
    octets = last.tx_bytes + last.rx_bytes - first.tx_bytes - first.rx_bytes
    seconds = (last.mono_ns - first.mono_ns) / 1e9
    answered = [delay / 1e6 for delay in delays if delay is not None]
    return {
        "throughput": octets * 8 / seconds / 1e6,
        "unanswered": 100 * (1 - len(answered) / len(delays)),
        "lost": 100 * sum(rtt is None for rtt in probes) / len(probes),
        "mean": statistics.mean(answered),
        "median": statistics.median(answered),
        "seconds": seconds,
        "cost": cost,
    }


def main() -> None:
    from linkrover.emulator.presets import CASES

    numbers = [int(n) for n in os.environ.get("CASES", "1,2,3,4,5,6,7,8,9,10").split(",")]
    duration = os.environ.get("DURATION_S")
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(os.cpu_count()) as pool:
        jobs = [
            (number, trial, float(duration) if duration else None, folder)
            for number in sorted(numbers, key=lambda n: n not in (2, 8, 10))  # the long ones first
            for trial in range(1, TRIALS + 1)
        ]
        results = dict(zip([job[:2] for job in jobs], pool.map(one, jobs), strict=True))
    took = time.perf_counter() - began
    print(f"{'case':26} {'Mbit/s':>12} {'2021':>6} {'ratio':>6} {'goals lost %':>13} {'2021':>6} {'probes lost %':>14} "
          f"{'delay ms':>9} {'2021':>5} {'median':>7} {'2021':>5}")  # fmt: skip
    for case in CASES:
        if case.number not in numbers:
            continue
        trials = [results[case.number, trial] for trial in range(1, TRIALS + 1)]
        mean = {key: statistics.mean(trial[key] for trial in trials) for key in trials[0]}
        seen = case.observed
        both = " ".join(f"{trial['throughput']:.1f}" for trial in trials)
        print(
            f"{case.number:>2} {case.name:23} {both:>12} {seen.throughput_bps / 1e6:6.1f} "
            f"{mean['throughput'] * 1e6 / seen.throughput_bps:6.2f} {mean['unanswered']:13.1f} "
            f"{100 * seen.outage_share:6.1f} {mean['lost']:14.1f} {mean['mean']:9.0f} {1e3 * seen.delay_mean_s:5.0f} "
            f"{mean['median']:7.0f} {1e3 * seen.delay_median_s:5.0f}"
        )
    simulated = sum(result["seconds"] for result in results.values())
    cpu = sum(result["cost"] for result in results.values())
    print(f"{len(results)} runs, {simulated:.0f} s of driving, in {took:.0f} s on {os.cpu_count()} processors "
          f"({simulated / took:.0f} x real time); {cpu:.0f} s of processor time in all")  # fmt: skip


if __name__ == "__main__":
    main()

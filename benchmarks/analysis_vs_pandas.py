"""Import and statistics of one trial of 2021: ours against a set of per-trial pandas scripts, in one run.

The scripts (benchmarks/_trial_scripts.py) give the paper's means and deviations, row by row as such scripts are
commonly written; "pandas by columns" is the same done in pandas' best way. Ours gives the same figures and everything
of our own method too (intervals, outages, moving and still). End to end: every script is a process, as they are run;
ours is one `linkrover report FILE --format json`. Warm: in a process that has its imports behind it.
"""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1].parent / "shared" / "datasets"
REPEATS = 3


def trial_file(folder: Path) -> Path:
    """A published trial where they are there, else a made one of the same form and size."""
    published = FOLDER / "router_2G_trial2.csv"
    if published.is_file():
        return published
    import random

    names = ["time_step", "time_stamp", "robot_pos_x", "robot_pos_y", "vel_x", "vel_w", "network_delay"]
    names += [f"{e}_{n}" for e in "cs" for n in ("total_tx_mbps", "total_rx_mbps", "total_mbps")]
    names += [f"{e}_{n}" for e in "cs" for n in ("tx_retires", "retransmits", "rssi", "lqi", "rssi_status")]
    random.seed(1)
    lines = [",".join(names)]
    link = [10.0, 0.2, 10.2] * 2
    delay, counters = 40.0, [5, 9]
    for i in range(8000):
        if i % 27 == 0:
            tx, rx = random.uniform(2, 18), random.uniform(0.1, 0.3)
            link = [tx, rx, tx + rx, rx, tx, tx + rx]
            delay, counters = random.uniform(5, 200), [c + random.randrange(9) for c in counters]
        signal = [*counters, -50 - i % 20, 60 - i % 20, 1]
        cells = [2 * i, 1_617_811_705_825_190_000 + i * 37_000_000, i / 500, 1.0, 0.5 * (i % 900 > 300), 0.0, delay]
        lines.append(
            ",".join(f"{c:.6f}" if isinstance(c, float) else str(c) for c in [*cells, *link, *signal, *signal])
        )
    made = folder / "router_2G_made.csv"
    made.write_text("\n".join(lines) + "\n")
    return made


def best(action) -> float:
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        action()
        times.append(time.perf_counter() - began)
    return min(times)


def run(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[1])


def main() -> None:
    from rich.console import Console
    from rich.table import Table

    from benchmarks import _trial_scripts as scripts
    from linkrover.analysis import load_run, summarise
    from linkrover.cli.import_ import import_

    with tempfile.TemporaryDirectory() as temporary:
        file = trial_file(Path(temporary))

        def one_by_one() -> None:
            for name in scripts.SCRIPTS:
                run("-m", "benchmarks._trial_scripts", name, str(file))

        def warm_scripts() -> None:
            for script in scripts.SCRIPTS.values():
                script(file)

        def paper() -> None:
            summarise(load_run(file), "pandey2022")

        def both() -> None:
            loaded = load_run(file)
            summarise(loaded, "pandey2022")
            summarise(loaded)

        def recorded() -> None:
            with tempfile.TemporaryDirectory() as out, contextlib.redirect_stdout(io.StringIO()):
                import_(file, out=Path(out))
                loaded = load_run(Path(out) / file.stem)
                summarise(loaded, "pandey2022")
                summarise(loaded)

        difference = largest_difference(file, scripts)
        both()
        ours = ("-m", "linkrover", "report", str(file), "--format", "json")
        cold = {
            "pandas, row by row": best(one_by_one),
            "pandas by columns": best(lambda: run("-m", "benchmarks._trial_scripts", "vectorised", str(file))),
            "ours, the paper's method": best(lambda: run(*ours, "--method", "pandey2022")),
            "ours, our own method": best(lambda: run(*ours)),
        }
        warm = {
            "pandas, row by row": best(warm_scripts),
            "pandas by columns": best(lambda: scripts.vectorised(file)),
            "ours, the paper's method": best(paper),
            "ours, both methods": best(both),
            "ours, both, by way of recordings": best(recorded),
        }
    table = Table(title=f"One trial, {file.name}, best of {REPEATS}; ratio to the row-by-row scripts")
    for heading in ("way", "end to end (s)", "ratio", "warm (s)", "ratio"):
        table.add_column(heading, justify="left" if heading == "way" else "right")
    for name in dict.fromkeys([*cold, *warm]):
        cells = []
        for times in (cold, warm):
            known = times.get(name)
            base = times["pandas, row by row"]
            cells += [f"{known:.3f}", f"{base / known:.1f}x"] if known else ["", ""]
        table.add_row(name, *cells)
    Console().print(table)
    print(f"largest relative difference between the figures of both sides: {difference:.1e}")


def largest_difference(file: Path, scripts) -> float:
    """Both sides must come to the same figures, or the times mean nothing."""
    from linkrover.analysis import load_run, summarise

    theirs = scripts.vectorised(file)
    summary = summarise(load_run(file), "pandey2022")
    suffix = scripts.suffixes(file)[0]
    worst = abs(summary.delay_ms.mean / theirs["network_delay"][0] - 1)
    for role, end in (("robot", "c"), ("station", "s")):
        figures = summary.ends[role].interfaces["iface2" if suffix else "iface1"]
        throughput = figures.throughput_mbps
        for part, value in (("", throughput.mean), ("tx_", throughput.tx_mean), ("rx_", throughput.rx_mean)):
            worst = max(worst, abs(value / theirs[f"{end}_total_{part}mbps{suffix}"][0] - 1))
        worst = max(worst, abs(figures.rssi_dbm.mean / theirs[f"{end}_rssi{suffix}"][0] - 1))
    return worst


if __name__ == "__main__":
    main()

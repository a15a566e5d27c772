"""How often do the 95 % intervals of the radio fits hold the truth? Over 1,000 seeded repeats of synthetic drives.

The drive is the emulator's laboratory route (77 m), sampled every 10 cm; shadowing 5 dB with 3 m decorrelation,
Nakagami m = 3 multipath, whole-dB readings. Throughput: 200 samples between -85 and -45 dBm.
"""

from __future__ import annotations

import math
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import pairwise

REPEATS = 1000
ACCESS_POINT_M = (-1.0, -0.8)
LINE = {"rss_1m_dbm": -40.0, "exponent": 2.8, "sigma_db": 5.0, "decorrelation_m": 3.0}
SHARE = {"alpha_b_hz": 1.8e6, "noise_dbm": -93.0, "cap_bps": 19e6}
M = 3.0


@cache
def drive():
    import numpy as np

    from linkrover.emulator.robot import LAB_2021

    parts = []
    points = LAB_2021.waypoints
    for a, b in pairwise(points):
        count = max(1, round(math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) / 0.1))
        t = np.arange(count) / count
        parts.append(np.column_stack([a.x_m + (b.x_m - a.x_m) * t, a.y_m + (b.y_m - a.y_m) * t]))
    places = np.vstack(parts)
    distance = np.sqrt(((places[:, None] - places[None]) ** 2).sum(axis=2))
    root = np.linalg.cholesky(np.exp(-distance / LINE["decorrelation_m"]) + 1e-9 * np.eye(len(places)))
    return places, root


def one(seed):
    """{parameter: (inside, truth below the interval, truth above it)}; None where no interval was given."""
    import numpy as np
    from scipy.special import digamma

    from linkrover.radio.fit_nakagami import fit_nakagami, fit_nakagami_along
    from linkrover.radio.fit_path_loss import fit_path_loss
    from linkrover.radio.fit_position import fit_position
    from linkrover.radio.fit_throughput import fit_throughput, model_bps

    rng = np.random.default_rng(seed)
    places, root = drive()
    distance = np.hypot(places[:, 0] - ACCESS_POINT_M[0], places[:, 1] - ACCESS_POINT_M[1])
    ratio = rng.gamma(M, 1 / M, len(places))
    fade = 10 * np.log10(ratio) - 10 / math.log(10) * (digamma(M) - math.log(M))
    rssi = LINE["rss_1m_dbm"] - 10 * LINE["exponent"] * np.log10(distance)
    rssi = np.round(rssi + LINE["sigma_db"] * (root @ rng.standard_normal(len(places))) + fade)
    out = {}

    def note(name, estimate, truth):
        low = -math.inf if estimate.low is None else estimate.low
        high = math.inf if estimate.high is None else estimate.high
        out[name] = (low <= truth <= high, truth < low, truth > high)

    line = fit_path_loss(places, ACCESS_POINT_M, rssi)
    for name, truth in LINE.items():
        note(name, getattr(line, name), truth)
    inside = fit_position(places, rssi).contains(*ACCESS_POINT_M)
    out["access point (region)"] = (inside, False, False)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    note("nakagami_m (drive)", fit_nakagami_along(rssi, way), M)
    note("nakagami_m (samples)", fit_nakagami(rng.gamma(M, 1 / M, 200)), M)
    level = rng.uniform(-85, -45, 200)
    rate = model_bps(level, SHARE["alpha_b_hz"], SHARE["noise_dbm"], SHARE["cap_bps"]) + rng.normal(0, 1.2e6, 200)
    share = fit_throughput(level, rate)
    for name, truth in SHARE.items():
        note(name, getattr(share, name), truth)
    return out


def main() -> None:
    repeats = int(os.environ.get("REPEATS", REPEATS))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    results = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for index, result in enumerate(pool.map(one, range(repeats), chunksize=5), 1):
            results.append(result)
            if index % 50 == 0 and sys.stderr.isatty():
                print(f"\r{index} of {repeats}", end="", file=sys.stderr)
    own = 100 * math.sqrt(0.05 * 0.95 / repeats)
    print(f"coverage of 95 % intervals, {repeats} repeats (its own standard error: {own:.1f} points)")
    print(f"{'parameter':24} {'inside %':>9} {'truth below %':>14} {'truth above %':>14}")
    for name in results[0]:
        inside, below, above = (100 * sum(result[name][i] for result in results) / repeats for i in range(3))
        print(f"{name:24} {inside:9.1f} {below:14.1f} {above:14.1f}")


if __name__ == "__main__":
    main()

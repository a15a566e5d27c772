"""The paper's statistics of one trial as a set of small pandas scripts, the way such scripts are commonly written.

One script a table column, each reading the file and going through its rows: `python -m benchmarks._trial_scripts NAME
FILE`. `vectorised` does all of it at once with pandas' own column operations, for comparison.
"""

from __future__ import annotations

import sys

import pandas as pd


def read(path):
    frame = pd.read_csv(path, skipinitialspace=True, index_col=False)
    return frame[frame["time_stamp"].notna()]


def suffixes(path):
    return ("2",) if "external" in str(path) else ("",)


def throughput(path):
    out = {}
    frame = read(path)
    for name in [f"{end}_total_{part}mbps{s}" for end in "cs" for part in ("tx_", "rx_", "") for s in suffixes(path)]:
        values = []
        for _, row in frame.iterrows():
            if row["network_delay"] != -1 and 0 <= row[name] < 200:
                values.append(row[name])
        series = pd.Series(values)
        out[name] = (series.mean(), series.std())
    return out


def delay(path):
    values = []
    for _, row in read(path).iterrows():
        if row["network_delay"] > 0:
            values.append(row["network_delay"])
    series = pd.Series(values)
    return {"network_delay": (series.mean(), series.std())}


def loss(path):
    lost = count = 0
    for _, row in read(path).iterrows():
        if row["network_delay"] == -1:
            lost += 1
        if row["network_delay"] != -2:
            count += 1
    return {"loss": 100 * lost / count}


def signal(path):
    out = {}
    frame = read(path)
    for name in [f"{end}_{what}{s}" for end in "cs" for what in ("rssi", "lqi") for s in suffixes(path)]:
        values = []
        for _, row in frame.iterrows():
            if -200 < row[name] < -4 if "rssi" in name else row[name] > 0:
                values.append(row[name])
        series = pd.Series(values)
        out[name] = (series.mean(), series.std())
    return out


def counters(path):
    out = {}
    frame = read(path)
    for name in ("c_retransmits", "c_tx_retires", "s_retransmits", "s_tx_retires"):
        last, rises = None, []
        for _, row in frame.iterrows():
            value = row[name]
            if value < 0:
                continue
            if last is not None and value >= last:
                rises.append(value - last)
            last = value
        series = pd.Series(rises)
        out[name] = (series.sum(), series.mean(), series.std())
    return out


def static(path):
    name = f"c_total_mbps{suffixes(path)[0]}"
    rates, delays = [], []
    for _, row in read(path).iterrows():
        if row["vel_x"] == 0 and row["vel_w"] == 0:
            if row["network_delay"] != -1 and 0 <= row[name] < 200:
                rates.append(row[name])
            if row["network_delay"] > 0:
                delays.append(row["network_delay"])
    return {"static": (pd.Series(rates).mean(), pd.Series(rates).std(), pd.Series(delays).mean())}


SCRIPTS = {f.__name__: f for f in (throughput, delay, loss, signal, counters, static)}


def vectorised(path):
    out = {}
    frame = read(path)
    up = frame["network_delay"] != -1
    for s in suffixes(path):
        for end in "cs":
            for part in ("tx_", "rx_", ""):
                column = frame[f"{end}_total_{part}mbps{s}"]
                kept = column[up & (column >= 0) & (column < 200)]
                out[column.name] = (kept.mean(), kept.std())
            for what in ("rssi", "lqi"):
                column = frame[f"{end}_{what}{s}"]
                kept = column[(column > -200) & (column < -4)] if what == "rssi" else column[column > 0]
                out[column.name] = (kept.mean(), kept.std())
    answered = frame["network_delay"][frame["network_delay"] > 0]
    out["network_delay"] = (answered.mean(), answered.std())
    out["loss"] = 100 * (~up).sum() / (frame["network_delay"] != -2).sum()
    for name in ("c_retransmits", "c_tx_retires", "s_retransmits", "s_tx_retires"):
        steps = frame[name][frame[name] >= 0].diff().dropna()
        kept = steps[steps >= 0]
        out[name] = (kept.sum(), kept.mean(), kept.std())
    rest = (frame["vel_x"] == 0) & (frame["vel_w"] == 0)
    column = frame[f"c_total_mbps{suffixes(path)[0]}"]
    kept = column[rest & up & (column >= 0) & (column < 200)]
    still = frame["network_delay"][rest & (frame["network_delay"] > 0)]
    out["static"] = (kept.mean(), kept.std(), still.mean())
    return out


if __name__ == "__main__":
    print({**SCRIPTS, "vectorised": vectorised}[sys.argv[1]](sys.argv[2]))

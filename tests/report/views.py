"""Runs made by hand for the drawing tests: what they hold is known."""

from __future__ import annotations

import numpy as np

from linkrover.report.view import EventView, Line, OutageView, Path, RunView


def run_view(name: str = "demo", case: str = "1", trial: int | None = 1) -> RunView:
    """300 s, 10 Hz RSSI and delay, 1 Hz throughput, one outage from 100 s to 108 s."""
    rng = np.random.default_rng(7)
    t_s = np.arange(0, 300, 0.1)
    rssi = -60 + 10 * np.sin(t_s / 40)
    rtt_ms = np.exp(rng.normal(1.5, 0.7, len(t_s)))
    rtt_ms[1000:1080] = np.nan
    each_s = np.arange(0, 300.0)
    rate = 12 + rng.normal(0, 3, 300)
    summary = {
        "run": name,
        "case": case,
        "trial": trial,
        "duration_s": 300.0,
        "delay_ms": {"mean": 6.1, "std": 4.0, "median": 4.4, "p95": 15.0, "p99": 22.0, "loss_percent": 2.67,
                     "time_out_percent": 2.7, "mean_ci95": [5.9, 6.4], "censored_mean": 40.0},
        "ends": {
            "robot": {"interfaces": {"wlan0": {
                "throughput_mbps": {"mean": 12.3, "std": 3.0, "tx_mean": 12.0, "rx_mean": 0.3, "mean_ci95": [11, 13.5]},
                "rssi_dbm": {"mean": -61.2, "std": 6.0}, "retransmits": 123}}},
            "station": {"interfaces": {"wlan0": {
                "throughput_mbps": {"mean": 12.2}, "rssi_dbm": {"mean": None, "reason": "unsupported"},
                "retransmits": None}}},
        },
    }  # fmt: skip
    path_t = np.arange(0, 300, 0.02)
    return RunView(
        name,
        case,
        trial,
        300.0,
        summary,
        lines=(
            Line("rssi", "robot wlan0", "robot", t_s, rssi, "wlan0"),
            Line("rssi", "station wlan0", "station", t_s, rssi + 1, "wlan0"),
            Line("throughput", "robot wlan0 tx", "robot", each_s, rate, "wlan0", "tx"),
            Line("throughput", "station wlan0 rx", "station", each_s, rate, "wlan0", "rx"),
            Line("throughput", "robot wlan0 both", "robot", each_s, rate + 0.3, "wlan0", "both"),
            Line("delay", "STAMP", "robot", t_s, rtt_ms, method="stamp"),
        ),
        lost_t_s=t_s[1000:1080],
        path=Path(path_t, 8 + 7 * np.sin(path_t / 40), 5 * np.cos(path_t / 25)),
        outages=(OutageView(100.0, 108.0),),
        events=(EventView(100.0, "robot", "disconnected", "no beacon <b>"),),
        setup={"robot": {"kernel": "6.1", "driver": "iwlwifi"}, "station": {"kernel": "6.1"}},
        problems=("station: the last 0.4 s are missing </script><script>alert(1)</script>",),
    )

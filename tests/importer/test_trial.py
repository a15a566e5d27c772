from __future__ import annotations

from pathlib import Path

import pytest

from linkrover.errors import LinkRoverError
from linkrover.importer.sheet import parse_sheet
from linkrover.importer.topics import recover
from linkrover.importer.trial import load_trial
from linkrover.importer.write import write_run
from linkrover.records import (
    Continuity,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    Role,
    Unknown,
    WirelessLink,
)
from tests.datasets import FILES, dataset

T0 = 1_631_652_819_000_000_000
COLUMNS = (
    "time_step,time_stamp,robot_pos_x,robot_pos_y,vel_x,vel_w,network_delay,c_total_tx_mbps,c_total_rx_mbps,"
    "c_total_mbps,c_tx_retires,c_retransmits,c_rssi,c_lqi,c_rssi_status"
)


def made(path: Path, changes: dict[int, dict[str, str]], count: int = 300) -> Path:
    """A file of the family at 25 rows/s; `changes` sets columns from a row on."""
    names = COLUMNS.split(",")
    now = dict.fromkeys(names, "-2")
    lines = [COLUMNS]
    for i in range(count):
        now |= {"time_step": str(2 * i), "time_stamp": str(T0 + i * 40_000_000), "robot_pos_x": str(i / 100)}
        now |= {"robot_pos_y": "0"} | changes.get(i, {})
        lines.append(",".join(now[n] for n in names))
    path.write_text("\n".join(lines) + "\n")
    return path


def messages(i: int, tx: float, rx: float) -> dict[str, str]:
    return {"c_total_tx_mbps": f"{tx}", "c_total_rx_mbps": f"{rx}", "c_total_mbps": f"{tx + rx}"}


def test_repeated_rows_become_the_samples_that_were_taken(tmp_path: Path) -> None:
    changes = {25 * k: messages(k, 8.0 + k, 0.5) for k in range(1, 11)}
    trial = load_trial(made(tmp_path / "a.csv", changes))
    found = [r for r in trial.records(Role.ROBOT) if isinstance(r, LinkUtilization)]
    assert len(found) == 10
    assert found[0].continuity is Continuity.FIRST
    assert found[1].interval_ns == 1_000_000_000
    assert found[1].tx_rate_bps == pytest.approx(10e6)
    assert found[-1].tx_bytes == sum(8 + k for k in range(1, 11)) * 125_000
    assert sum(isinstance(r, Pose) for r in trial.records(Role.ROBOT)) == 300


def test_a_stretch_of_timeouts_holds_a_lost_ping_every_two_seconds(tmp_path: Path) -> None:
    changes = {10: {"network_delay": "40.5"}, 50: {"network_delay": "-1"}, 250: {"network_delay": "30"}}
    trial = load_trial(made(tmp_path / "a.csv", changes))
    found = [r for r in trial.records(Role.ROBOT) if isinstance(r, NetworkDelay)]
    assert [r.delay_ns for r in found] == [40_500_000, None, None, None, None, 30_000_000]
    assert found[0].wall_ns == T0 + 10 * 40_000_000 - 40_500_000
    assert all(r.unknown == {"delay_ns": Unknown.TIMED_OUT} for r in found[1:5])
    assert any("4 lost pings" in repair for repair in trial.repairs)


def test_sentinels_and_impossible_values_become_unknown_with_a_note(tmp_path: Path) -> None:
    signal = {"c_rssi": "-60", "c_lqi": "50", "c_rssi_status": "1"}
    changes = {
        5: {**messages(0, 5, 1), **signal, "network_delay": "-77"},
        30: {**messages(0, 9000, 1), "c_rssi": "-256", "c_lqi": "0", "c_rssi_status": "0"},
        60: {**messages(0, 6, 1), "c_rssi": "35"},
        90: {"c_rssi": "-61", "c_rssi_status": "0"},
    }
    trial = load_trial(made(tmp_path / "a.csv", changes))
    links = [r for r in trial.records(Role.ROBOT) if isinstance(r, WirelessLink)]
    assert [r.rssi_dbm for r in links] == [-60.0, None, None, -61.0]
    assert links[1].unknown["rssi_dbm"] is Unknown.NOT_CONNECTED
    moved = [r for r in trial.records(Role.ROBOT) if isinstance(r, LinkUtilization)]
    assert [r.continuity for r in moved][:3] == [Continuity.FIRST, Continuity.RESET, Continuity.STEADY]
    assert moved[1].tx_rate_bps is None
    words = " ".join(trial.repairs)
    for word in ("impossible throughput", "impossible RSSI", "contradict", "impossible values left out"):
        assert word in words


def test_counters_are_kept_raw_with_their_falls_noted(tmp_path: Path) -> None:
    changes = {i: {"c_tx_retires": str(v), "c_retransmits": "7"} for i, v in ((5, 100), (40, 130), (80, 4), (120, 9))}
    trial = load_trial(made(tmp_path / "a.csv", changes))
    found = [r for r in trial.records(Role.ROBOT) if isinstance(r, NetworkErrors)]
    assert [r.mac_tx_retries for r in found] == [100, 130, 4, 9]
    assert found[2].continuity is Continuity.RESET
    assert any("falls 1 times" in repair for repair in trial.repairs)


def test_an_access_point_without_readings_is_not_called_disconnected(tmp_path: Path) -> None:
    changes = {5: {**messages(0, 5, 1), "c_rssi": "-256", "c_lqi": "0", "c_rssi_status": "0"}, 40: messages(0, 6, 1)}
    trial = load_trial(made(tmp_path / "a.csv", changes))
    link = next(r for r in trial.records(Role.ROBOT) if isinstance(r, WirelessLink))
    assert link.connected is None
    assert link.unknown["rssi_dbm"] is Unknown.UNSUPPORTED


def test_missing_topics_are_missing_not_zero() -> None:
    rows = "\n".join(f"{T0 + i * 40_000_000},{12 + i % 3},-50" for i in range(30))
    ends, repairs = recover(parse_sheet(f"time_stamp,network_delay,s_rssi\n{rows}\n".encode(), "few.csv"))
    assert ends[Role.STATION].wireless["iface1"]["rssi_dbm"].tolist() == [-50.0]
    assert not ends[Role.ROBOT].utilization
    assert any("no odometry" in repair for repair in repairs)


@pytest.mark.parametrize("name", FILES)
def test_every_published_file_is_read_and_its_repairs_listed(name: str) -> None:
    trial = load_trial(dataset(name))
    rows = {"router": 8076, "client": 7486, "server": 5729, "external": 6044}
    assert len(trial.sheet.wall_ns) == next(n for key, n in rows.items() if key in name)
    assert trial.repairs
    for role in Role:
        stamps = [r.wall_ns for r in trial.records(role) if not isinstance(r, NetworkDelay)]
        assert stamps == sorted(stamps)


def test_an_import_never_overwrites_a_run(tmp_path: Path) -> None:
    trial = load_trial(made(tmp_path / "a.csv", {5: messages(0, 5, 1), 40: messages(0, 6, 1)}))
    folder = write_run(trial, tmp_path / "runs")
    assert (folder / "robot").is_dir()
    with pytest.raises(LinkRoverError, match="exists already"):
        write_run(trial, tmp_path / "runs")


def test_an_import_that_cannot_write_leaves_no_half_run(tmp_path: Path) -> None:
    trial = load_trial(made(tmp_path / "a.csv", {5: messages(0, 5, 1), 40: messages(0, 6, 1)}))
    (tmp_path / "file").write_text("")
    with pytest.raises(LinkRoverError):
        write_run(trial, tmp_path / "file")

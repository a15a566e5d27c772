"""What the agents recorded in the guest, read and reported on this machine: no cell of the paper's table is N/A."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from linkrover.bag import Recording, read_recording
from linkrover.records import (
    ChannelSurvey,
    EventKind,
    LinkEvent,
    ProbeResult,
    ProbeState,
    RadioCapability,
    ScanSnapshot,
    StationLink,
    TcpConnection,
    WirelessLink,
)

from .conftest import INSIDE, GuestSession

pytestmark = [
    pytest.mark.skipif(INSIDE, reason="runs outside the guest, on what came out of it"),
    pytest.mark.timeout(460),
]
CASES = ["robot-ap", "station-ap"]


@pytest.fixture(scope="session")
def runs(guest_session: GuestSession) -> Path:
    guest_session.boot()
    if guest_session.unavailable:
        pytest.skip(f"no guest kernel: {guest_session.unavailable}")
    assert guest_session.run is not None
    return guest_session.run.share / "runs"


@pytest.fixture(scope="session")
def recordings(runs: Path) -> dict[tuple[str, str], Recording]:
    return {(case, role): read_recording(runs / case / role) for case in CASES for role in ("robot", "station")}


@pytest.mark.parametrize("role", ["robot", "station"])
@pytest.mark.parametrize("case", CASES)
def test_every_end_knows_its_rssi_also_the_access_point(
    case: str, role: str, recordings: dict[tuple[str, str], Recording]
):
    found = recordings[case, role]
    assert found.problems == ()
    links = [one for one in found.records(WirelessLink) if one.connected]
    assert len(links) > 20
    assert {one.source for one in links} == {"nl80211"}
    access_point = case.startswith(role)
    assert {one.mode for one in links} == {"ap" if access_point else "station"}
    assert all((one.peer is not None) == access_point for one in links)
    # 0 dBm of tx power and what was set as the way's loss; -30 is before the first step.
    assert {one.rssi_dbm for one in links} >= {-42, -48, -54}
    assert {one.rssi_dbm for one in links} <= {-30, -42, -48, -54}
    stations = list(found.records(StationLink))
    assert any(one.tids for one in stations)
    assert max(one.tx_bytes or 0 for one in stations) > 0
    assert [one.driver for one in found.records(RadioCapability)][:1] == ["mac80211_hwsim"]


@pytest.mark.parametrize("case", CASES)
def test_each_tcp_connection_is_recorded_with_its_round_trip(case: str, recordings: dict[tuple[str, str], Recording]):
    found = [one for one in recordings[case, "robot"].records(TcpConnection) if one.state == "established"]
    assert found
    last = max(found, key=lambda one: one.bytes_sent or 0)
    assert last.remote.startswith("10.1.0.")
    assert last.rtt_us > 0
    assert last.bytes_sent > 100_000
    assert last.process is not None
    assert "python" in last.process or "pytest" in last.process


def test_a_disconnection_is_on_both_timelines(recordings: dict[tuple[str, str], Recording]):
    robot = list(recordings["station-ap", "robot"].records(LinkEvent))
    lost = next(one for one in robot if one.kind is EventKind.DISCONNECTED)
    back = next(one for one in robot[robot.index(lost) :] if one.kind is EventKind.ASSOCIATED)
    assert back.previous_bssid == lost.bssid == back.bssid
    assert back.gap_ns == (back.mono_ns - lost.mono_ns or None)  # None: this busy guest read both at once
    station = list(recordings["station-ap", "station"].records(LinkEvent))
    kinds = [one.kind for one in station]
    assert kinds.index(EventKind.PEER_LEFT) < len(kinds) - kinds[::-1].index(EventKind.PEER_JOINED)


@pytest.mark.parametrize("case", CASES)
def test_probes_were_answered_over_the_radio(case: str, recordings: dict[tuple[str, str], Recording]):
    probes = list(recordings[case, "robot"].records(ProbeResult))
    assert sum(one.state is ProbeState.ANSWERED for one in probes) > 20


def test_surveys_are_recorded_where_the_driver_has_them(recordings: dict[tuple[str, str], Recording]):
    found = list(recordings["station-ap", "robot"].records(ChannelSurvey))
    assert all(one.noise_dbm == -92 for one in found)


@pytest.mark.parametrize("case", CASES)
def test_the_report_has_a_signal_for_both_ends(case: str, runs: Path):
    done = subprocess.run(
        [sys.executable, "-m", "linkrover", "report", str(runs / case), "--format", "json"],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    ends = json.loads(done.stdout)[0]["ends"]
    for role in ("robot", "station"):
        (interface,) = ends[role]["interfaces"].values()
        assert -54 <= interface["rssi_dbm"]["mean"] <= -42
        assert interface["rssi_dbm"]["reason"] is None


def test_scans_that_were_asked_for_are_recorded_as_such(recordings: dict[tuple[str, str], Recording]):
    robot = recordings["station-ap", "robot"]
    found = [one for one in robot.records(ScanSnapshot) if one.triggered]
    assert found
    assert {"on the robot", "on the station"} <= {near.ssid for one in found for near in one.neighbours}
    events = [one for one in robot.records(LinkEvent) if one.kind is EventKind.SCAN]
    assert any("begun by this agent" in one.detail for one in events)
    assert not list(recordings["robot-ap", "robot"].records(ScanSnapshot))

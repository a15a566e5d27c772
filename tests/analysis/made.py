"""Small runs with known figures, recorded by the real recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from linkrover.bag import Recorder
from linkrover.records import (
    ClockOffset,
    Continuity,
    LinkUtilization,
    Manifest,
    NetworkErrors,
    Pose,
    ProbeResult,
    ProbeState,
    Role,
    WirelessLink,
)

T0 = 1_790_000_000_000_000_000
SECOND = 1_000_000_000


def manifest(role: Role, **changes: Any) -> Manifest:
    values: dict[str, Any] = {
        "wall_ns": T0, "mono_ns": 5 * SECOND, "linkrover_version": "0", "role": role, "host": role.value,
        "kernel": "6.1", "machine": "x86_64", "python": "3.11", "case": "robot-ap-internal-5", "trial": 1,
    }  # fmt: skip
    return Manifest(**(values | changes))


def record_run(
    folder: Path,
    *,
    seconds: int = 60,
    ends: tuple[Role, ...] = (Role.ROBOT, Role.STATION),
    station_offset_ns: int = 0,
    station_late_s: float = 0.0,
    out: tuple[float, float] = (20.0, 26.0),
    rtt_ms: float = 10.0,
    rate_mbps: float = 8.0,
    pose: bool = True,
    probe: bool = True,
    offset: bool = True,
    **changes: Any,
) -> Path:
    """Robot drives away at 0.5 m/s from 10 s on; probes at 10 Hz, none answered while `out`."""
    for role in ends:
        shift = station_offset_ns + int(station_late_s * SECOND) if role is Role.STATION else 0
        with Recorder(folder / role.value, manifest(role, **changes), compatible=False) as recorder:
            sent = 0
            for tenth in range(seconds * 10 + 1):
                t = tenth / 10
                ns = tenth * SECOND // 10
                at: dict[str, Any] = {"wall_ns": T0 + ns + shift, "mono_ns": 5 * SECOND + ns}
                x = max(0.0, t - 10) * 0.5
                recorder.take(
                    WirelessLink(**at, iface="wlan0", source="nl80211", connected=True, rssi_dbm=-40.0 - round(x))
                )
                if tenth % 10 == 0:
                    word = Continuity.FIRST if tenth == 0 else Continuity.STEADY
                    moved = {"tx_bytes": sent, "rx_bytes": sent // 20}
                    recorder.take(LinkUtilization(**at, iface="wlan0", continuity=word, **moved))
                    recorder.take(NetworkErrors(**at, iface="wlan0", tcp_retransmits=1000 + tenth // 10))
                    if not out[0] <= t < out[1]:
                        sent += int(rate_mbps * 125_000)
                    if role is Role.ROBOT and offset:
                        bound = {"offset_ns": station_offset_ns, "error_bound_ns": 150_000}
                        recorder.take(ClockOffset(**at, peer="station", **bound))
                if role is not Role.ROBOT:
                    continue
                if pose:
                    speed = 0.5 if t > 10 else 0.0
                    recorder.take(
                        Pose(**at, x_m=x, y_m=0.0, heading_rad=0.0, forward_m_per_s=speed, turn_rad_per_s=0.0)
                    )
                if probe:
                    lost = out[0] <= t < out[1]
                    result = probe_result(at, tenth, rtt_ms, lost=lost, offset_ns=station_offset_ns)
                    if lost:  # as an agent does: superseded when the direction becomes known
                        recorder.take(msgspec.structs.replace(result, state=ProbeState.LOST))
                    recorder.take(result)
    return folder


def probe_result(at: dict[str, Any], sequence: int, rtt_ms: float, *, lost: bool, offset_ns: int) -> ProbeResult:
    same = {"peer": "station", "session": 1, "sequence": sequence, "t1_ns": at["wall_ns"]}
    if lost:
        return ProbeResult(**at, **same, state=ProbeState.LOST_FORWARD)
    rtt = int((rtt_ms + sequence % 3) * 1e6)
    there = at["wall_ns"] + rtt // 4 + offset_ns
    return ProbeResult(
        **at, **same, state=ProbeState.ANSWERED, rtt_ns=rtt, t2_ns=there, t3_ns=there, t4_ns=at["wall_ns"] + rtt
    )

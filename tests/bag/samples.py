"""A small recording of every kind of record, and what a reader should find in it."""

from __future__ import annotations

from pathlib import Path

from linkrover.bag import Recorder
from linkrover.records import (
    Bitrate,
    Continuity,
    Interface,
    LinkUtilization,
    Manifest,
    NetworkDelay,
    NetworkErrors,
    Pose,
    ProbeResult,
    ProbeState,
    Record,
    Role,
    Unknown,
    VelocityCommand,
    WirelessLink,
)

T0 = 1_700_000_000_000_000_000


def manifest(role: Role = Role.ROBOT) -> Manifest:
    return Manifest(
        wall_ns=T0,
        mono_ns=1,
        linkrover_version="0.1.0",
        role=role,
        host="rover",
        kernel="6.1",
        machine="aarch64",
        python="3.11",
        interfaces=(Interface(name="wlan0", driver="ath9k"),),
        sysctls={"net.ipv4.ipfrag_time": "30"},
        case="router 2.4",
        trial=2,
        run="r1",
    )


def record_number(n: int) -> list[Record]:
    """What happens in the n-th tenth of a second."""
    at = {"wall_ns": T0 + n * 100_000_000, "mono_ns": n * 100_000_000}
    lost = n % 7 == 3
    found: list[Record] = [
        WirelessLink(
            **at,
            iface="wlan0",
            source="nl80211",
            connected=not lost,
            ssid=None if lost else "lab",
            rssi_dbm=None if lost else -40.0 - n % 13,
            tx_bitrate=None if lost else Bitrate(rate_bps=65_000_000, mode="ht", mcs=7),
            unknown={"rssi_dbm": Unknown.NOT_CONNECTED, "ssid": Unknown.NOT_CONNECTED} if lost else {},
        ),
        ProbeResult(
            **at,
            peer="10.0.0.2",
            session=1,
            sequence=n,
            state=ProbeState.LOST if lost else ProbeState.ANSWERED,
            rtt_ns=None if lost else 1_000_000 + n,
        ),
        Pose(**at, x_m=0.1 * n, y_m=-0.2 * n, heading_rad=0.01 * n, forward_m_per_s=0.5, turn_rad_per_s=0.0),
    ]
    if n % 10 == 0:
        found += [
            LinkUtilization(
                **at,
                iface="wlan0",
                continuity=Continuity.STEADY if n else Continuity.FIRST,
                interval_ns=1_000_000_000 if n else None,
                rx_bytes=1000 * n,
                tx_bytes=20_000 * n,
                tx_rate_bps=160e3 if n else None,
            ),
            NetworkErrors(**at, iface="wlan0", tcp_retransmits=n, mac_tx_retries=3 * n),
            NetworkDelay(
                **at,
                iface="wlan0",
                peer="station",
                method="ros1 action",
                sequence=n,
                delay_ns=None if lost else 2_500_000,
            ),
            VelocityCommand(**at, forward_m_per_s=0.5, turn_rad_per_s=-0.1),
        ]
    return found


def record_all(directory: Path, tenths: int = 100, role: Role = Role.ROBOT) -> list[Record]:
    """Record so many tenths of a second into `directory`; what was recorded."""
    recorder = Recorder(directory, manifest(role))
    found: list[Record] = [manifest(role)]
    for n in range(tenths):
        for record in record_number(n):
            recorder.take(record)
            found.append(record)
    recorder.close()
    assert recorder.problem is None
    assert recorder.records_lost == 0
    return found

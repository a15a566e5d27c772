"""A run of 20 s in which everything a report can show is known: two robots on one access point, topics, neighbours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from linkrover.bag import Recorder
from linkrover.records import (
    Bitrate,
    ChannelSurvey,
    Continuity,
    Interface,
    LinkUtilization,
    Neighbour,
    Overlap,
    Role,
    ScanSnapshot,
    SelfAccount,
    StationLink,
    TcpConnection,
    TopicTraffic,
)

from .made import SECOND, T0, manifest

ROBOT_MAC, OTHER_MAC, AP_MAC = "02:00:00:00:00:01", "02:00:00:00:00:02", "02:00:00:00:00:aa"
CAMERA = ("10.0.0.2:40000", "10.0.0.1:50000")
INSIDE = ("10.0.0.2:40001", "10.0.0.2:50001")
SECONDS = 20


def at(second: float) -> dict[str, Any]:
    ns = round(second * SECOND)
    return {"wall_ns": T0 + ns, "mono_ns": 5 * SECOND + ns}


def record_detailed(folder: Path, *, roscore: str = "10.0.0.2") -> Path:
    robot = Interface(name="wlan0", mac=ROBOT_MAC, addresses=("10.0.0.2",))
    station = Interface(name="wlan1", mac=AP_MAC, addresses=("10.0.0.1",))
    words = f"ros1 noetic http://{roscore}:11311 /linkrover"
    with Recorder(
        folder / "robot", manifest(Role.ROBOT, interfaces=(robot,), middleware=words), compatible=False
    ) as sink:
        for second in range(SECONDS + 1):
            _robot(sink, second)
    with Recorder(
        folder / "station", manifest(Role.STATION, interfaces=(station,), middleware=words), compatible=False
    ) as sink:
        for tenth in range(SECONDS * 10 + 1):
            _station(sink, tenth)
    return folder


def _bytes(sink: Recorder, second: int, iface: str, sent: int, received: int) -> None:
    word = Continuity.FIRST if second == 0 else Continuity.STEADY
    sink.take(LinkUtilization(**at(second), iface=iface, continuity=word, tx_bytes=sent, rx_bytes=received))


def _robot(sink: Recorder, second: int) -> None:
    _bytes(sink, second, "wlan0", 1_250_000 * second, 12_500 * second)
    busy = 900 * second // 3
    sink.take(
        ChannelSurvey(
            **at(second), iface="wlan0", frequency_mhz=2437, in_use=True, noise_dbm=-92.0 + second % 2,
            active_ms=900 * second, busy_ms=busy, rx_ms=busy // 3, tx_ms=busy // 6,
        )
    )  # fmt: skip
    if second % 10 == 5:
        sink.take(_scan(second))
    if second > 0:  # the camera's connection begins after the first look
        sink.take(_connection(second, CAMERA, sent=1_000_000 * second, again=3 * second))
        sink.take(_connection(second, INSIDE, sent=9_000_000 * second, again=0))
        for topic, (local, remote), peer in (("/camera", CAMERA, "/view"), ("/inside", INSIDE, "/near")):
            each = 1_000_000 if topic == "/camera" else 9_000_000
            sink.take(
                TopicTraffic(
                    **at(second), topic=topic, node="/driver", peer=peer, direction="out", local=local, remote=remote,
                    bytes_total=each * second, messages_total=10 * second, rate_bps=each * 8.0,
                )
            )  # fmt: skip
    late = {"lateness_median_ns": 200_000, "lateness_max_ns": 4_000_000 if second == 7 else 900_000}
    sink.take(
        SelfAccount(
            **at(second), **late, interval_ns=SECOND, cpu_ns=SECOND // 50, rss_bytes=30_000_000, samples=19,
            missed_slots=1, records_written=100 * second, records_lost=2 if second > 10 else 0, bytes_written=1000,
        )
    )  # fmt: skip


def _connection(second: int, place: tuple[str, str], *, sent: int, again: int) -> TcpConnection:
    return TcpConnection(
        **at(second), iface="wlan0", local=place[0], remote=place[1], state="established", process="camera[77]",
        rtt_us=20_000 + 1000 * second, min_rtt_us=2000, retransmits=again, congestion_window=30,
        congestion_control="cubic", bytes_sent=sent, bytes_acked=sent - 5000, bytes_received=0,
        bytes_retransmitted=again * 1448, busy_us=500_000 * second, receive_window_limited_us=50_000 * second,
        send_buffer_limited_us=0,
    )  # fmt: skip


def _scan(second: int) -> ScanSnapshot:
    def near(last: int, mhz: int, rssi: float, overlap: Overlap, **more: Any) -> Neighbour:
        return Neighbour(
            bssid=f"04:00:00:00:00:{last:02x}", ssid=f"net{last}", frequency_mhz=mhz, rssi_dbm=rssi, overlap=overlap,
            **more,
        )  # fmt: skip

    found = (
        Neighbour(bssid=AP_MAC, ssid="ours", frequency_mhz=2437, rssi_dbm=-40.0, associated=True,
                  overlap=Overlap.CO_CHANNEL),
        near(1, 2437, -60.0, Overlap.CO_CHANNEL, load_utilization=0.5, load_stations=7),
        near(2, 2437, -90.0, Overlap.CO_CHANNEL),
        near(3, 2447, -70.0 - second, Overlap.ADJACENT),
        near(4, 5180, -50.0, Overlap.NONE),
    )  # fmt: skip
    return ScanSnapshot(
        **at(second), iface="wlan0", frequency_mhz=2437, width_mhz=20, duration_ns=SECOND // 2, triggered=True,
        neighbours=found, co_channel=2, adjacent=1,
    )  # fmt: skip


def _station(sink: Recorder, tenth: int) -> None:
    """Robot 1 is heard at -50 dBm with MCS 7, the other one at -70 dBm with MCS 1 and associates anew after 10 s."""
    second = tenth / 10
    if tenth % 10 == 0:
        _bytes(sink, tenth // 10, "wlan1", 12_500 * (tenth // 10), 1_240_000 * (tenth // 10))
    sink.take(_peer(second, ROBOT_MAC, -50.0, 7, frames=100 * tenth, retries=10 * tenth, connected_s=100 + tenth // 10))
    since = tenth if tenth <= 100 else tenth - 101
    sink.take(_peer(second, OTHER_MAC, -70.0, 1, frames=20 * since, retries=10 * since, connected_s=since // 10))


def _peer(
    second: float, peer: str, rssi: float, mcs: int, *, frames: int, retries: int, connected_s: int
) -> StationLink:
    rate = Bitrate(rate_bps=(mcs + 1) * 6_500_000, mode="ht", mcs=mcs, nss=1, width_mhz=20)
    return StationLink(
        **at(second), iface="wlan1", peer=peer, rssi_dbm=rssi, inactive_ms=20, tx_bitrate=rate, rx_bitrate=rate,
        tx_packets=frames, tx_retries=retries, tx_failed=0, tx_bytes=1000 * frames, rx_bytes=500 * frames,
        connected_s=connected_s,
    )  # fmt: skip

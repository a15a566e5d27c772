"""Whatever an end recorded, and however little: figures or a word on why there are none, never a crash."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.analysis import summarise
from linkrover.analysis.columns import from_records
from linkrover.analysis.load import build_run
from linkrover.analysis.regression import METRICS, compare_runs, parse_limit
from linkrover.analysis.space import cell_figures, dead_zones, link_budget, locate_anchor
from linkrover.errors import LinkRoverError
from linkrover.records import (
    Bitrate,
    ChannelSurvey,
    ClockOffset,
    Continuity,
    LinkUtilization,
    Neighbour,
    NetworkDelay,
    NetworkErrors,
    Overlap,
    Pose,
    ProbeResult,
    ProbeState,
    Record,
    ScanSnapshot,
    SelfAccount,
    StationLink,
    TcpConnection,
    TopicTraffic,
    VelocityCommand,
    WirelessLink,
)
from linkrover.report.document import as_latex, as_markdown, build_document
from linkrover.report.views import view_of

T0 = 1_790_000_000_000_000_000


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(st.none(), strategy)


COUNT = maybe(st.integers(0, 2**40))
SMALL = st.floats(-100, 100, allow_nan=False)
AT = st.integers(0, 400).map(lambda n: {"wall_ns": T0 + n * 50_000_000, "mono_ns": 10**9 + n * 50_000_000})
IFACE = st.sampled_from(["wlan0", "wlan1"])
PEER = st.sampled_from(["a", "b"])
PLACE = st.sampled_from(["10.0.0.1:1", "10.0.0.2:2", "[::1]:3", "nonsense", ""])
NEIGHBOUR = st.builds(
    Neighbour,
    bssid=PEER,
    frequency_mhz=st.sampled_from([2437, 5180]),
    rssi_dbm=maybe(SMALL),
    overlap=maybe(st.sampled_from(Overlap)),
    associated=st.booleans(),
    load_utilization=maybe(st.floats(0, 1)),
)


def records() -> st.SearchStrategy[Record]:
    def of(kind: type[Record], **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Record]:
        return st.builds(lambda at, values: kind(**at, **values), AT, st.fixed_dictionaries(fields))

    nanoseconds = maybe(st.integers(T0, T0 + 10**12))
    return st.one_of(
        of(LinkUtilization, iface=IFACE, continuity=st.sampled_from(Continuity), rx_bytes=COUNT, tx_bytes=COUNT),
        of(NetworkErrors, iface=IFACE, tcp_retransmits=COUNT, mac_tx_retries=COUNT),
        of(WirelessLink, iface=IFACE, source=st.sampled_from(["wext", "nl80211"]), connected=maybe(st.booleans()),
           rssi_dbm=maybe(SMALL), peer=maybe(st.sampled_from(["a", "b"])), inactive_ms=maybe(st.integers(0, 9999))),
        of(ProbeResult, peer=st.sampled_from(["p", "q"]), session=st.integers(0, 2), sequence=st.integers(0, 99),
           state=st.sampled_from(ProbeState), rtt_ns=maybe(st.integers(0, 10**10)), t1_ns=nanoseconds,
           t2_ns=nanoseconds, t3_ns=nanoseconds, t4_ns=nanoseconds),
        of(NetworkDelay, iface=st.just(""), peer=st.just("p"), method=st.sampled_from(["ros1 action", "stamp"]),
           delay_ns=maybe(st.integers(0, 10**10))),
        of(ClockOffset, peer=st.just("p"), offset_ns=st.integers(-(10**9), 10**9),
           error_bound_ns=st.integers(0, 10**8)),
        of(Pose, x_m=SMALL, y_m=SMALL, heading_rad=SMALL, forward_m_per_s=maybe(SMALL), turn_rad_per_s=maybe(SMALL)),
        of(VelocityCommand, forward_m_per_s=SMALL, turn_rad_per_s=SMALL),
        of(StationLink, iface=IFACE, peer=PEER, rssi_dbm=maybe(SMALL), tx_packets=COUNT, tx_retries=COUNT,
           inactive_ms=maybe(st.integers(0, 9999)), connected_s=maybe(st.integers(0, 99)),
           tx_bitrate=maybe(st.builds(Bitrate, rate_bps=COUNT, mcs=maybe(st.integers(0, 15))))),
        of(ChannelSurvey, iface=IFACE, frequency_mhz=st.sampled_from([2437, 5180, 1]), in_use=st.booleans(),
           noise_dbm=maybe(SMALL), active_ms=COUNT, busy_ms=COUNT, rx_ms=COUNT, utilization=maybe(st.floats(0, 1))),
        of(TcpConnection, iface=IFACE, local=PLACE, remote=PLACE, state=st.just("established"), rtt_us=COUNT,
           process=maybe(st.just("p[1]")), retransmits=COUNT, bytes_sent=COUNT, bytes_acked=COUNT, busy_us=COUNT,
           bytes_retransmitted=COUNT, receive_window_limited_us=COUNT),
        of(TopicTraffic, topic=st.sampled_from(["/a", "/b"]), node=st.just("/n"), peer=PEER, local=maybe(PLACE),
           direction=st.sampled_from(["in", "out"]), remote=maybe(PLACE), bytes_total=COUNT, messages_total=COUNT),
        of(SelfAccount, interval_ns=st.integers(0, 10**10), cpu_ns=st.integers(0, 10**10), rss_bytes=st.just(1),
           lateness_median_ns=COUNT, missed_slots=st.integers(0, 9), samples=st.integers(0, 9)),
        of(ScanSnapshot, iface=IFACE, frequency_mhz=maybe(st.just(2437)), duration_ns=COUNT,
           neighbours=st.lists(NEIGHBOUR, max_size=3).map(tuple)),
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(st.lists(records(), max_size=40), st.lists(records(), max_size=30), st.booleans())
def test_any_records_give_a_report_or_a_clear_error(
    robot: Sequence[Record], station: Sequence[Record], published: bool
) -> None:
    raws = {role: from_records(found) for role, found in (("robot", robot), ("station", station)) if found}
    for raw in raws.values():
        raw.published_2021 = published
    try:
        run = build_run("made", "made", raws, [])
    except LinkRoverError:
        assert not [r for r in (*robot, *station) if not isinstance(r, ScanSnapshot)]  # scans alone are no samples
        return
    summaries = [summarise(run, method) for method in ("linkrover", "pandey2022")]
    for summary in summaries:
        assert b"NaN" not in msgspec.json.encode(summary)
        view_of(run, summary)
        document = build_document([summary, summary], [run, run], ["camera: 3 Mbit/s, commands: p99 below 9 ms"])
        assert as_markdown(document)
        assert as_latex(document)
    percent = summaries[0].delay_ms.loss_percent
    assert percent is None or 0 <= percent <= 100
    assert all(cell.seconds > 0 for cell in cell_figures(run))
    dead_zones(run)
    locate_anchor(run)
    link_budget(run)
    for verdict in compare_runs(run, run, [parse_limit(f"{name} > +10") for name in METRICS]):
        assert not verdict.broken

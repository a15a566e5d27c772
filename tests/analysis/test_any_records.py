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
    ClockOffset,
    Continuity,
    LinkUtilization,
    NetworkDelay,
    NetworkErrors,
    Pose,
    ProbeResult,
    ProbeState,
    Record,
    VelocityCommand,
    WirelessLink,
)
from linkrover.report.document import as_latex, as_markdown, build_document

T0 = 1_790_000_000_000_000_000


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.one_of(st.none(), strategy)


COUNT = maybe(st.integers(0, 2**40))
SMALL = st.floats(-100, 100, allow_nan=False)
AT = st.integers(0, 400).map(lambda n: {"wall_ns": T0 + n * 50_000_000, "mono_ns": 10**9 + n * 50_000_000})
IFACE = st.sampled_from(["wlan0", "wlan1"])


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
        assert not robot
        assert not station
        return
    summaries = [summarise(run, method) for method in ("linkrover", "pandey2022")]
    for summary in summaries:
        msgspec.json.encode(summary)
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

from __future__ import annotations

import msgspec
import pytest

from linkrover.emulator.agreement import compare
from linkrover.records import LinkTruth, LinkUtilization, ProbeResult, ProbeState, ProbeTruth, Role, WirelessLink

SECOND = 1_000_000_000
STEP = 20_000_000


def truth(seconds=10, rate_bps=10e6, rssi=lambda t: -60.0, behind=False):
    records = []
    for tick in range(int(seconds * 50) + 1):
        at = tick * STEP
        octets = int(rate_bps / 8 * at / 1e9)
        for hop, count in (("robot>station", octets), ("station>robot", octets // 100)):
            records.append(
                LinkTruth(wall_ns=at, mono_ns=at, hop=hop, interval_ns=STEP, distance_m=1.0, rssi_dbm=rssi(at),
                          offered_bytes=count, delivered_bytes=count, behind=behind,
                          release_error_median_ns=100_000, release_error_max_ns=2_000_000)
            )  # fmt: skip
    return records


def utilization(seconds=10, rate_bps=10e6, end="robot"):
    share = (1, 100) if end == "robot" else (100, 1)
    return [
        LinkUtilization(wall_ns=at, mono_ns=at, iface="wlan0", tx_bytes=5000 + octets // share[0],
                        rx_bytes=octets // share[1])
        for at, octets in ((s * SECOND // 2 + 7_000_001, int(rate_bps / 8 * (s / 2 + 0.007000001)))
                           for s in range(int(seconds * 2)))
    ]  # fmt: skip


def probes(states, rtt_ns=30_000_000):
    return [
        ProbeResult(wall_ns=i * 100_000_000, mono_ns=i, peer="s", session=1, sequence=i, state=state,
                    rtt_ns=rtt_ns if state is ProbeState.ANSWERED else None)
        for i, state in enumerate(states)
    ]  # fmt: skip


def probe_truths(drops, delay_ns=15_000_000):
    found = []
    for i, dropped in enumerate(drops):
        base = {"wall_ns": i, "mono_ns": i, "session": 1, "sequence": i, "end": Role.ROBOT}
        found.append(
            ProbeTruth(**base, direction="forward", delay_ns=None if dropped else delay_ns, dropped=dropped or None)
        )
        if not dropped:
            found.append(ProbeTruth(**base, direction="back", delay_ns=delay_ns))
    return found


def named(agreement, what):
    return next(figure for figure in agreement.figures if figure.what == what)


def test_what_is_equal_agrees():
    states = [ProbeState.ANSWERED] * 95 + [ProbeState.LOST_FORWARD] * 5
    robot = [
        *utilization(), *probes(states),
        *(WirelessLink(wall_ns=t, mono_ns=t, iface="w", source="wext", rssi_dbm=-60.0) for t in range(0, SECOND, STEP)),
    ]  # fmt: skip
    result = compare(
        {"robot": robot, "station": utilization(end="station")},
        [*truth(), *probe_truths([""] * 95 + ["retries"] * 5)],
    )
    assert result.agrees
    assert named(result, "robot sends").measured == pytest.approx(10, rel=0.001)
    assert named(result, "probes lost").true == 5
    assert named(result, "median round trip").true == 30
    assert named(result, "RSSI at robot").samples == 50
    assert named(result, "RSSI at station").agrees is None
    assert result.release_error_max_ms == 2


def test_two_per_cent_too_much_throughput_differs():
    result = compare({"robot": utilization(rate_bps=10.2e6)}, truth())
    assert named(result, "robot sends").agrees is False
    assert named(result, "robot sends").difference == pytest.approx(2, abs=0.05)
    assert not result.agrees


def test_a_tenth_of_a_millisecond_agrees_and_one_does_not():
    for rtt_ns, agrees in ((30_100_000, True), (31_000_000, False)):
        result = compare({"robot": probes([ProbeState.ANSWERED] * 20, rtt_ns)}, probe_truths([""] * 20))
        assert named(result, "median round trip").agrees is agrees


def test_a_loss_the_link_did_not_cause_differs():
    states = [ProbeState.ANSWERED] * 99 + [ProbeState.LOST]
    result = compare({"robot": probes(states)}, probe_truths([""] * 100))
    assert named(result, "probes lost").agrees is False


def test_a_probe_that_travelled_longer_than_its_deadline_is_truly_lost():
    result = compare({"robot": probes([ProbeState.LATE])}, probe_truths([""], delay_ns=1_100_000_000))
    assert named(result, "probes lost").true == 100
    assert named(result, "probes lost").agrees


def test_a_later_record_of_a_probe_supersedes_the_earlier():
    results = [*probes([ProbeState.LOST]), *probes([ProbeState.LATE]), *probes([ProbeState.ANSWERED])]
    assert named(compare({"robot": results}, probe_truths([""])), "probes lost").measured == 0


def test_probes_that_never_reached_the_link_are_said_and_not_judged():
    result = compare({"robot": probes([ProbeState.ANSWERED, ProbeState.LOST])}, probe_truths([""]))
    assert named(result, "probes lost").samples == 1
    assert "1 probes never reached" in named(result, "probes lost").note


def test_one_sample_of_rssi_that_the_driver_never_showed_differs():
    robot = [
        WirelessLink(wall_ns=t, mono_ns=t, iface="wlan0", source="wext", rssi_dbm=-60.0 if t else -61.0)
        for t in range(0, SECOND, STEP)
    ]
    assert named(compare({"robot": robot}, truth()), "RSSI at robot").difference == 1


def test_near_a_change_of_the_drivers_text_either_level_is_right():
    def levels(t):
        return -60.0 if t < 5 * SECOND else -70.0

    for offset, rssi, wrong in (
        (-40_000_000, -70.0, 0),  # stamped before, read after the change
        (-80_000_000, -70.0, 1),
        (5_000_000, -60.0, 0),  # the new level was not yet written
        (20_000_000, -60.0, 1),
        (20_000_000, -65.0, 1),
    ):
        at = 5 * SECOND + offset
        robot = [WirelessLink(wall_ns=at, mono_ns=at, iface="wlan0", source="wext", rssi_dbm=rssi)]
        assert named(compare({"robot": robot}, truth(rssi=levels)), "RSSI at robot").difference == wrong


def test_a_router_in_the_middle_belongs_to_neither_end():
    middle = []
    for record in truth():
        sender, _, receiver = record.hop.partition(">")
        middle += [msgspec.structs.replace(record, hop=hop) for hop in (f"{sender}>router", f"router>{receiver}")]
    result = compare({"robot": utilization(), "station": utilization(end="station")}, middle)
    assert result.agrees
    assert sum(figure.agrees is True for figure in result.figures) == 4


def test_nothing_to_compare_is_no_agreement():
    assert not compare({"robot": []}, truth()).agrees
    assert not compare({"robot": utilization()}, []).agrees


def test_the_share_of_time_behind_is_told():
    assert compare({"robot": utilization()}, truth(behind=True)).behind == 1

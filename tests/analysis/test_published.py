"""The published trials: the paper's formulas to the last digit, ours within the stated tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest

from linkrover.analysis import RunSummary, load_run, summarise
from linkrover.analysis.summary import InterfaceFigures, PartFigures
from linkrover.importer.trial import load_trial
from linkrover.importer.write import write_run
from linkrover.report.table import truncated
from linkrover.report.tables import still_part, table_three, table_two
from tests.datasets import FILES, dataset, expected

REL = 1e-6


@pytest.fixture(scope="module", params=["csv", "recording"])
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A file's run: straight from the file, or by way of the recordings `linkrover import` writes."""
    if request.param == "csv":
        return cache(lambda name: load_run(dataset(name)))
    out = tmp_path_factory.mktemp("runs")
    return cache(lambda name: load_run(write_run(load_trial(dataset(name)), out)))


def interface(summary: RunSummary | PartFigures, role: str, suffix: str) -> InterfaceFigures | None:
    return summary.ends[role].interfaces.get("iface2" if suffix else "iface1")


def figures(summary: RunSummary) -> Iterator[tuple[str, float | None]]:
    """Every figure of the paper's tables by the name it has in expected.json."""
    for role, end in (("robot", "c"), ("station", "s")):
        for suffix in ("", "2"):
            found = interface(summary, role, suffix)
            for key in ("tx_", "rx_", ""):
                for word in ("avg", "std"):
                    field = f"{key}{'mean' if word == 'avg' else 'std'}"
                    value = getattr(found.throughput_mbps, field) if found else None
                    yield f"{word}_{end}_total_{key}mbps{suffix}", value
            for name, group in (("rssi", "rssi_dbm"), ("lqi", "link_quality")):
                yield f"avg_{end}_{name}{suffix}", getattr(found, group).mean if found else None
                yield f"std_{end}_{name}{suffix}", getattr(found, group).std if found else None
            if end == "c" and suffix:
                continue
            for name, total, spread in (
                ("retransmits", "retransmits", "retransmits"),
                ("tx_retires", "mac_retries", "mac_retries"),
            ):
                yield f"sum_{end}_{name}{suffix}", getattr(found, total) if found else 0.0
                yield f"avg_{end}_{name}{suffix}", found.spread[spread].mean if found else None
                yield f"std_{end}_{name}{suffix}", found.spread[spread].std if found else None
    yield "avg_network_delay", summary.delay_ms.mean
    yield "std_network_delay", summary.delay_ms.std
    yield "pct_loss_authors", summary.delay_ms.loss_percent
    yield "pct_loss_allrows", summary.delay_ms.time_out_percent


@pytest.mark.parametrize("name", FILES)
def test_the_papers_method_reproduces_every_published_figure(source: Any, name: str) -> None:
    wanted = expected()["trials"][name]["authors"]
    got = dict(figures(summarise(source(name), "pandey2022")))
    assert set(got) == set(wanted)
    for key, value in wanted.items():
        if value is None:
            assert got[key] is None, key
        else:
            assert got[key] == pytest.approx(value, rel=REL, abs=1e-12), key


@pytest.mark.parametrize("name", FILES)
def test_the_papers_static_figures_are_reproduced(source: Any, name: str) -> None:
    summary = summarise(source(name), "pandey2022")
    primary = summary.ends["robot"].primary
    assert primary is not None
    assert summary.static_no_lead is not None
    for key, part in (("authors_static", summary.static), ("authors_static_no_lead", summary.static_no_lead)):
        wanted = expected()["trials"][name][key]
        throughput = part.ends["robot"].interfaces[primary].throughput_mbps
        got = (throughput.mean, throughput.std, part.delay_ms.mean, part.delay_ms.std)
        assert got == pytest.approx([wanted[k] for k in ("thr_mean", "thr_sd", "delay_mean", "delay_sd")], rel=REL)


@pytest.mark.parametrize("name", [n for n in FILES if "router" in n or "external" in n])
def test_the_printed_cells_come_out_after_truncation(source: Any, name: str) -> None:
    wanted = expected()["trials"][name]
    summary = summarise(source(name), "pandey2022")
    two, three = table_two([summary]), table_three([summary])
    keys = ("thrM", "thrS", "delM", "delS", "loss", "rssiR_M", "rssiR_S", "rssiS_M", "rssiS_S", "retr")
    printed = [float(two.text(0, j + 1)) for j in range(len(keys))]
    assert printed == [float(wanted["paper_table2"][k]) for k in keys]
    assert [float(three.text(0, j)) for j in range(1, 5)] == wanted["paper_table3"]


def test_cases_2_and_3_leave_the_first_standstill_out(source: Any) -> None:
    summary = summarise(source("internal_client_2G_trial2.csv"), "pandey2022")
    assert still_part(summary) is summary.static_no_lead


@pytest.mark.parametrize("name", FILES)
def test_our_method_meets_the_corrected_figures(source: Any, name: str) -> None:
    wanted = expected()["trials"][name]["corrected"]
    summary = summarise(source(name))
    robot = summary.ends["robot"].interfaces[summary.ends["robot"].primary or ""]
    station = summary.ends["station"].interfaces[summary.ends["station"].primary or ""]
    throughput, delay = robot.throughput_mbps, summary.delay_ms
    assert summary.duration_s == pytest.approx(wanted["duration_s"], rel=1e-6)
    assert throughput.mean == pytest.approx(wanted["thr_all_mbps"], rel=0.02)
    assert throughput.connected_mean == pytest.approx(wanted["thr_conn_mbps"], rel=0.02)
    assert throughput.interval_s == pytest.approx(wanted["c_interval_s"], rel=0.01)
    assert throughput.samples == pytest.approx(wanted["n_thr"], rel=0.02)
    assert delay.time_out_percent == pytest.approx(wanted["pct_time_out"], abs=0.5)
    assert delay.loss_percent == pytest.approx(wanted["pct_ping_lost"], abs=3.0)
    assert delay.answered == pytest.approx(wanted["n_delay_ok"], rel=0.02)
    assert len(summary.outages) == wanted["n_outages"]
    assert delay.mean == pytest.approx(wanted["delay_ok_mean_ms"], rel=0.02)
    assert delay.median == pytest.approx(wanted["delay_ok_median_ms"], rel=0.03)
    assert delay.censored_mean == pytest.approx(wanted["delay_cens_mean_ms"], rel=0.03)
    assert robot.retransmits == pytest.approx(wanted["retransmits_robot"], rel=0.02)
    if wanted["retransmits_station"] is None:
        assert station.retransmits is None
        assert "two publishers" in (station.reason or "")
    else:
        assert station.retransmits == pytest.approx(wanted["retransmits_station"], rel=0.02)
    assert summary.motion.static_percent == pytest.approx(wanted["static_share_pct"], abs=0.5)
    for got, point, interval in (
        (throughput.mean_ci95, throughput.mean, wanted["thr_all_ci"]),
        (delay.mean_ci95, delay.mean, wanted["delay_ok_mean_ci"]),
        (delay.median_ci95, delay.median, wanted["delay_ok_median_ci"]),
    ):
        check_interval(got, point, interval)
    for key, figures_ in (("c", robot), ("s", station)):
        signal = wanted["rssi"].get(key)
        if signal is None:
            assert figures_.rssi_dbm.mean is None
            assert figures_.rssi_dbm.reason
            continue
        assert figures_.rssi_dbm.mean == pytest.approx(signal["mean"], abs=0.5)
        assert figures_.rssi_dbm.std == pytest.approx(signal["sd"], abs=0.5)
        assert figures_.rssi_dbm.stale_percent == pytest.approx(signal["pct_stale"], abs=1.0)
        check_interval(figures_.rssi_dbm.mean_ci95, figures_.rssi_dbm.mean, signal["ci"])


def check_interval(got: tuple[float, float] | None, point: float | None, wanted: list[float]) -> None:
    assert got is not None
    assert point is not None
    assert got[0] <= point <= got[1]
    assert 0.5 <= (got[1] - got[0]) / (wanted[1] - wanted[0]) <= 2.0


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("method", ["linkrover", "pandey2022"])
def test_no_null_without_a_reason(name: str, method: str) -> None:
    import msgspec

    def check(node: Any, path: str) -> None:
        if isinstance(node, dict):
            if "reason" in node and any(v is None for k, v in node.items() if k != "reason"):
                assert node["reason"], path
            for key, value in node.items():
                if key == "recoveries":
                    continue  # a timeline: what is not there did not happen
                if value is None and key != "reason":
                    assert "reason" in node, f"{path}.{key}"
                check(value, f"{path}.{key}")
        elif isinstance(node, list):
            for i, value in enumerate(node):
                check(value, f"{path}[{i}]")

    check(msgspec.to_builtins(summarise(load_run(dataset(name)), method)), name)


def test_truncation_is_towards_zero() -> None:
    assert [truncated(v) for v in (12.89, -57.99, 0.04, 2.3)] == [12.8, -57.9, 0.0, 2.3]

"""What every format shows of the radio, the traffic and the cost."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from rich.console import Console

from linkrover.analysis import load_run, summarise
from linkrover.report.details import detail_sections
from linkrover.report.document import as_latex, as_markdown, build_document
from linkrover.report.table import Column, Table, terminal, without_unknown
from linkrover.report.tidy import tidy_csv
from linkrover.report.views import view_of, write_html
from tests.analysis.detailed import record_detailed
from tests.analysis.made import record_run
from tests.browser import Browser, chromium
from tests.datasets import dataset

ARTIFACTS = Path(__file__).parents[2] / "artifacts"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_detailed(tmp_path_factory.mktemp("detailed") / "run")


@pytest.fixture(scope="module")
def text(folder: Path) -> str:
    run = load_run(folder)
    return as_markdown(build_document([summarise(run)], [run]))


def test_the_report_says_what_disturbs(text: str) -> None:
    assert "2 other networks on the same channel, which share its airtime (strongest -60 dBm, 1 of them" in text
    assert "1 other network overlapping it without sharing it, which disturb like noise (strongest -75 dBm)" in text
    assert "announces it to be busy 50 % of the time" in text
    assert "2 of 2 scans at the robot were the agent's own, 0.50 s each" in text


def test_the_report_says_which_topic_fills_the_air_and_which_connection_retransmits(text: str) -> None:
    assert "Most of the air goes to /camera, sent by the robot to /view: 8.00 Mbit/s, 80 %" in text
    assert "Most retransmits: robot 10.0.0.2:40000 to 10.0.0.1:50000 (camera[77]): 60 segments" in text
    assert "/inside" not in text
    assert "1 flows between nodes of one machine never reach the air" in text


def test_the_report_explains_why_received_data_exceed_sent_data(text: str) -> None:
    assert "At the robot, the roscore's side, received data do not exceed sent data" in text
    assert "At the station, received data exceed sent data (wlan1: 9.92 Mbit/s received, 0.10 sent)" in text
    assert "it publishes /camera at 8.00 Mbit/s" in text
    assert "where it runs does not decide this" in text


def test_each_robot_at_the_access_point_has_a_row(text: str) -> None:
    rows = [line for line in text.splitlines() if line.startswith("| station wlan1 |")]
    assert len(rows) == 2
    assert "robot wlan0 (02:00:00:00:00:01) | -50.0" in rows[0] + rows[1]


def test_the_report_warns_of_missed_slots_and_lost_records(text: str) -> None:
    assert "missed 21 of 420 slots (5 %)" in text
    assert "lost 2 records" in text


def test_sections_appear_only_where_there_is_something_to_say(tmp_path: Path) -> None:
    plain = summarise(load_run(record_run(tmp_path / "run", seconds=12)))
    assert detail_sections(plain) == []
    run = load_run(record_detailed(tmp_path / "detailed"))
    two = build_document([summarise(run), plain], [])
    assert [s.heading.rpartition(": ")[2] for s in two.sections if "air" in s.heading] == ["on the air"]
    assert as_latex(two).count(r"\begin{tabular}") == len(two.tables)


def test_channel_utilisation_noise_and_each_peer_are_lines_over_time(folder: Path) -> None:
    run = load_run(folder)
    view = view_of(run, summarise(run))
    assert [line.name for line in view.of("channel")] == ["channel busy at the robot (wlan0, 2437 MHz)"]
    assert view.of("channel")[0].value[1:].mean() == pytest.approx(33.3, abs=0.1)
    assert len(view.of("noise")) == 1
    names = {line.name for line in view.of("rssi")}
    assert {"RSSI of robot wlan0 at the station (wlan1)", "RSSI of 02:00:00:00:00:02 at the station (wlan1)"} <= names


@pytest.mark.browser
@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
def test_the_page_shows_the_channel_row_and_all_tables_within_its_width(folder: Path, tmp_path: Path) -> None:
    run = load_run(folder)
    out = tmp_path / "report.html"
    write_html([run], [summarise(run)], out)
    with Browser() as browser:
        browser.open(out)
        browser.run("Promise.all(all.map(draw)).then(() => true)")
        titles = browser.run("document.getElementById('run0-series').textContent")
        assert "channel busy" in titles
        assert "RSSI, noise" in titles
        wide = browser.run(
            "[...document.querySelectorAll('.scroll')].filter(s => s.scrollWidth > s.clientWidth)"
            ".map(s => s.querySelector('table').id)"
        )
        assert wide == []
        browser.screenshot(ARTIFACTS / "report-details.png")
        assert browser.complaints == []


def test_every_table_fits_a_terminal_of_80_columns_and_names_what_it_left_out(folder: Path) -> None:
    for section in detail_sections(summarise(load_run(folder))):
        for table in section.tables:
            console = Console(width=80, file=io.StringIO(), record=True)
            console.print(terminal(table, 80))
            lines = console.export_text().splitlines()
            (rule,) = [line for line in lines if set(line.strip()) == {"─"}]
            assert rule.endswith(" "), table.title  # its right edge is there: nothing was cut off


def test_a_column_of_unknowns_is_left_out_and_named() -> None:
    table = Table("t", (Column("a"), Column("b"), Column("c")), [["x", None, 1], ["y", None, None]])
    small = without_unknown(table)
    assert [c.heading for c in small.columns] == ["a", "c"]
    assert small.notes == ["Not known for any row: b."]
    assert small.rows == [["x", 1], ["y", None]]


def test_the_long_csv_has_the_details_too(folder: Path) -> None:
    text = tidy_csv([summarise(load_run(folder))])
    rows = list(csv.DictReader(io.StringIO(text)))
    found = {(r["part"], r["end"], r["figure"]): float(r["value"]) for r in rows}
    assert found["stations", "station", "02:00:00:00:00:02.rssi_mean"] == pytest.approx(-70.0)
    assert found["channels", "robot", "2437 MHz.busy_percent"] == pytest.approx(33.3, abs=0.1)
    assert found["connections", "robot", "10.0.0.2:40000 > 10.0.0.1:50000.retransmits"] == 60
    assert found["topics", "robot", "/camera out /driver /view.rate_mbps"] == pytest.approx(8.0)
    assert found["account", "robot", "cpu_percent"] == pytest.approx(2.0)
    assert found["neighbourhoods", "robot", "co_channel"] == 2


def test_the_published_drives_show_where_received_data_exceed_sent_data() -> None:
    run = load_run(dataset("router_2G_trial2.csv"))
    words = [sentence for section in detail_sections(summarise(run)) for sentence in section.words]
    assert any(w.startswith("At the station, received data exceed sent data (iface1: 12.24 Mbit/s") for w in words)
    assert any("the roscore only tells them of each other" in w for w in words)

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from linkrover.analysis import load_run, summarise
from linkrover.cli.compare import compare
from linkrover.cli.import_ import import_
from linkrover.cli.report import report
from linkrover.errors import ConfigError
from linkrover.records import Role
from linkrover.report.document import as_latex, as_markdown, build_document
from linkrover.report.table import Column, Table, comma_separated, latex, markdown, terminal
from linkrover.report.tidy import tidy_csv
from tests.analysis.made import record_run
from tests.datasets import dataset


def small() -> Table:
    columns = (Column("case"), Column("Mbit/s", 1, "high"), Column("delay_ms", 2, "low"), Column("loss", 1, "low"))
    rows: list[list[str | float | int | None]] = [["1 | a_b", 12.34, 5.0, None], ["2 & 50 %", 20.0, 7.126, 3.0]]
    return Table("A & B", columns, rows, ["note <1>"], name="small")


def test_the_best_of_every_column_is_bold_and_unknown_is_never_best() -> None:
    assert small().best() == {(1, 1), (0, 2)}
    assert "**20.0**" in markdown(small())
    assert r"\textbf{5.00}" in latex(small())


def test_markdown_escapes_what_would_break_the_table() -> None:
    lines = markdown(small()).splitlines()
    assert lines[2] == "| case | Mbit/s | delay_ms | loss |"
    assert lines[4].startswith("| 1 \\| a_b | 12.3 |")
    assert "&lt;1>" in lines[-1]


def test_latex_escapes_what_would_break_the_document() -> None:
    text = latex(small())
    assert r"2 \& 50 \%" in text
    assert r"a\_b" in text
    assert text.count(r"\begin{") == text.count(r"\end{")


def test_csv_keeps_full_precision_and_leaves_the_unknown_empty() -> None:
    rows = list(csv.reader(io.StringIO(comma_separated(small()))))
    assert rows[1] == ["1 | a_b", "12.34", "5.0", ""]
    assert rows[2][2] == "7.126"


def test_a_wide_table_fits_a_narrow_terminal_by_leaving_out_spreads() -> None:
    from rich.console import Console

    columns = (Column("case"), *(c for i in range(9) for c in (Column(f"m{i}"), Column("std"))))
    table = Table("wide", columns, [["name", *[123.4] * 18]])
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(terminal(table, 80))
    text = console.export_text()
    assert text.count("123.4") >= 9
    assert "narrow" in text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("runs")
    for case in ("robot-ap-internal-5", "station-ap-internal-5"):
        for trial in (1, 2):
            rate = (8.0 if case.startswith("robot") else 12.0) + trial / 4
            record_run(base / case / f"trial{trial}", seconds=40, case=case, trial=trial, rate_mbps=rate, run=None)
    return base


def test_json_has_one_object_a_run_with_the_named_keys(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report(folder, format="json") == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found) == 4
    for item in found:
        assert {"run", "case", "trial", "duration_s", "delay_ms", "ends", "static", "moving"} <= set(item)
        for part in (item, item["moving"]):
            assert {
                "mean",
                "std",
                "median",
                "p95",
                "loss_percent",
                "time_out_percent",
                "censored_mean",
                "mean_ci95",
            } <= set(part["delay_ms"])
            for end in ("robot", "station"):
                figures = part["ends"][end]["interfaces"]["wlan0"]
                throughput = {"mean", "std", "tx_mean", "rx_mean", "connected_mean", "mean_ci95", "ess"}
                assert throughput <= set(figures["throughput_mbps"])
                assert {"mean", "std", "mean_ci95"} <= set(figures["rssi_dbm"])
                assert "retransmits" in figures
    assert {(item["case"], item["trial"]) for item in found} == {
        (c, t) for c in ("robot-ap-internal-5", "station-ap-internal-5") for t in (1, 2)
    }


@pytest.mark.parametrize("form", ["md", "latex", "csv"])
def test_every_format_is_written_to_a_file(folder: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / f"report.{form}"
    assert report(folder, format=form, out=out) == 0  # type: ignore[arg-type]
    assert out.read_text()


def test_csv_into_a_folder_gives_every_table_its_file(folder: Path, tmp_path: Path) -> None:
    assert report(folder, format="csv", out=tmp_path / "tables", need=("camera: 10 Mbit/s",)) == 0
    names = {p.name for p in (tmp_path / "tables").iterdir()}
    assert {"figures.csv", "table2.csv", "table3.csv", "effects.csv", "needs.csv", "cases.csv"} <= names
    assert sum(name.startswith("run-") for name in names) == 4


def test_the_words_say_which_set_up_and_whether_it_is_sure(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report(folder, format="md", need=("camera: 10 Mbit/s", "commands: p99 below 5 ms")) == 0
    text = capsys.readouterr().out
    assert "access point: station against robot" in text
    assert "camera:" in text
    assert "commands: no set-up met it" in text


def test_html_of_several_runs_holds_the_comparison(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    assert report(folder, format="html", out=out) == 0
    text = out.read_text()
    assert "Table II" in text
    assert "access point: station against robot" in text


def test_tidy_csv_has_a_row_a_figure_with_its_interval() -> None:
    found = list(csv.DictReader(io.StringIO(tidy_csv([summarise(load_run(dataset("router_2G_trial2.csv")))]))))
    row = next(
        r for r in found if r["part"] == "whole" and r["end"] == "robot" and r["figure"] == "throughput_mbps.mean"
    )
    assert float(row["low95"]) < float(row["value"]) < float(row["high95"])
    assert {r["part"] for r in found} == {"whole", "static", "moving", "balance"}


def test_damaged_and_missing_runs_are_named_and_the_rest_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record_run(tmp_path / "good", seconds=15, ends=(Role.ROBOT,))
    assert report(tmp_path / "good", tmp_path / "absent") == 1
    said = capsys.readouterr()
    assert "absent" in said.err
    assert "no recording of this end" in said.out.replace("\n", " ")
    assert report() == 2


def test_out_without_a_format_says_what_is_missing(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--format"):
        report(folder, out=tmp_path / "x")


def test_import_reports_and_reads_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "other.csv"
    bad.write_text("a,b\n1,2\n")
    assert import_(dataset("internal_client_2G_trial2.csv"), bad, out=tmp_path / "runs", json=True) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[0]["case"] == "3"
    assert lines[0]["repairs"]
    assert "other.csv" in lines[1]["error"]
    assert load_run(tmp_path / "runs" / "internal_client_2G_trial2").repairs == tuple(lines[0]["repairs"])


def test_compare_ends_with_1_only_when_a_limit_is_broken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = record_run(tmp_path / "base", seconds=30, out=(99, 99), rate_mbps=12)
    new = record_run(tmp_path / "new", seconds=30, out=(99, 99), rate_mbps=8)
    assert compare(base, new) == 0
    assert compare(base, new, fail_if=("throughput < -10%",)) == 1
    assert compare(new, base, fail_if=("throughput < -10%",)) == 0
    capsys.readouterr()
    assert compare(base, new, fail_if=("throughput < -10%",), json=True) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["passed"] is False
    assert found["limits"][0]["broken"] is True


def test_both_methods_make_a_whole_document() -> None:
    run = load_run(dataset("external_robot_5G.csv"))
    for method in ("linkrover", "pandey2022"):
        document = build_document([summarise(run, method)], [run])
        assert "## In short" in as_markdown(document)
        assert r"\begin{table}" in as_latex(document)

from __future__ import annotations

import contextlib

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.importer.sheet import parse_sheet

HEADER = "time_step,time_stamp,robot_pos_x,robot_pos_y,network_delay,c_total_tx_mbps,c_total_rx_mbps,c_total_mbps"
T0 = 1_631_652_819_000_000_000


def rows(count: int = 10, step_ns: int = 20_000_000) -> list[list[str]]:
    return [[str(100 + i), str(T0 + i * step_ns), f"{i / 10}", "0", "12.5", "1.0", "0.5", "1.5"] for i in range(count)]


def text(lines: list[list[str]], header: str = HEADER, separator: str = ",", end: str = "\n") -> bytes:
    return end.join([header.replace(",", separator), *(separator.join(line) for line in lines), ""]).encode()


def test_column_order_and_case_do_not_matter() -> None:
    names = HEADER.split(",")[::-1]
    turned = [line[::-1] for line in rows()]
    sheet = parse_sheet(text(turned, ",".join(n.upper() for n in names)), "turned.csv")
    assert sheet.columns["robot_pos_x"].tolist() == pytest.approx([i / 10 for i in range(10)])
    assert sheet.wall_ns[3] - sheet.wall_ns[0] == 60_000_000
    assert sheet.repairs == ()


@pytest.mark.parametrize("end", ["\n", "\r\n", ",\n", ",,,\n"])
def test_padding_and_trailing_separators_do_not_matter(end: str) -> None:
    padded = [[f"   {cell}  " for cell in line] for line in rows()]
    sheet = parse_sheet(text(padded, end=end), "padded.csv")
    assert len(sheet.wall_ns) == 10
    assert sheet.columns["network_delay"].tolist() == [12.5] * 10


def test_a_spreadsheet_with_semicolons_and_decimal_commas_is_read() -> None:
    lines = [[cell.replace(".", ",") for cell in line] for line in rows()]
    sheet = parse_sheet(b"\xef\xbb\xbf" + text(lines, separator=";"), "continental.csv")
    assert sheet.columns["network_delay"].tolist() == [12.5] * 10


def test_stamps_in_exponent_form_are_read_and_noted() -> None:
    lines = rows()
    for line in lines:
        line[1] = f"{int(line[1]):.14E}".replace("E+18", "E+018")
    sheet = parse_sheet(text(lines), "exponent.csv")
    assert abs(int(sheet.wall_ns[5]) - (T0 + 100_000_000)) <= 10_000
    assert any("exponent form" in repair for repair in sheet.repairs)


def test_stamps_too_coarse_to_tell_rows_apart_are_rebuilt_from_the_odometry_sequence() -> None:
    lines = rows(50)
    for line in lines:
        line[1] = "1.61E+18"
    sheet = parse_sheet(text(lines), "coarse.csv")
    assert (sheet.wall_ns[1:] - sheet.wall_ns[:-1]).tolist() == [20_000_000] * 49
    assert any("rebuilt" in repair for repair in sheet.repairs)


def test_summary_rows_are_dropped_noted_and_their_cells_kept() -> None:
    blank = ["", "", "", "", "", "", "", ""]
    sums = ["", "", "", "", "", "10.0", "5.0", "15.0"]
    sheet = parse_sheet(text([*rows(), blank, sums]), "summed.csv")
    assert len(sheet.wall_ns) == 10
    assert sheet.rows_read == 12
    assert sheet.summary["c_total_mbps"] == [15.0]
    assert any("2 rows without time stamp dropped" in repair for repair in sheet.repairs)


def test_rows_out_of_order_are_sorted_and_doubles_dropped() -> None:
    lines = rows()
    lines[3], lines[4] = lines[4], lines[3]
    lines.insert(7, lines[6])
    sheet = parse_sheet(text(lines), "mixed.csv")
    assert (sheet.wall_ns[1:] > sheet.wall_ns[:-1]).all()
    assert len(sheet.wall_ns) == 10
    assert len(sheet.repairs) == 2


def test_a_short_first_row_does_not_cost_the_columns_of_the_others() -> None:
    lines = rows()
    lines[0] = lines[0][:3]
    sheet = parse_sheet(text(lines), "short.csv")
    assert sheet.columns["network_delay"].tolist() == [-2.0] + [12.5] * 9


def test_single_holes_take_the_value_before_and_are_noted() -> None:
    lines = rows()
    lines[4][4] = "n/a"
    lines[5][4] = ""
    sheet = parse_sheet(text(lines), "holes.csv")
    assert sheet.columns["network_delay"].tolist() == [12.5] * 10
    assert any("network_delay: 2 cells" in repair for repair in sheet.repairs)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "an empty file"),
        (b"   \n \n", "an empty file"),
        (b"a,b,c\n1,2,3\n", "a, b, c"),
        (b"\x89PNG\r\n\x00\x00", "binary"),
        (HEADER.encode() + b"\n", "got 0"),
        (HEADER.encode() + b"\n,,,,\n", "0"),
        (b"time_stamp,network_delay\n1,2\n", "time_stamp, network_delay"),
        (b"time_stamp,time_stamp,network_delay,c_rssi\n1,1,2,3\n", "twice"),
    ],
)
def test_any_other_file_is_a_clear_error(data: bytes, word: str) -> None:
    with pytest.raises(ParseError) as caught:
        parse_sheet(data, "other.csv")
    assert "other.csv" in str(caught.value)
    assert word in str(caught.value)


@settings(max_examples=60, deadline=None)
@example(b'"')
@given(st.binary(max_size=400))
def test_any_bytes_give_a_sheet_or_a_parse_error(data: bytes) -> None:
    for prefix in (b"", HEADER.encode() + b"\n"):
        with contextlib.suppress(ParseError):
            parse_sheet(prefix + data, "fuzz.csv")


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.lists(st.sampled_from(["", "-1", "-2", "1e400", "nan", "x", "3", "1.6E+18", str(T0), "-256"]), max_size=9),
        max_size=12,
    )
)
def test_any_cells_give_a_sheet_without_gaps_or_a_parse_error(lines: list[list[str]]) -> None:
    try:
        sheet = parse_sheet(text([*rows(3), *lines]), "fuzz.csv")
    except ParseError:
        return
    for column in sheet.columns.values():
        assert not (column != column).any()
    assert (sheet.wall_ns[1:] > sheet.wall_ns[:-1]).all()

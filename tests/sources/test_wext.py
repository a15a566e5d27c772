from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Unknown
from linkrover.sources.interface import InterfaceWatch
from linkrover.sources.wext import WirelessFileReader, parse_wireless
from linkrover.sources.wireless import WextSource

from .captured import WIRELESS, WIRELESS_HEAD
from .strategies import damaged


def kernel_line(name: str, level: int, *, noise: int = -256, quality: int = 38, dbm: bool = True) -> bytes:
    """As wireless_seq_printf_stats prints it."""
    return b"%6s: %04x  %3d%c  %3d%c  %3d%c  %6d %6d %6d %6d %6d   %6d\n" % (
        name.encode(), 0, quality, b".", level, b"." if dbm else b" ", noise, b".", 0, 0, 0, 5, 8, 2,
    )  # fmt: skip


def test_the_real_line_of_an_associated_station():
    line = parse_wireless(WIRELESS)["wlan1"]
    assert (line.quality, line.level_dbm, line.noise_dbm, line.gave_up, line.discarded_misc) == (38, -72, None, 0, 8)


def test_headers_alone_mean_no_line():
    assert parse_wireless(WIRELESS_HEAD) == {}


@pytest.mark.parametrize(
    ("printed", "dbm", "relative"),
    [(-72, -72, None), (-256, None, None), (0, None, None), (57, None, 57), (-253, 3, None), (-110, -110, None)],
)
def test_the_level_column_is_read_as_the_kernel_means_it(printed, dbm, relative):
    line = parse_wireless(WIRELESS_HEAD + kernel_line("wlan0", printed))["wlan0"]
    assert (line.level_dbm, line.relative_level) == (dbm, relative)


@given(
    st.from_regex(r"[a-z0-9]{1,15}", fullmatch=True), st.integers(-191, -1), st.integers(0, 70), st.integers(-128, -1)
)
@settings(max_examples=50)
def test_figures_come_out_as_the_kernel_put_them_in(name, level, quality, noise):
    line = parse_wireless(WIRELESS_HEAD + kernel_line(name, level, noise=noise, quality=quality))[name]
    assert (line.level_dbm, line.quality, line.noise_dbm, line.gave_up, line.missed_beacons) == (
        level, quality, noise, 5, 2,
    )  # fmt: skip


@given(damaged(WIRELESS))
@settings(max_examples=300)
def test_any_bytes_give_lines_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        parse_wireless(data)


def test_a_text_cut_anywhere_never_gives_another_level():
    for length in range(len(WIRELESS)):
        with contextlib.suppress(ParseError):
            assert all(line.level_dbm == -72 for line in parse_wireless(WIRELESS[:length]).values())


def replace(path, data):
    fresh = path.with_suffix(".new")
    fresh.write_bytes(data)
    fresh.replace(path)


class TestASourceThatReadsAFile:
    @pytest.fixture
    def path(self, tmp_path):
        path = tmp_path / "wireless"
        path.write_bytes(WIRELESS_HEAD + kernel_line("lo", -61))
        return path

    def test_gives_the_rssi_exactly_as_written(self, path):
        source = WextSource(InterfaceWatch("lo"), path=str(path))
        for level in (-61, -62, -90):
            replace(path, WIRELESS_HEAD + kernel_line("lo", level, noise=-95))
            (link,) = source.sample()
            assert (link.connected, link.rssi_dbm, link.noise_dbm, link.source) == (True, level, -95, "wext")

    def test_says_not_connected_when_the_line_vanishes(self, path):
        source = WextSource(InterfaceWatch("lo"), path=str(path))
        source.sample()
        replace(path, WIRELESS_HEAD)
        for _ in range(2):
            (link,) = source.sample()
            assert (link.connected, link.rssi_dbm) == (False, None)
            assert link.unknown["rssi_dbm"] is Unknown.NOT_CONNECTED

    def test_says_unsupported_when_there_never_was_a_line(self, path):
        replace(path, WIRELESS_HEAD)
        (link,) = WextSource(InterfaceWatch("lo"), path=str(path)).sample()
        assert (link.connected, link.unknown["rssi_dbm"]) == (None, Unknown.UNSUPPORTED)

    def test_says_absent_while_there_is_no_file_and_reads_it_later(self, path):
        content = path.read_bytes()
        path.unlink()
        source = WextSource(InterfaceWatch("lo"), path=str(path))
        (link,) = source.sample()
        assert (link.rssi_dbm, link.unknown["rssi_dbm"]) == (None, Unknown.ABSENT)
        path.write_bytes(content)
        assert source.sample()[0].rssi_dbm == -61

    def test_an_unset_noise_is_unknown_not_a_number(self, path):
        (link,) = WextSource(InterfaceWatch("lo"), path=str(path)).sample()
        assert (link.noise_dbm, link.unknown["noise_dbm"]) == (None, Unknown.UNSUPPORTED)

    def test_garbage_is_reported_and_gives_no_figure(self, path):
        replace(path, b"garbage\n")
        source = WextSource(InterfaceWatch("lo"), path=str(path))
        (link,) = source.sample()
        assert link.rssi_dbm is None
        assert isinstance(source.last_error, ParseError)

    def test_a_text_torn_once_is_read_again(self, path, monkeypatch):
        whole = path.read_bytes()
        reader = WirelessFileReader(str(path))
        answers = iter([whole[:-30], whole])
        monkeypatch.setattr(reader._file, "read", lambda: next(answers))
        assert reader.read()["lo"].level_dbm == -61


def test_a_wired_interface_gives_no_wireless_record():
    source = WextSource(InterfaceWatch("lo"))
    assert source.sample() == []
    assert source.last_error is None

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Unknown
from linkrover.sources.kept import SourceUnavailableError
from linkrover.sources.netdev import DeviceCounters, NetdevReader, parse_netdev

from .captured import NETDEV
from .strategies import damaged

U64 = st.integers(0, 2**64 - 1)


def test_a_name_is_matched_whole_not_as_a_prefix():
    found = parse_netdev(NETDEV, only={"wlan0"})
    assert found == {"wlan0": DeviceCounters(9001, 12, 1, 2, 800, 9, 3, 4)}
    assert parse_netdev(NETDEV)["wlan01"].rx_bytes == 5


def test_all_interfaces_are_found():
    assert list(parse_netdev(NETDEV)) == ["lo", "eth0", "wlan0", "wlan01"]


@pytest.mark.parametrize(
    ("text", "place", "word"),
    [
        (NETDEV[:-1], "end", "torn"),
        (b"hello\n", "line 1", "Inter-|"),
        (NETDEV.replace(b"|bytes", b"|octets", 1), "line 2", "column"),
        (NETDEV.replace(b"9001", b"9_01"), "line 5 (wlan0)", "decimal counter"),
        (NETDEV.replace(b"9001", b"-901"), "line 5 (wlan0)", "decimal counter"),
        (NETDEV.replace(b"9001", b"18446744073709551616"), "line 5 (wlan0)", "2^64"),
        (NETDEV.replace(b"wlan01:", b" wlan0:"), "line 6", "once"),
        (NETDEV.replace(b" 9001 ", b" "), "line 5", "16 counters"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_line(text, place, word):
    with pytest.raises(ParseError) as caught:
        parse_netdev(text, "/proc/net/dev")
    assert (caught.value.file, caught.value.place) == ("/proc/net/dev", place)
    assert word in str(caught.value)


@given(damaged(NETDEV))
@settings(max_examples=300)
def test_any_bytes_give_counters_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        parse_netdev(data)


@given(
    st.dictionaries(st.from_regex(r"[a-zA-Z0-9_.@-]{1,15}", fullmatch=True), st.lists(U64, min_size=16, max_size=16))
)
@settings(max_examples=50)
def test_counters_come_out_as_the_kernel_put_them_in(devices):
    head = NETDEV[: NETDEV.index(b"    lo")]
    form = "%6s: %7d %7d %4d %4d %4d %5d %10d %9d %8d %7d %4d %4d %4d %5d %7d %10d\n"
    text = head + b"".join((form % (name, *values)).encode() for name, values in devices.items())
    found = parse_netdev(text)
    assert {n: (c.rx_bytes, c.rx_packets, c.tx_bytes, c.tx_dropped) for n, c in found.items()} == {
        n: (v[0], v[1], v[8], v[11]) for n, v in devices.items()
    }


def test_the_running_kernel_is_read_and_agrees_with_sysfs():
    reader = NetdevReader()
    before = reader.read()["lo"]
    middle = int(Path("/sys/class/net/lo/statistics/rx_bytes").read_text())
    after = reader.read()["lo"]
    reader.close()
    assert before.rx_bytes <= middle <= after.rx_bytes


def test_more_interfaces_than_fit_into_one_page_are_all_read(tmp_path):
    head = NETDEV[: NETDEV.index(b"    lo")]
    line = NETDEV[NETDEV.index(b" wlan0") : NETDEV.index(b"wlan01")]
    path = tmp_path / "dev"
    path.write_bytes(head + b"".join(line.replace(b" wlan0", b"v%05d" % n) for n in range(2000)))
    assert len(NetdevReader(str(path)).read()) == 2000


def test_a_missing_file_is_absent_and_read_once_it_is_there(tmp_path):
    path = tmp_path / "dev"
    reader = NetdevReader(str(path))
    with pytest.raises(SourceUnavailableError) as caught:
        reader.read()
    assert caught.value.reason is Unknown.ABSENT
    path.write_bytes(NETDEV)
    assert "eth0" in reader.read()


def test_a_file_that_was_replaced_is_opened_anew(tmp_path):
    path = tmp_path / "dev"
    path.write_bytes(NETDEV)
    reader = NetdevReader(str(path))
    reader.read()
    fresh = tmp_path / "new"
    fresh.write_bytes(NETDEV.replace(b"9001", b"9002"))
    fresh.replace(path)
    assert reader.read()["wlan0"].rx_bytes == 9002


def test_a_named_pipe_does_not_hold_the_reader_up(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises((SourceUnavailableError, ParseError)):
        NetdevReader(str(path)).read()

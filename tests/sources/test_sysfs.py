from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.errors import ConfigError, ParseError
from linkrover.records import Unknown
from linkrover.sources.interface import InterfaceSocket
from linkrover.sources.kept import SourceUnavailableError
from linkrover.sources.sysfs import SysfsReader, parse_statistic


@pytest.fixture
def root(tmp_path):
    """A sysfs of our own with the running machine's loopback interface."""
    statistics = tmp_path / "lo" / "statistics"
    statistics.mkdir(parents=True)
    index = InterfaceSocket().index("lo")
    (tmp_path / "lo" / "ifindex").write_text(f"{index}\n")
    for number, name in enumerate(("rx_errors", "rx_dropped", "rx_missed_errors", "tx_errors", "tx_dropped"), 1):
        (statistics / name).write_text(f"{number}\n")
    return tmp_path


def test_each_counter_on_its_own(root):
    sockets = InterfaceSocket()
    found = SysfsReader(sockets, root=str(root)).read("lo", sockets.index("lo"))
    assert (found.rx_errors, found.rx_dropped, found.rx_missed, found.tx_errors, found.tx_dropped) == (1, 2, 3, 4, 5)


def test_another_index_means_another_namespace(root):
    (root / "lo" / "ifindex").write_text("4711\n")
    sockets = InterfaceSocket()
    with pytest.raises(SourceUnavailableError, match="another network namespace") as caught:
        SysfsReader(sockets, root=str(root)).read("lo", sockets.index("lo"))
    assert caught.value.reason is Unknown.UNSUPPORTED


def test_an_interface_without_a_directory_is_absent(root):
    with pytest.raises(SourceUnavailableError) as caught:
        SysfsReader(InterfaceSocket(), root=str(root)).read("wlan0", 9)
    assert caught.value.reason is Unknown.ABSENT


def test_a_name_cannot_lead_out_of_the_directory(root):
    with pytest.raises(ConfigError):
        SysfsReader(InterfaceSocket(), root=str(root / "lo")).read("../lo", 1)


def test_the_running_kernel_is_read_again_and_again_from_the_same_files():
    sockets = InterfaceSocket()
    reader = SysfsReader(sockets)
    first = reader.read("lo", sockets.index("lo"))
    assert reader.read("lo", sockets.index("lo")).rx_errors >= first.rx_errors
    assert Path("/sys/class/net/lo").exists()
    reader.close()


@given(st.binary(max_size=30))
def test_any_bytes_give_a_counter_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        assert 0 <= parse_statistic(data, "rx_errors") < 2**64

from __future__ import annotations

import contextlib
import os
import shutil
import struct
import subprocess

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Unknown
from linkrover.sources.ethtool import (
    MAC_RX_DROPPED,
    MAC_TX_RETRIES,
    EthtoolReader,
    parse_driver_info,
    parse_names,
    parse_values,
    pick,
)
from linkrover.sources.interface import InterfaceSocket
from linkrover.sources.kept import SourceUnavailableError
from tests.namespace import Namespace


@pytest.fixture(scope="module")
def veth():
    space = Namespace()
    space.ip("link add v0 type veth peer name v1")
    space.ip("link set v0 up")
    space.ip("link set v1 up")
    yield space
    space.close()


def test_a_real_driver_is_named(veth):
    info = veth.run(lambda: EthtoolReader(InterfaceSocket()).driver("v0"))
    assert (info.driver, info.version) == ("veth", "1.0")


def test_speed_of_a_wired_interface(veth):
    assert veth.run(lambda: EthtoolReader(InterfaceSocket()).speed_bps("v0")) == 10_000_000_000


def test_statistics_are_those_the_ethtool_program_prints(veth):
    if shutil.which("ethtool", path=f"{os.environ['PATH']}:/usr/sbin:/sbin") is None:
        pytest.skip("needs the ethtool program, to compare with")
    ours = veth.run(lambda: EthtoolReader(InterfaceSocket()).statistics("v0"))
    command = ["nsenter", f"--net={veth.path}", "ethtool", "-S", "v0"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    theirs = dict(line.strip().split(": ") for line in printed.splitlines()[1:])
    assert ours["peer_ifindex"] == int(theirs["peer_ifindex"])
    assert set(ours) == set(theirs)


def test_an_interface_without_statistics_says_unsupported(veth):
    with pytest.raises(SourceUnavailableError) as caught:
        veth.run(lambda: EthtoolReader(InterfaceSocket()).statistics("lo"))
    assert caught.value.reason is Unknown.UNSUPPORTED


def test_an_absent_interface_gives_no_statistics(veth):
    with pytest.raises(SourceUnavailableError):
        veth.run(lambda: EthtoolReader(InterfaceSocket()).statistics("nosuch0"))


def test_mac80211_names_are_in_the_table():
    statistics = {"tx_retry_failed": 1, "tx_retries": 17, "rx_dropped": 3}
    assert (pick(statistics, MAC_TX_RETRIES), pick(statistics, MAC_RX_DROPPED)) == (17, 3)
    assert pick({"other": 1}, MAC_TX_RETRIES) is None


def test_driver_information_is_cut_at_the_first_zero():
    data = struct.pack("I32s32s32s32s64x", 3, b"iwlwifi", b"6.1.0\0junk", b"", b"0000:00:14.3")
    info = parse_driver_info(data)
    assert (info.driver, info.version, info.firmware, info.bus) == ("iwlwifi", "6.1.0", None, "0000:00:14.3")


@given(st.binary(max_size=300), st.integers(0, 9))
@settings(max_examples=200)
def test_any_bytes_give_a_value_or_a_parse_error(data, count):
    with contextlib.suppress(ParseError):
        parse_driver_info(data)
    with contextlib.suppress(ParseError):
        assert len(parse_names(data, count)) == count
    with contextlib.suppress(ParseError):
        assert len(parse_values(data, count)) == count

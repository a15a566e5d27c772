from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, settings

from linkrover.errors import ParseError
from linkrover.sources.snmp import (
    NetstatCounters,
    NetstatReader,
    SnmpCounters,
    SnmpReader,
    parse_netstat,
    parse_snmp,
)

from .captured import NETSTAT, SNMP
from .strategies import damaged


def test_tcp_and_udp_counters_are_taken_by_column_name():
    assert parse_snmp(SNMP) == SnmpCounters(13071, 8105, 7, 3, 161, 169, 4, 5, 6)
    assert parse_netstat(NETSTAT) == NetstatCounters(11, 231, 2)


def test_udplite_is_not_taken_for_udp():
    without = SNMP[: SNMP.index(b"Udp:")] + SNMP[SNMP.index(b"UdpLite:") :]
    with pytest.raises(ParseError, match="Udp:"):
        parse_snmp(without)


def test_columns_in_another_order_give_the_same_figures():
    swapped = SNMP.replace(b"InSegs OutSegs", b"OutSegs InSegs").replace(b"13071 8105", b"8105 13071")
    assert parse_snmp(swapped) == parse_snmp(SNMP)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (b"", "line that begins"),
        (SNMP[: SNMP.index(b"13071")], "both complete"),
        (SNMP.replace(b"InSegs", b"InSeg"), "column InSegs"),
        (SNMP.replace(b" 13071", b""), "15 values"),
        (SNMP.replace(b"13071", b"x"), "decimal counter"),
        (SNMP.replace(b"Tcp: 1 200", b"Tcq: 1 200"), "begin with"),
    ],
)
def test_what_is_wrong_is_named(text, word):
    with pytest.raises(ParseError, match=word):
        parse_snmp(text)


@given(damaged(SNMP))
@settings(max_examples=300)
def test_any_bytes_give_snmp_counters_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        parse_snmp(data)


@given(damaged(NETSTAT))
@settings(max_examples=200)
def test_any_bytes_give_netstat_counters_or_a_parse_error(data):
    with contextlib.suppress(ParseError):
        parse_netstat(data)


def test_a_text_cut_anywhere_never_gives_other_figures():
    whole = parse_snmp(SNMP)
    for length in range(len(SNMP)):
        with contextlib.suppress(ParseError):
            assert parse_snmp(SNMP[:length]) == whole


def test_the_running_kernel_is_read():
    snmp, netstat = SnmpReader(), NetstatReader()
    first, second = snmp.read(), snmp.read()
    assert second.tcp_in_segments >= first.tcp_in_segments
    assert netstat.read().tcp_timeouts >= 0
    snmp.close()
    netstat.close()

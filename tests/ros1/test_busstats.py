from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import TcpConnection
from linkrover.ros1.busstats import BusCount, BusLink, increment, parse_bus_info, parse_bus_stats
from linkrover.ros1.traffic import find_connection

# captured from rostopic pub (rospy) and from rosout (roscpp)
ROSPY = [1, "", [[["/chat", 715, [[1, 892, 55, True]]]], [["/in", [[4, 895, 54, -1, True]]]], []]]
ROSCPP = [[["/chat", [[0, 892, 715, 55, 0]]]], [["/rosout", [[3, 895, 54, 0, 0]]]], []]
ROSPY_INFO = [
    1,
    "bus info",
    [
        [2, "/rosout", "o", "TCPROS", "/rosout", True,
         "TCPROS connection on port 33097 to [127.0.0.1:55938 on socket 8]"],
        [1, "http://127.0.0.1:36335/", "i", "TCPROS", "/chat", True,
         "TCPROS connection on port 53600 to [127.0.0.1:39077 on socket None]"],
    ],
]  # fmt: skip


def test_rospys_shape() -> None:
    assert parse_bus_stats(ROSPY) == [BusCount(1, "/chat", "out", 892, 55), BusCount(4, "/in", "in", 895, 54)]


def test_roscpps_shape() -> None:
    assert parse_bus_stats(ROSCPP) == [BusCount(0, "/chat", "out", 892, 55), BusCount(3, "/rosout", "in", 895, 54)]


def test_connections_with_their_ports() -> None:
    assert parse_bus_info(ROSPY_INFO) == [
        BusLink(2, "/rosout", "out", "/rosout", "TCPROS", 33097, "127.0.0.1", 55938),
        BusLink(1, "/chat", "in", "http://127.0.0.1:36335/", "TCPROS", 53600, "127.0.0.1", 39077),
    ]


def test_a_counter_that_turned_negative_goes_on() -> None:
    before = parse_bus_stats([[["/t", [[0, 2**31 - 10, 0, 1, 0]]]], [], []])[0].bytes
    after = parse_bus_stats([[["/t", [[0, -(2**31) + 90, 0, 2, 0]]]], [], []])[0].bytes
    assert increment(before, after) == 100


def test_a_counter_that_went_round_goes_on_and_one_set_back_does_not() -> None:
    assert increment(2**32 - 5, 10) == 15
    assert increment(1_000_000, 10) is None


def test_an_error_code_is_an_error() -> None:
    with pytest.raises(ParseError, match="status code"):
        parse_bus_stats([0, "not now", []])


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5) | st.floats(allow_nan=True),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=20,
)


@settings(max_examples=150)
@given(JSON)
def test_whatever_a_node_answers_only_a_parse_error_escapes(answer: Any) -> None:
    for parse in (parse_bus_stats, parse_bus_info):
        try:
            parse(answer)
        except ParseError:
            continue


def connection(local: str, remote: str) -> TcpConnection:
    return TcpConnection(wall_ns=0, mono_ns=0, iface="lo", local=local, remote=remote, state="established")


def test_a_connection_is_found_by_its_pair_of_ports() -> None:
    link = BusLink(1, "/chat", "out", "/b", "TCPROS", 1000, "10.0.0.2", 2000)
    right, wrong = connection("10.0.0.1:1000", "10.0.0.2:2000"), connection("10.0.0.1:1000", "10.0.0.3:2000")
    assert find_connection(link, [connection("10.0.0.1:2000", "10.0.0.2:1000")]) is None
    assert find_connection(link, [wrong, right]) is right
    assert find_connection(BusLink(1, "/chat", "out", "/b", "UDPROS"), [right]) is None

"""The netlink codec on bytes, on a real socket of this kernel, and on hostile input."""

from __future__ import annotations

import errno
import socket
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.sources.genetlink import FamilyAbsentError, Genetlink, parse_family
from linkrover.sources.netlink import (
    NETLINK_ROUTE,
    NETLINK_SOCK_DIAG,
    NLM_F_ACK_TLVS,
    NLM_F_CAPPED,
    NLMSG_ERROR,
    Message,
    NetlinkError,
    NetlinkSocket,
    attribute_list,
    attributes,
    error_text,
    message,
    messages,
    pack,
    u32,
)

RTM_GETLINK = 18
IFLA_IFNAME = 3


@given(st.lists(st.tuples(st.integers(0, 0x3FFF), st.binary(max_size=40)), max_size=8))
@settings(max_examples=100)
def test_attributes_come_back_in_their_order(listed: list[tuple[int, bytes]]):
    assert attribute_list(b"".join(pack(*one) for one in listed), "test") == listed


@given(st.binary(max_size=120))
@settings(max_examples=200)
def test_any_bytes_are_attributes_or_a_parse_error(data: bytes):
    try:
        found = attribute_list(data, "test")
    except ParseError:
        return
    assert sum(4 + len(value) for _, value in found) <= len(data)


@given(st.binary(max_size=120))
@settings(max_examples=200)
def test_any_bytes_are_messages_or_a_parse_error(data: bytes):
    try:
        found = list(messages(data))
    except ParseError:
        return
    assert sum(16 + len(one.payload) for one in found) <= len(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x03\x00\x01\x00", "length 3"),
        (b"\x09\x00\x01\x00abcd", "length 9"),
        (b"\x00\x00\x00\x00", "length 0"),
        (b"\x04\x00\x01\x00ab", "2 bytes"),
    ],
)
def test_a_hostile_length_names_its_place(data: bytes, words: str):
    with pytest.raises(ParseError, match=words):
        attributes(data, "test")


def test_of_an_attribute_given_twice_the_last_counts():
    assert attributes(pack(1, b"old") + pack(1, b"new"), "test") == {1: b"new"}


def test_a_nested_flag_is_no_part_of_the_type():
    assert attribute_list(pack(0x8000 | 7, b""), "test") == [(7, b"")]


def test_a_dump_of_the_interfaces_agrees_with_the_c_library():
    route = NetlinkSocket(NETLINK_ROUTE)
    answers = route.request(RTM_GETLINK, bytes(16), dump=True)
    route.close()
    names = {attributes(one, "link", 16)[IFLA_IFNAME].rstrip(b"\0").decode() for one in answers}
    assert names == {name for _, name in socket.if_nameindex()}


def test_a_refusal_names_the_request_and_the_kernels_reason():
    route = NetlinkSocket(NETLINK_ROUTE)
    with pytest.raises(NetlinkError, match=r"the link of nobody: .*ENODEV") as refused:
        route.request(RTM_GETLINK, struct.pack("=BxHiII", 0, 0, 0x7FFFFFF0, 0, 0), asked="the link of nobody")
    assert refused.value.code == errno.ENODEV
    route.close()


def test_a_socket_goes_on_after_a_refusal():
    diag = NetlinkSocket(NETLINK_SOCK_DIAG)
    for _ in range(2):
        with pytest.raises(NetlinkError):
            diag.request(20, b"\x63\x63" + bytes(54), dump=True)
    diag.close()


def test_no_answer_is_an_error_that_names_the_time():
    listener = NetlinkSocket(NETLINK_ROUTE, timeout_s=0.05)
    with pytest.raises(NetlinkError, match=r"no answer in 0\.05 s"):
        listener._receive("nothing")
    listener.close()


def test_the_kernels_own_sentence_is_read_from_an_extended_acknowledgement():
    said = pack(1, b"Unknown device type\0")
    short = Message(NLMSG_ERROR, NLM_F_CAPPED | NLM_F_ACK_TLVS, 1, struct.pack("=i", -95) + bytes(16) + said)
    assert error_text(short) == "Unknown device type"
    echoed = message(18, 0, 1, b"abcd")
    full = Message(NLMSG_ERROR, NLM_F_ACK_TLVS, 1, struct.pack("=i", -95) + echoed + said)
    assert error_text(full) == "Unknown device type"
    assert error_text(Message(NLMSG_ERROR, 0, 1, struct.pack("=i", -95) + bytes(16))) == ""


def test_a_family_of_this_kernel_is_found_with_its_groups():
    control = Genetlink("nlctrl")
    assert control.family.id == 16
    assert "notify" in control.family.groups
    assert control.join("notify")
    assert not control.join("no such group")
    assert control.pending() == ([], False)
    control.close()


def test_an_absent_family_says_so():
    with pytest.raises(FamilyAbsentError, match="no_such_family: not in this kernel"):
        Genetlink("no_such_family")


@given(st.binary(max_size=80))
@settings(max_examples=150)
def test_a_damaged_family_is_a_parse_error(tail: bytes):
    for data in (tail, bytes(4) + tail, bytes(4) + pack(1, b"\x10\x00") + pack(7, pack(1, tail))):
        try:
            parse_family(data)
        except ParseError:
            continue


def test_a_group_without_a_number_is_a_parse_error():
    with pytest.raises(ParseError, match="attribute 2"):
        parse_family(bytes(4) + pack(1, b"\x10\x00") + pack(7, pack(1, pack(1, b"mlme\0"))))
    assert parse_family(bytes(4) + pack(1, b"\x10\x00") + pack(7, pack(1, pack(2, u32(9))))).groups == {"": 9}

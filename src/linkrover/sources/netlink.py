"""Netlink: messages and attributes as bytes, and a socket that asks and listens.

Sources: RFC 3549, linux/netlink.h, Documentation/userspace-api/netlink/intro.rst. All integers are in host order.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import struct
import time
from collections.abc import Iterator
from typing import NamedTuple

from ..errors import LinkRoverError, ParseError

NETLINK_ROUTE = 0
NETLINK_SOCK_DIAG = 4
NETLINK_GENERIC = 16

NLMSG_NOOP, NLMSG_ERROR, NLMSG_DONE, NLMSG_OVERRUN = 1, 2, 3, 4
NLM_F_REQUEST, NLM_F_MULTI, NLM_F_ACK, NLM_F_DUMP_INTR = 0x01, 0x02, 0x04, 0x10
NLM_F_CAPPED, NLM_F_ACK_TLVS = 0x100, 0x200
NLM_F_DUMP = 0x300
NLMSGERR_ATTR_MSG = 1
NLA_TYPE_MASK = 0x3FFF  # without NLA_F_NESTED and NLA_F_NET_BYTEORDER

SOL_NETLINK = 270
NETLINK_ADD_MEMBERSHIP, NETLINK_CAP_ACK, NETLINK_EXT_ACK = 1, 10, 11

_HEADER = struct.Struct("=IHHII")  # struct nlmsghdr
_ATTRIBUTE = struct.Struct("=HH")  # struct nlattr
_DUMP_TRIES = 3


class NetlinkError(LinkRoverError):
    """The kernel refused a request, or did not answer. `code` is the errno."""

    def __init__(self, code: int, asked: str, said: str = "") -> None:
        self.code = code
        reason = said or os.strerror(code)
        hint = "; run as root or with CAP_NET_ADMIN" if code in (errno.EPERM, errno.EACCES) else ""
        super().__init__(f"{asked}: {reason} ({errno.errorcode.get(code, code)}){hint}")


class Message(NamedTuple):
    """One netlink message without its header."""

    type: int
    flags: int
    sequence: int
    payload: bytes


def messages(data: bytes, file: str = "netlink") -> Iterator[Message]:
    """The messages of one datagram.

    Raises:
        ParseError: a length points outside the datagram.
    """
    offset, end = 0, len(data)
    while offset < end:
        if end - offset < 16:
            raise ParseError(file, f"byte {offset}", "a netlink header of 16 bytes", f"{end - offset} bytes")
        length, kind, flags, sequence, _ = _HEADER.unpack_from(data, offset)
        if length < 16 or offset + length > end:
            raise ParseError(file, f"byte {offset}", f"a message of 16 to {end - offset} bytes", f"length {length}")
        yield Message(kind, flags, sequence, data[offset + 16 : offset + length])
        offset += (length + 3) & ~3


def attribute_list(data: bytes, file: str, start: int = 0) -> list[tuple[int, bytes]]:
    """Attributes (type, value) in their order; the flag bits are taken off the type.

    Raises:
        ParseError: an attribute's length is below 4 or points outside the data.
    """
    found = []
    offset, end = start, len(data)
    while end - offset >= 4:
        length, kind = _ATTRIBUTE.unpack_from(data, offset)
        stop = offset + length
        if length < 4 or stop > end:
            raise ParseError(file, f"byte {offset}", f"an attribute of 4 to {end - offset} bytes", f"length {length}")
        found.append((kind & NLA_TYPE_MASK, data[offset + 4 : stop]))
        offset = (stop + 3) & ~3
    if end - offset > 0:
        raise ParseError(file, f"byte {offset}", "an attribute header of 4 bytes", f"{end - offset} bytes")
    return found


def attributes(data: bytes, file: str, start: int = 0) -> dict[int, bytes]:
    """Attributes by type; of one that occurs twice the last counts, as in the kernel (nla_parse).

    Raises:
        ParseError: as attribute_list.
    """
    return dict(attribute_list(data, file, start))


def pack(kind: int, value: bytes) -> bytes:
    """One attribute with its padding."""
    return _ATTRIBUTE.pack(len(value) + 4, kind) + value + bytes(-len(value) % 4)


def u32(value: int) -> bytes:
    """A 32-bit attribute value."""
    return struct.pack("=I", value)


def message(kind: int, flags: int, sequence: int, payload: bytes) -> bytes:
    """One message with its header."""
    return _HEADER.pack(16 + len(payload), kind, flags, sequence, 0) + payload


class NetlinkSocket:
    """A socket of one netlink protocol, for requests or for listening to multicast groups.

    Raises:
        NetlinkError: this kernel does not have the protocol.
    """

    def __init__(self, protocol: int, *, timeout_s: float = 2.0, receive_buffer: int | None = None) -> None:
        self._timeout_s = timeout_s
        try:
            self._socket = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, protocol)
        except OSError as reason:
            raise NetlinkError(reason.errno or 0, f"open netlink protocol {protocol}") from reason
        self._sequence = time.monotonic_ns() & 0x3FFFFFFF
        for option in (NETLINK_CAP_ACK, NETLINK_EXT_ACK):
            with contextlib.suppress(OSError):  # kernels before 4.12 answer without the sentence
                self._socket.setsockopt(SOL_NETLINK, option, 1)
        if receive_buffer is not None:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self._socket.bind((0, 0))

    def fileno(self) -> int:
        """The file descriptor, for a loop."""
        return self._socket.fileno()

    def join(self, group: int) -> None:
        """Listen to a multicast group, by number."""
        self._socket.setsockopt(SOL_NETLINK, NETLINK_ADD_MEMBERSHIP, group)

    def bind_groups(self, mask: int) -> None:
        """Listen to the classic groups of a protocol, by bit mask (RTMGRP_*)."""
        for bit in range(32):
            if mask >> bit & 1:
                self.join(bit + 1)

    def request(
        self, kind: int, payload: bytes, *, dump: bool = False, single: bool = False, asked: str = "netlink request"
    ) -> list[bytes]:
        """Ask and return the payloads of the answers. A dump that the kernel marks as torn is taken again.

        single: the request has exactly one answer, so that no acknowledgement is asked for and waited for.

        Raises:
            NetlinkError: the kernel refused, or did not answer in time (ETIMEDOUT).
            ParseError: the answer is not netlink.
        """
        for _ in range(_DUMP_TRIES):
            answers, torn = self._ask(kind, payload, dump, single, asked)
            if not torn:
                break
        return answers

    def _ask(self, kind: int, payload: bytes, dump: bool, single: bool, asked: str) -> tuple[list[bytes], bool]:
        self._sequence = (self._sequence + 1) & 0x7FFFFFFF
        sequence = self._sequence
        flags = NLM_F_REQUEST | (NLM_F_DUMP if dump else 0 if single else NLM_F_ACK)
        try:
            self._socket.send(message(kind, flags, sequence, payload))
        except OSError as reason:
            raise NetlinkError(reason.errno or 0, asked) from reason
        answers: list[bytes] = []
        torn = False
        while True:
            data = self._receive(asked)
            for one in messages(data, asked):
                if one.sequence != sequence:
                    continue  # the late answer to a request that was given up
                if one.flags & NLM_F_DUMP_INTR:
                    torn = True
                if one.type == NLMSG_DONE:
                    self._check(one, asked)
                    return answers, torn
                if one.type == NLMSG_ERROR:
                    self._check(one, asked)
                    return answers, torn
                if one.type > NLMSG_OVERRUN:
                    answers.append(one.payload)
                    if single:
                        return answers, False

    @staticmethod
    def _check(one: Message, asked: str) -> None:
        if len(one.payload) < 4:
            return  # a bare NLMSG_DONE of old kernels
        code = -struct.unpack_from("=i", one.payload)[0]
        if code > 0:
            raise NetlinkError(code, asked, error_text(one))

    def _receive(self, asked: str) -> bytes:
        # The kernel answers within the send call, so that waiting is the exception; poll() only when it has not.
        try:
            return self._socket.recv(65536, socket.MSG_DONTWAIT)
        except BlockingIOError:
            poll = select.poll()
            poll.register(self._socket, select.POLLIN)
            if not poll.poll(int(self._timeout_s * 1000)):
                raise NetlinkError(errno.ETIMEDOUT, asked, f"no answer in {self._timeout_s:g} s") from None
            return self._socket.recv(65536)
        except OSError as reason:
            raise NetlinkError(reason.errno or 0, asked) from reason

    def pending(self) -> tuple[list[Message], bool]:
        """All that has arrived without being asked for, and whether the kernel had to drop some (ENOBUFS).

        Raises:
            ParseError: what arrived is not netlink.
        """
        found: list[Message] = []
        lost = False
        while True:
            try:
                data = self._socket.recv(65536, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return found, lost
            except OSError as reason:
                if reason.errno != errno.ENOBUFS:
                    raise NetlinkError(reason.errno or 0, "listen to netlink") from reason
                lost = True
                continue
            found += messages(data)

    def close(self) -> None:
        """Give back the socket."""
        self._socket.close()


def error_text(one: Message) -> str:
    """The kernel's own sentence in an error message (extended acknowledgement), or nothing."""
    if one.type == NLMSG_DONE:
        start = 4
    else:
        if not one.flags & NLM_F_ACK_TLVS or len(one.payload) < 20:
            return ""
        echoed = struct.unpack_from("=I", one.payload, 4)[0]
        start = 20 if one.flags & NLM_F_CAPPED else 4 + ((echoed + 3) & ~3)
    try:
        said = attributes(one.payload, "extended acknowledgement", start).get(NLMSGERR_ATTR_MSG, b"")
    except ParseError:
        return ""
    return said.rstrip(b"\0").decode(errors="replace")

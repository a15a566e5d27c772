"""Generic netlink: families by name, and requests to one of them (linux/genetlink.h)."""

from __future__ import annotations

import errno
import struct
from typing import NamedTuple

from ..errors import ParseError
from .netlink import NETLINK_GENERIC, NetlinkError, NetlinkSocket, attribute_list, attributes, pack

GENL_ID_CTRL = 16
CTRL_CMD_GETFAMILY = 3
CTRL_ATTR_FAMILY_ID, CTRL_ATTR_FAMILY_NAME, CTRL_ATTR_VERSION, CTRL_ATTR_MCAST_GROUPS = 1, 2, 3, 7
CTRL_ATTR_MCAST_GRP_NAME, CTRL_ATTR_MCAST_GRP_ID = 1, 2
_HEADER = struct.Struct("=BBH")
GENL_HEADER = 4  # struct genlmsghdr: u8 command, u8 version, u16 reserved


class Family(NamedTuple):
    """A generic netlink family and its multicast groups by name."""

    id: int
    name: str
    version: int
    groups: dict[str, int]


class FamilyAbsentError(NetlinkError):
    """This kernel has no such family: the module is not there."""

    def __init__(self, name: str) -> None:
        super().__init__(errno.ENOENT, f"generic netlink family {name}", "not in this kernel")


def parse_family(payload: bytes, file: str = "genetlink family") -> Family:
    """A CTRL_CMD_NEWFAMILY message, from its genlmsghdr on.

    Raises:
        ParseError: it does not hold what a family must have.
    """
    if len(payload) < GENL_HEADER:
        raise ParseError(file, "start", "a generic netlink header of 4 bytes", f"{len(payload)} bytes")
    found = attributes(payload, file, GENL_HEADER)
    groups = {}
    for _, nested in attribute_list(found.get(CTRL_ATTR_MCAST_GROUPS, b""), file):
        one = attributes(nested, file)
        name = text(one.get(CTRL_ATTR_MCAST_GRP_NAME, b""))
        groups[name] = number(one, CTRL_ATTR_MCAST_GRP_ID, "=I", file)
    version = found.get(CTRL_ATTR_VERSION)
    return Family(
        id=number(found, CTRL_ATTR_FAMILY_ID, "=H", file),
        name=text(found.get(CTRL_ATTR_FAMILY_NAME, b"")),
        version=struct.unpack_from("=I", version)[0] if version is not None and len(version) >= 4 else 1,
        groups=groups,
    )


def number(found: dict[int, bytes], kind: int, form: str, file: str) -> int:
    """An integer attribute that must be there.

    Raises:
        ParseError: it is absent or too short.
    """
    value = found.get(kind)
    if value is None or len(value) < struct.calcsize(form):
        got = "nothing" if value is None else f"{len(value)} bytes"
        raise ParseError(file, f"attribute {kind}", f"{struct.calcsize(form)} bytes", got)
    return int(struct.unpack_from(form, value)[0])


def text(value: bytes) -> str:
    """A zero-terminated string."""
    return value.split(b"\0", 1)[0].decode(errors="replace")


class Genetlink:
    """A socket to one generic netlink family.

    Raises:
        FamilyAbsentError: this kernel does not have the family.
        NetlinkError: generic netlink cannot be reached.
    """

    def __init__(self, family: str, *, timeout_s: float = 2.0, receive_buffer: int | None = None) -> None:
        self._socket = NetlinkSocket(NETLINK_GENERIC, timeout_s=timeout_s, receive_buffer=receive_buffer)
        try:
            self.family = self._resolve(family)
        except NetlinkError as reason:
            self._socket.close()
            if reason.code == errno.ENOENT:
                raise FamilyAbsentError(family) from reason
            raise
        except ParseError:
            self._socket.close()
            raise

    def _resolve(self, name: str) -> Family:
        asked = struct.pack("=BBH", CTRL_CMD_GETFAMILY, 1, 0) + pack(CTRL_ATTR_FAMILY_NAME, name.encode() + b"\0")
        answers = self._socket.request(GENL_ID_CTRL, asked, asked=f"generic netlink family {name}")
        if not answers:
            raise FamilyAbsentError(name)
        return parse_family(answers[0])

    def ask(self, command: int, payload: bytes = b"", *, dump: bool = False, asked: str = "") -> list[bytes]:
        """Send a command; the answers from their genlmsghdr on.

        Raises:
            NetlinkError: the kernel refused or did not answer.
            ParseError: the answer is not netlink.
        """
        header = _HEADER.pack(command, 0, 0)
        name = asked or f"{self.family.name} command {command}"
        return self._socket.request(self.family.id, header + payload, dump=dump, asked=name)

    def one(self, command: int, payload: bytes = b"", *, asked: str = "") -> bytes:
        """Send a command that has one answer; it, from its genlmsghdr on.

        Raises:
            NetlinkError: as ask(), and ENODATA where the kernel only acknowledged.
            ParseError: the answer is not netlink.
        """
        name = asked or f"{self.family.name} command {command}"
        answers = self._socket.request(self.family.id, _HEADER.pack(command, 0, 0) + payload, single=True, asked=name)
        if not answers:
            raise NetlinkError(errno.ENODATA, name)
        return answers[0]

    def join(self, group: str) -> bool:
        """Listen to a multicast group by name; False where the family does not have it."""
        number_ = self.family.groups.get(group)
        if number_ is None:
            return False
        self._socket.join(number_)
        return True

    def pending(self) -> tuple[list[bytes], bool]:
        """Payloads that arrived without being asked for, and whether the kernel dropped some."""
        found, lost = self._socket.pending()
        return [one.payload for one in found if one.type == self.family.id], lost

    def fileno(self) -> int:
        """The file descriptor, for a loop."""
        return self._socket.fileno()

    def close(self) -> None:
        """Give back the socket."""
        self._socket.close()

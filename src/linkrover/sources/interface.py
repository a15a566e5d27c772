"""Which device a name means: there, gone, back, renamed (ioctl on a socket, netdevice(7))."""

from __future__ import annotations

import difflib
import fcntl
import re
import socket
import struct
from collections.abc import Callable

import msgspec

from linkrover.errors import ConfigError
from linkrover.records import EventKind

SIOCGIFNAME = 0x8910
SIOCGIFADDR = 0x8915
SIOCGIFMTU = 0x8921
SIOCGIFHWADDR = 0x8927
SIOCGIFINDEX = 0x8933

_NAME = re.compile(r"[^\s/:\x00]{1,15}")


def check_name(name: str) -> str:
    """The name, if the kernel could have given it (dev_valid_name, net/core/dev.c).

    Raises:
        ConfigError: it could not.
    """
    if not _NAME.fullmatch(name) or name in {".", ".."} or len(name.encode()) > 15:
        raise ConfigError(f"'{name}' cannot be an interface name: 1 to 15 bytes without spaces, '/' and ':'")
    return name


def interface_names() -> list[str]:
    """Names of the interfaces of this namespace, as the kernel lists them."""
    return [name for _, name in socket.if_nameindex()]


def no_such_interface(name: str, there: list[str]) -> ConfigError:
    """The error for a name that is not there, with what is."""
    near = difflib.get_close_matches(name, there, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return ConfigError(
        f"no interface '{name}' here; there are: {', '.join(there) or 'none'}{hint} "
        "(--wait waits for it to be plugged in)"
    )


class InterfaceSocket:
    """A datagram socket for interface ioctls; it stays in the network namespace it was made in."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)

    def index(self, name: str) -> int | None:
        """Interface index, None when there is none of this name."""
        reply = self._ask(SIOCGIFINDEX, name)
        return None if reply is None else int(struct.unpack_from("i", reply, 16)[0])

    def name(self, index: int) -> str | None:
        """Name of the interface with this index, None when there is none."""
        try:
            reply = fcntl.ioctl(self._socket, SIOCGIFNAME, struct.pack("16si20x", b"", index))
        except OSError:
            return None
        return reply[:16].split(b"\0", 1)[0].decode("utf-8", "backslashreplace")

    def mac(self, name: str) -> str | None:
        """Hardware address as aa:bb:cc:dd:ee:ff; None where the device has none (TUN)."""
        reply = self._ask(SIOCGIFHWADDR, name)
        if reply is None or struct.unpack_from("H", reply, 16)[0] not in {1, 801, 802, 803}:  # ARPHRD_ETHER, 802.11
            return None
        return ":".join(f"{octet:02x}" for octet in reply[18:24])

    def mtu(self, name: str) -> int | None:
        """Largest packet in bytes."""
        reply = self._ask(SIOCGIFMTU, name)
        return None if reply is None else int(struct.unpack_from("i", reply, 16)[0])

    def ask(self, request: int, argument: bytes | bytearray) -> bytes:
        """Any ioctl on this socket with an argument of at most 1024 bytes.

        Raises:
            OSError: as the kernel answers.
        """
        return fcntl.ioctl(self._socket, request, bytes(argument))

    def close(self) -> None:
        """Give back the socket."""
        self._socket.close()

    def _ask(self, request: int, name: str) -> bytes | None:
        try:
            return fcntl.ioctl(self._socket, request, struct.pack("16s24x", name.encode("utf-8", "surrogateescape")))
        except OSError:
            return None


class Presence(msgspec.Struct, frozen=True):
    """Where the watched interface is now: index None = gone. `name` is what the kernel calls it at the moment.

    `epoch` goes up whenever the counters may have begun anew: gone, back, replaced.
    """

    index: int | None
    name: str
    epoch: int


class InterfaceWatch:
    """Follows one device through renaming, and a name through unplugging and plugging in.

    As long as the device lives it is followed by its index, whatever it is called; once it is gone, the next device
    that bears the name asked for takes its place. Records keep the name asked for.
    """

    def __init__(
        self,
        iface: str,
        *,
        sockets: InterfaceSocket | None = None,
        on_change: Callable[[str, EventKind, str], None] | None = None,
    ) -> None:
        self.iface = check_name(iface)
        self.on_change = on_change
        self._sockets = sockets or InterfaceSocket()
        self.presence = Presence(self._sockets.index(iface), iface, 0)
        self._seen = self.presence.index is not None

    def look(self) -> Presence:
        """Where the interface is now. Calls on_change(iface, kind, detail) when that has changed."""
        before = self.presence
        if before.index is not None:
            name = self._sockets.name(before.index)
            if name == before.name:
                return before
            if name is not None:
                self.presence = Presence(before.index, name, before.epoch)
                self._tell(EventKind.INTERFACE_RENAMED, f"{before.name} is now called {name}")
                return self.presence
        index = self._sockets.index(self.iface)
        if index == before.index:
            return before
        self.presence = Presence(index, self.iface, before.epoch + 1)
        if before.index is not None:
            self._tell(EventKind.INTERFACE_GONE, f"{before.name} (index {before.index}) is gone")
        if index is not None:
            word = "back" if self._seen else "there"
            self._tell(EventKind.INTERFACE_BACK, f"{self.iface} is {word}, with index {index}")
            self._seen = True
        return self.presence

    def _tell(self, kind: EventKind, detail: str) -> None:
        if self.on_change is not None:
            self.on_change(self.iface, kind, detail)

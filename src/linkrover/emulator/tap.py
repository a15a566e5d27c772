"""When the kernel put a probe into a device: a packet socket beside the TUN, with the kernel's own timestamps.

The relay notes when it reads a packet, but on a busy machine the packet may have waited in the device before. For the
probes (a few a second; a filter in the kernel passes nothing else) the true delay begins with the kernel's stamp.
"""

from __future__ import annotations

import ctypes
import socket
import struct

from linkrover.probe.packet import DEFAULT_PORT

ETH_P_ALL = 0x0003
SO_ATTACH_FILTER = 26  # include/uapi/asm-generic/socket.h
SO_TIMESTAMPNS = 35
PACKET_OUTGOING = 4  # include/uapi/linux/if_packet.h
AD_PKTTYPE = 0xFFFFF000 + 4  # include/uapi/linux/filter.h: SKF_AD_OFF + SKF_AD_PKTTYPE
HELD_MOST = 1000

_ACCEPT, _DROP = 0x40000, 0
# opcode, jump if true, jump if false, operand (classic BPF): outgoing, UDP, our port at either side
_FILTER = (
    (0x20, 0, 0, AD_PKTTYPE),
    (0x15, 0, 8, PACKET_OUTGOING),
    (0x30, 0, 0, 9),
    (0x15, 0, 6, 17),
    (0xB1, 0, 0, 0),  # X = length of the IP header
    (0x48, 0, 0, 0),
    (0x15, 2, 0, DEFAULT_PORT),
    (0x48, 0, 0, 2),
    (0x15, 0, 1, DEFAULT_PORT),
    (0x06, 0, 0, _ACCEPT),
    (0x06, 0, 0, _DROP),
)


def open_tap(iface: str) -> int:
    """The descriptor of a tap on a device of this network namespace.

    Raises:
        OSError: packet sockets are not to be had here.
    """
    program = b"".join(struct.pack("=HBBI", *step) for step in _FILTER)
    held = ctypes.create_string_buffer(program)
    handle = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK, 0)
    try:
        handle.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, struct.pack("@HP", len(_FILTER), ctypes.addressof(held)))
        handle.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        handle.bind((iface, ETH_P_ALL))
    except OSError:
        handle.close()
        raise
    return handle.detach()


class Tap:
    """Tells when the kernel sent a packet; takes over the descriptor of open_tap()."""

    def __init__(self, fd: int) -> None:
        self._socket = socket.socket(fileno=fd)
        self._sent_ns: dict[bytes, int] = {}

    def sent_ns(self, packet: bytes) -> int | None:
        """CLOCK_REALTIME at which this very packet went into the device; None if the tap did not see it."""
        while True:
            try:
                data, ancillary, _, _ = self._socket.recvmsg(2048, 64)
            except BlockingIOError:
                break
            for level, kind, value in ancillary:
                if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) == 16:
                    seconds, rest_ns = struct.unpack("=qq", value)
                    self._sent_ns[data] = seconds * 1_000_000_000 + rest_ns
        if len(self._sent_ns) > HELD_MOST:
            self._sent_ns.clear()
        return self._sent_ns.pop(packet, None)

    def close(self) -> None:
        """Give the descriptor back."""
        self._socket.close()

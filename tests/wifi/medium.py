"""A radio medium for mac80211_hwsim: frames go from radio to radio through this process, with signal and loss.

Protocol: drivers/net/wireless/mac80211_hwsim.h (generic netlink family MAC80211_HWSIM). Every attempt of the rate
table that the driver asks for is tried one by one, so that retries and failures are known exactly. Loss strikes
unicast data frames only: management frames always arrive, so that the stations stay associated.
"""

from __future__ import annotations

import random
import select
import struct
import threading
from dataclasses import dataclass

from linkrover.sources.genetlink import GENL_HEADER, Genetlink
from linkrover.sources.netlink import NLM_F_REQUEST, attributes, message, pack, u32

CMD_REGISTER, CMD_FRAME, CMD_TX_INFO = 1, 2, 3
ADDR_RECEIVER, ADDR_TRANSMITTER, FRAME, FLAGS, RX_RATE, SIGNAL, TX_INFO, COOKIE, FREQ = 1, 2, 3, 4, 5, 6, 7, 8, 19
NO_ACK, ACKED = 2, 4
DATA = 2


@dataclass
class Hop:
    """One direction between two radios, and what has become of its unicast data frames."""

    signal_dbm: int = -40
    loss: float = 0.0
    frames: int = 0
    retries: int = 0
    failed: int = 0


class Medium:
    """Carries the frames of all radios named; begins at start(), gives the air back to the kernel at close()."""

    def __init__(self, macs: list[str], seed: int = 1) -> None:
        self._nl = Genetlink("MAC80211_HWSIM", receive_buffer=4 << 20)
        self._random = random.Random(seed)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="medium", daemon=True)
        self._radios = [bytes.fromhex(mac.replace(":", "")) for mac in macs]
        self._hops = {(a, b): Hop() for a in self._radios for b in self._radios if a != b}
        self.frames = 0
        self.error: BaseException | None = None

    def hop(self, sender: str, receiver: str) -> Hop:
        """The direction from one radio to another."""
        first, second = (bytes.fromhex(mac.replace(":", "")) for mac in (sender, receiver))
        return self._hops[first, second]

    def start(self) -> None:
        """Take the air over."""
        self._nl.ask(CMD_REGISTER)
        self._thread.start()

    def close(self) -> None:
        """Give the air back."""
        self._stop.set()
        self._thread.join(10)
        self._nl.close()
        if self.error is not None:
            raise self.error

    def _carry(self) -> None:
        try:
            while not self._stop.is_set():
                if select.select([self._nl], [], [], 0.1)[0]:
                    for payload in self._nl.pending()[0]:
                        if payload[0] == CMD_FRAME:
                            self._frame(attributes(payload, "hwsim frame", GENL_HEADER))
        except BaseException as reason:  # noqa: BLE001  # shown by close(), in the test's own thread
            self.error = reason

    def _frame(self, found: dict[int, bytes]) -> None:
        self.frames += 1
        hardware = found[ADDR_TRANSMITTER]
        sender = bytes([hardware[0] & ~0x40]) + hardware[1:]
        frame = found[FRAME]
        receiver = frame[4:10]
        flags = struct.unpack("=I", found[FLAGS])[0]
        rates = [struct.unpack_from("=bB", found[TX_INFO], at) for at in range(0, len(found[TX_INFO]), 2)]
        used = rates[:1]
        if receiver[0] & 1:
            for other in self._radios:
                if other != sender:
                    self._deliver(sender, other, found, rates[0][0])
        elif (sender, receiver) in self._hops:
            hop = self._hops[sender, receiver]
            lossy = (frame[0] >> 2) & 3 == DATA
            used, arrived = self._attempts(rates, hop.loss if lossy else 0.0)
            if lossy:
                hop.frames += 1
                hop.retries += sum(count for _, count in used) - 1
                hop.failed += not arrived
            if arrived:
                self._deliver(sender, receiver, found, used[-1][0])
                if not flags & NO_ACK:
                    flags |= ACKED
        told = b"".join(struct.pack("=bB", *rate) for rate in used)
        told += struct.pack("=bB", -1, 0) * (len(rates) - len(used))
        self._send(
            CMD_TX_INFO,
            pack(ADDR_TRANSMITTER, hardware)
            + pack(FLAGS, u32(flags))
            + pack(COOKIE, found[COOKIE])
            + pack(SIGNAL, struct.pack("=i", -40))
            + pack(TX_INFO, told),
        )

    def _attempts(self, rates: list[tuple[int, int]], loss: float) -> tuple[list[tuple[int, int]], bool]:
        used = []
        for index, count in rates:
            if index < 0:
                break
            for attempt in range(1, count + 1):
                if self._random.random() >= loss:
                    return [*used, (index, attempt)], True
            used.append((index, count))
        return used, False

    def _deliver(self, sender: bytes, receiver: bytes, found: dict[int, bytes], rate: int) -> None:
        hop = self._hops[sender, receiver]
        self._send(
            CMD_FRAME,
            pack(ADDR_RECEIVER, bytes([receiver[0] | 0x40]) + receiver[1:])
            + pack(FRAME, found[FRAME])
            + pack(RX_RATE, u32(max(0, rate)))
            + pack(SIGNAL, struct.pack("=i", hop.signal_dbm))
            + pack(FREQ, found[FREQ]),
        )

    def _send(self, command: int, payload: bytes) -> None:
        header = struct.pack("=BBH", command, 1, 0)
        self._nl._socket._socket.send(message(self._nl.family.id, NLM_F_REQUEST, 0, header + payload))

"""Driver queues: bounded drop-tail, and one like fq_codel (fair between flows, CoDel dropping at the head)."""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol


class Packet:
    """One packet inside the model. Times in ns; `octets` is the length of the IP packet."""

    __slots__ = ("at_ns", "destination", "flow", "hop_at_ns", "octets", "origin", "retries", "sequence", "tag")

    def __init__(self, tag: object, octets: int, origin: str, destination: str, flow: int, at_ns: int) -> None:
        self.tag = tag
        self.octets = octets
        self.origin = origin
        self.destination = destination
        self.flow = flow
        self.at_ns = at_ns
        self.hop_at_ns = at_ns
        self.retries = 0
        self.sequence = 0


class Queue(Protocol):
    """What the medium asks of a queue."""

    packets: int
    octets: int

    def push(self, packet: Packet) -> Packet | None:
        """Append; returns the packet that had to go (this one, or an older one), or None."""
        ...

    def pop(self, now_ns: int) -> Packet | None:
        """The next packet, None when empty."""
        ...

    def unpop(self, packet: Packet) -> None:
        """Put back what was popped last."""
        ...

    def clear(self) -> list[Packet]:
        """Empty it; returns what was in it."""
        ...

    def take_dropped(self) -> list[Packet]:
        """Packets that the queue itself dropped since the last call (CoDel)."""
        ...


class DropTail:
    """First in, first out; a packet that finds the queue full is dropped."""

    __slots__ = ("_deque", "limit_octets", "limit_packets", "octets", "packets")

    def __init__(self, limit_packets: int, limit_octets: int | None = None) -> None:
        self._deque: deque[Packet] = deque()
        self.limit_packets = limit_packets
        self.limit_octets = limit_octets if limit_octets is not None else 1 << 62
        self.packets = 0
        self.octets = 0

    def push(self, packet: Packet) -> Packet | None:
        """Append, or return the packet when there is no room."""
        if self.packets >= self.limit_packets or self.octets + packet.octets > self.limit_octets:
            return packet
        self._deque.append(packet)
        self.packets += 1
        self.octets += packet.octets
        return None

    def pop(self, now_ns: int) -> Packet | None:  # noqa: ARG002 - the other queue needs the time
        """The oldest packet."""
        if not self._deque:
            return None
        packet = self._deque.popleft()
        self.packets -= 1
        self.octets -= packet.octets
        return packet

    def unpop(self, packet: Packet) -> None:
        """Back to the head."""
        self._deque.appendleft(packet)
        self.packets += 1
        self.octets += packet.octets

    def clear(self) -> list[Packet]:
        """Empty it."""
        out = list(self._deque)
        self._deque.clear()
        self.packets = self.octets = 0
        return out

    def take_dropped(self) -> list[Packet]:
        """Drop-tail drops nothing later."""
        return []


class _Flow:
    __slots__ = ("count", "deficit", "drop_next_ns", "dropping", "first_above_ns", "octets", "packets")

    def __init__(self) -> None:
        self.packets: deque[Packet] = deque()
        self.octets = 0
        self.deficit = 0
        self.dropping = False
        self.first_above_ns = 0
        self.drop_next_ns = 0
        self.count = 0


class FairCoDel:
    """Deficit round robin over flows, new flows first, CoDel (RFC 8289) in each: after RFC 8290 (FQ-CoDel).

    Flows are told apart by the number given with the packet, so there are no hash collisions. When full, the head
    of the flow with the most octets goes. target 20 ms and interval 100 ms as mac80211 uses them.
    """

    def __init__(
        self,
        limit_packets: int,
        limit_octets: int | None = None,
        *,
        target_ns: int = 20_000_000,
        interval_ns: int = 100_000_000,
        quantum: int = 1514,
    ) -> None:
        self.limit_packets = limit_packets
        self.limit_octets = limit_octets if limit_octets is not None else 1 << 62
        self.target_ns = target_ns
        self.interval_ns = interval_ns
        self.quantum = quantum
        self.packets = 0
        self.octets = 0
        self._flows: dict[int, _Flow] = {}
        self._new: deque[int] = deque()
        self._old: deque[int] = deque()
        self._dropped: list[Packet] = []

    def push(self, packet: Packet) -> Packet | None:
        """Append to its flow; when the whole queue is full the fattest flow loses its head."""
        flow = self._flows.get(packet.flow)
        if flow is None:
            flow = self._flows[packet.flow] = _Flow()
            flow.deficit = self.quantum
            self._new.append(packet.flow)
        flow.packets.append(packet)
        flow.octets += packet.octets
        self.packets += 1
        self.octets += packet.octets
        if self.packets <= self.limit_packets and self.octets <= self.limit_octets:
            return None
        fattest = max(self._flows.values(), key=lambda f: f.octets)
        return self._take(fattest)

    def _take(self, flow: _Flow) -> Packet:
        packet = flow.packets.popleft()
        flow.octets -= packet.octets
        self.packets -= 1
        self.octets -= packet.octets
        return packet

    def pop(self, now_ns: int) -> Packet | None:
        """The next packet by deficit round robin, after CoDel had its say."""
        while self._new or self._old:
            order = self._new or self._old
            key = order[0]
            flow = self._flows[key]
            if flow.deficit <= 0:
                flow.deficit += self.quantum
                order.popleft()
                self._old.append(key)
                continue
            packet = self._codel(flow, now_ns)
            if packet is None:
                order.popleft()
                if order is self._new and self._old:
                    self._old.append(key)  # RFC 8290: an emptied new flow goes round once as an old one
                else:
                    del self._flows[key]
                continue
            flow.deficit -= packet.octets
            return packet
        return None

    def _should_drop(self, flow: _Flow, packet: Packet, now_ns: int) -> bool:
        if now_ns - packet.hop_at_ns < self.target_ns or flow.octets <= self.quantum:
            flow.first_above_ns = 0
            return False
        if flow.first_above_ns == 0:
            flow.first_above_ns = now_ns + self.interval_ns
            return False
        return now_ns >= flow.first_above_ns

    def _control(self, from_ns: int, count: int) -> int:
        return from_ns + int(self.interval_ns / math.sqrt(count))

    def _codel(self, flow: _Flow, now_ns: int) -> Packet | None:
        if not flow.packets:
            flow.dropping = False
            return None
        packet = self._take(flow)
        drop = self._should_drop(flow, packet, now_ns)
        if flow.dropping:
            if not drop:
                flow.dropping = False
            while flow.dropping and now_ns >= flow.drop_next_ns:
                self._dropped.append(packet)
                flow.count += 1
                if not flow.packets:
                    flow.dropping = False
                    return None
                packet = self._take(flow)
                if self._should_drop(flow, packet, now_ns):
                    flow.drop_next_ns = self._control(flow.drop_next_ns, flow.count)
                else:
                    flow.dropping = False
        elif drop:
            self._dropped.append(packet)
            recent = now_ns - flow.drop_next_ns < 16 * self.interval_ns
            flow.count = flow.count - 2 if recent and flow.count > 2 else 1
            flow.dropping = True
            flow.drop_next_ns = self._control(now_ns, flow.count)
            if not flow.packets:
                return None
            packet = self._take(flow)
        return packet

    def unpop(self, packet: Packet) -> None:
        """Back to the head of its flow, with its deficit."""
        flow = self._flows.get(packet.flow)
        if flow is None:
            flow = self._flows[packet.flow] = _Flow()
            self._old.appendleft(packet.flow)
        flow.packets.appendleft(packet)
        flow.octets += packet.octets
        flow.deficit += packet.octets
        self.packets += 1
        self.octets += packet.octets

    def clear(self) -> list[Packet]:
        """Empty it."""
        out = [packet for flow in self._flows.values() for packet in flow.packets]
        self._flows.clear()
        self._new.clear()
        self._old.clear()
        self.packets = self.octets = 0
        return out

    def take_dropped(self) -> list[Packet]:
        """What CoDel dropped since the last call."""
        if not self._dropped:
            return []
        out, self._dropped = self._dropped, []
        return out

"""What the link did to each STAMP packet, found by looking into the packets that pass the relay."""

from __future__ import annotations

from linkrover.probe.packet import BASE_BYTES, DEFAULT_PORT
from linkrover.records import Now, ProbeTruth, Role

UDP = 17
_PORT = DEFAULT_PORT.to_bytes(2, "big")


def is_probe(packet: bytes) -> bool:
    """Whether a UDP packet goes to or comes from our reflector's port."""
    header = (packet[0] & 15) * 4
    return _PORT in (packet[header : header + 2], packet[header + 2 : header + 4])


def probe_truth(packet: bytes, sender: str, at: Now, delay_ns: int | None, dropped: str | None) -> ProbeTruth | None:
    """The truth of an IPv4 packet if it is a STAMP test packet on our port, else None.

    sender: name of the node it came from, which is its role. at: when the link got it.
    """
    if len(packet) < 28 + BASE_BYTES or packet[9] != UDP or packet[0] >> 4 != 4 or packet[6] & 0x1F or packet[7]:
        return None
    header = (packet[0] & 15) * 4
    source, destination = packet[header : header + 2], packet[header + 2 : header + 4]
    payload = header + 8
    if destination == _PORT:
        at_sequence, asked_by = payload, sender
    elif source == _PORT:
        # an answer echoes the asking end's sequence 24 octets in (RFC 8762, 4.3.1)
        at_sequence, asked_by = payload + 24, "station" if sender == "robot" else "robot"
    else:
        return None
    if len(packet) < payload + BASE_BYTES or sender not in ("robot", "station"):
        return None
    return ProbeTruth(
        wall_ns=at.wall_ns,
        mono_ns=at.mono_ns,
        session=int.from_bytes(packet[payload + 14 : payload + 16], "big"),
        sequence=int.from_bytes(packet[at_sequence : at_sequence + 4], "big"),
        direction="forward" if sender == "robot" else "back",
        end=Role(asked_by),
        delay_ns=delay_ns,
        dropped=dropped,
    )

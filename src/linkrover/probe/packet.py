"""STAMP test packets: RFC 8762 (44 and 112 octets), session identifier and padding of RFC 8972.

Timestamps are integer nanoseconds since the Unix epoch on the outside and NTP 64-bit on the wire (error estimate
Z=0); packets with truncated PTPv2 timestamps (Z=1) are read too.
"""

from __future__ import annotations

import hmac
import struct

import msgspec

from linkrover import __version__
from linkrover.errors import ParseError

DEFAULT_PORT = 8620
"""UDP port of our reflector. STAMP's own port, 862, needs a privilege to bind; other vendors' gear listens there."""

BASE_BYTES = 44
"""Unauthenticated test packet, both directions (RFC 8762, 4.2.1 and 4.3.1)."""
AUTHENTICATED_BYTES = 112
TWAMP_LIGHT_BYTES = 41
"""The least a TWAMP-Light answer can be (RFC 5357, 4.2.1): our base answer without its last three zero octets."""
MAX_BYTES = 65_507
HMAC_BYTES = 16
_HMAC_COVERS = 96

_NTP_UNIX_S = 2_208_988_800
_NTP_ERA = 1 << 64
_TLV_UNRECOGNISED = 0x80
_TLV_MALFORMED = 0x40
_TLV_EXTRA_PADDING = 1
_TLV_PRIVATE = 252  # RFC 8972, 5.1: 252 to 254 are for private use
_VERSION_MAGIC = b"LinkRover\0"
_VERSION_BYTES = 40

_ZEROS = bytes(BASE_BYTES - 16)
_SENDER = struct.Struct(">IQHH28x")
_SENDER_READ = struct.Struct(">IQHH")
_REFLECTOR_READ = struct.Struct(">IQHHQIQHxxB")
_SENDER_AUTH = struct.Struct(">I12xQHH68x")
_REFLECTOR_AUTH = struct.Struct(">I12xQHH4xQ8xI12xQH6xB15x")


class ErrorEstimate(msgspec.Struct, frozen=True):
    """How far a timestamp may be wrong (RFC 4656, 4.1.2): S, Z, Scale, Multiplier in 16 bits.

    synchronized: the clock follows UTC by an outside source. ptp: the timestamps beside it are truncated PTPv2.
    """

    synchronized: bool = False
    ptp: bool = False
    scale: int = 0
    multiplier: int = 1

    @property
    def error_ns(self) -> float:
        """Multiplier * 2^-32 * 2^Scale seconds, in nanoseconds."""
        return float(self.multiplier * 2.0 ** (self.scale - 32) * 1e9)

    @classmethod
    def of_ns(cls, error_ns: int, *, synchronized: bool) -> ErrorEstimate:
        """The smallest expressible estimate that is not below error_ns."""
        units = max(1, -(-error_ns * (1 << 32) // 1_000_000_000))
        scale = max(0, units.bit_length() - 8)
        if units > 255 << scale:
            scale += 1
        if scale > 63:
            return cls(synchronized, False, 63, 255)
        return cls(synchronized, False, scale, max(1, -(-units >> scale)))

    def encode(self) -> int:
        """The 16 bits."""
        return self.synchronized << 15 | self.ptp << 14 | self.scale << 8 | self.multiplier

    @classmethod
    def decode(cls, bits: int) -> ErrorEstimate:
        """Any 16 bits; a Multiplier of 0, which the RFC forbids, is kept for the reader to judge."""
        return cls(bool(bits & 0x8000), bool(bits & 0x4000), bits >> 8 & 0x3F, bits & 0xFF)


class SenderPacket(msgspec.Struct, frozen=True):
    """What a Session-Sender sends. timestamp_ns: its clock. ssid 0: none (RFC 8762 without RFC 8972)."""

    sequence: int
    timestamp_ns: int
    error_estimate: ErrorEstimate = ErrorEstimate()
    ssid: int = 0


class ReflectorPacket(msgspec.Struct, frozen=True):
    """What a Session-Reflector answers: its own sequence, T3, T2, and the sender's packet echoed."""

    sequence: int
    timestamp_ns: int
    receive_timestamp_ns: int
    sender_sequence: int
    sender_timestamp_ns: int
    error_estimate: ErrorEstimate = ErrorEstimate()
    sender_error_estimate: ErrorEstimate = ErrorEstimate()
    ssid: int = 0
    sender_ttl: int = 0


def to_ntp(unix_ns: int) -> int:
    """NTP 64-bit timestamp of a Unix time, rounded to 2^-32 s; later eras wrap as NTP does."""
    seconds, rest_ns = divmod(unix_ns, 1_000_000_000)
    return (((seconds + _NTP_UNIX_S) << 32) + ((rest_ns << 32) + 500_000_000) // 1_000_000_000) % _NTP_ERA


def from_ntp(ntp: int) -> int:
    """Unix nanoseconds of an NTP timestamp; values before 1970 are taken as of the next era (2036 on)."""
    seconds = (ntp >> 32) - _NTP_UNIX_S
    if seconds < 0:
        seconds += 1 << 32
    return seconds * 1_000_000_000 + ((ntp & 0xFFFFFFFF) * 1_000_000_000 + (1 << 31) >> 32)


def from_ptp(ptp: int) -> int:
    """Nanoseconds of a truncated PTPv2 timestamp: seconds and nanoseconds, 32 bits each (RFC 8186, 2.3)."""
    return (ptp >> 32) * 1_000_000_000 + (ptp & 0xFFFFFFFF)


def _time_ns(raw: int, error_bits: int) -> int:
    return from_ptp(raw) if error_bits & 0x4000 else from_ntp(raw)


def encode_sender(packet: SenderPacket, *, key: bytes | None = None, size: int = 0) -> bytes:
    """A test packet of at least its base size, padded to `size` octets by an Extra Padding TLV (RFC 8972, 4.1).

    A key makes it authenticated (HMAC-SHA-256 truncated to 16 octets over the first 96, RFC 8762, 4.4).
    Fewer than four octets of padding cannot hold a TLV; they are zero octets.
    """
    layout = _SENDER if key is None else _SENDER_AUTH
    base = layout.pack(
        packet.sequence & 0xFFFFFFFF, to_ntp(packet.timestamp_ns), packet.error_estimate.encode(), packet.ssid & 0xFFFF
    )
    if key is not None:
        base += _digest(base, key)
    return base + padding(size - len(base))


def padding(octets: int) -> bytes:
    """`octets` of padding in an Extra Padding TLV with the sender's U flag set; none for 0 or less."""
    if octets < 4:
        return bytes(max(0, octets))
    return struct.pack(">BBH", _TLV_UNRECOGNISED, _TLV_EXTRA_PADDING, octets - 4) + bytes(octets - 4)


def version_request() -> bytes:
    """A TLV to put behind a test packet: one of our reflectors writes its version there (see version_of)."""
    return struct.pack(">BBH", _TLV_UNRECOGNISED, _TLV_PRIVATE, _VERSION_BYTES) + _VERSION_MAGIC.ljust(
        _VERSION_BYTES, b"\0"
    )


def version_of(data: bytes, *, authenticated: bool = False) -> str | None:
    """The LinkRover version in an answer to a packet with version_request(); None where the reflector is another."""
    tlv = data[AUTHENTICATED_BYTES if authenticated else BASE_BYTES :]
    if len(tlv) < 4 + _VERSION_BYTES or tlv[0] & _TLV_UNRECOGNISED or tlv[1] != _TLV_PRIVATE:
        return None
    value = tlv[4 : 4 + _VERSION_BYTES]
    if not value.startswith(_VERSION_MAGIC):
        return None
    text = value[len(_VERSION_MAGIC) :].rstrip(b"\0").decode("ascii", "replace")
    return text if text.isprintable() and text else None


def decode_sender(data: bytes, *, key: bytes | None = None) -> SenderPacket:
    """Read a Session-Sender's (or a TWAMP-Light sender's) packet.

    Raises:
        ParseError: shorter than an answer of the same size can be (41 octets, authenticated 112), or a wrong HMAC.
    """
    if key is None:
        _need(data, TWAMP_LIGHT_BYTES, "a STAMP or TWAMP-Light test packet")
        sequence, time_raw, error, ssid = _SENDER_READ.unpack_from(data)
        if data[16:BASE_BYTES] != _ZEROS:
            ssid = 0  # a TWAMP-Light sender's padding, which may be random, stands here
    else:
        _need(data, AUTHENTICATED_BYTES, "an authenticated STAMP test packet")
        _check(data, key)
        sequence, time_raw, error, ssid = _SENDER_AUTH.unpack_from(data)
    return SenderPacket(sequence, _time_ns(time_raw, error), ErrorEstimate.decode(error), ssid)


def answer(
    request: bytes,
    *,
    sequence: int,
    receive_ns: int,
    send_ns: int,
    error_estimate: int,
    ttl: int,
    ssid: int = 0,
    key: bytes | None = None,
) -> bytes:
    """The reflector's packet for a request that decode_sender() accepted: never longer than the request.

    The sender's sequence, timestamp and error estimate go back octet by octet, whatever their format.
    """
    if key is None:
        base = b"".join(
            (
                struct.pack(">IQHHQ", sequence & 0xFFFFFFFF, to_ntp(send_ns), error_estimate, ssid, to_ntp(receive_ns)),
                request[0:14],
                struct.pack(">xxB3x", ttl),
            )
        )
        if len(request) <= BASE_BYTES:
            return base[: len(request)]
        return base + _reflect_tlvs(request[BASE_BYTES:])
    base = b"".join(
        (
            struct.pack(
                ">I12xQHH4xQ8x", sequence & 0xFFFFFFFF, to_ntp(send_ns), error_estimate, ssid, to_ntp(receive_ns)
            ),
            request[0:4],
            bytes(12),
            request[16:26],
            struct.pack(">6xB15x", ttl),
        )
    )
    return base + _digest(base, key) + _reflect_tlvs(request[AUTHENTICATED_BYTES:])


def decode_reflector(data: bytes, *, key: bytes | None = None) -> ReflectorPacket:
    """Read a Session-Reflector's (or a TWAMP-Light responder's) answer.

    Raises:
        ParseError: too short, or a wrong HMAC.
    """
    if key is None:
        _need(data, TWAMP_LIGHT_BYTES, "a STAMP or TWAMP-Light answer")
        fields = _REFLECTOR_READ.unpack_from(data)
    else:
        _need(data, AUTHENTICATED_BYTES, "an authenticated STAMP answer")
        _check(data, key)
        fields = _REFLECTOR_AUTH.unpack_from(data)
    sequence, send_raw, error, ssid, receive_raw, sender_sequence, sender_raw, sender_error, ttl = fields
    return ReflectorPacket(
        sequence,
        _time_ns(send_raw, error),
        _time_ns(receive_raw, error),
        sender_sequence,
        _time_ns(sender_raw, sender_error),
        ErrorEstimate.decode(error),
        ErrorEstimate.decode(sender_error),
        ssid,
        ttl,
    )


def _reflect_tlvs(tlvs: bytes) -> bytes:
    """The request's TLVs as a reflector returns them (RFC 8972, 4): U cleared where understood, M where malformed."""
    if not tlvs:
        return b""
    out = bytearray(tlvs)
    at = 0
    while len(out) - at >= 4:
        kind, length = out[at + 1], int.from_bytes(out[at + 2 : at + 4], "big")
        if kind == 0 and out[at] == 0:
            break  # plain zero padding of an RFC 8762 or TWAMP-Light sender, not a TLV
        if length > len(out) - at - 4:
            out[at] |= _TLV_MALFORMED
            break
        if kind == _TLV_EXTRA_PADDING:
            out[at] &= ~(_TLV_UNRECOGNISED | _TLV_MALFORMED) & 0xFF
        elif kind == _TLV_PRIVATE and out[at + 4 : at + 4 + length] == _VERSION_MAGIC.ljust(_VERSION_BYTES, b"\0"):
            out[at] &= ~(_TLV_UNRECOGNISED | _TLV_MALFORMED) & 0xFF
            said = _VERSION_MAGIC + __version__.encode()[: _VERSION_BYTES - len(_VERSION_MAGIC)]
            out[at + 4 : at + 4 + length] = said.ljust(_VERSION_BYTES, b"\0")
        else:
            out[at] |= _TLV_UNRECOGNISED
        at += 4 + length
    return bytes(out)


def _need(data: bytes, octets: int, what: str) -> None:
    if len(data) < octets:
        raise ParseError("STAMP packet", f"octet {len(data)}", f"{what} of at least {octets} octets")


def _digest(base: bytes, key: bytes) -> bytes:
    return hmac.digest(key, base[:_HMAC_COVERS], "sha256")[:HMAC_BYTES]


def _check(data: bytes, key: bytes) -> None:
    if not hmac.compare_digest(_digest(data, key), data[_HMAC_COVERS : _HMAC_COVERS + HMAC_BYTES]):
        raise ParseError("STAMP packet", f"octet {_HMAC_COVERS}", "an HMAC made with this key")

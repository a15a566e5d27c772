import hashlib
import hmac
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.probe import packet
from linkrover.probe.packet import ErrorEstimate, SenderPacket

KEY = b"a shared secret of the two ends"
NOW_NS = 1_795_272_149_881_717_731
NTP_1970 = 2_208_988_800

times = st.integers(0, 2_000_000_000 * 10**9)
u32 = st.integers(0, 0xFFFF_FFFF)
u16 = st.integers(0, 0xFFFF)


def test_sender_packet_has_the_fields_of_rfc_8762_and_8972_at_their_octets():
    data = packet.encode_sender(SenderPacket(7, NOW_NS, ErrorEstimate(True, False, 5, 9), 0xABCD))
    assert len(data) == 44
    assert struct.unpack(">I", data[0:4]) == (7,)
    seconds, fraction = struct.unpack(">II", data[4:12])
    assert seconds - NTP_1970 == NOW_NS // 10**9
    assert fraction / 2**32 == pytest.approx(NOW_NS % 10**9 / 1e9, abs=1e-9)
    assert data[12:14] == bytes([0b10_000101, 9])
    assert data[14:16] == b"\xab\xcd"
    assert data[16:] == bytes(28)


def test_authenticated_sender_packet_is_112_octets_and_its_hmac_covers_the_first_96():
    data = packet.encode_sender(SenderPacket(7, NOW_NS, ErrorEstimate(), 0xABCD), key=KEY)
    assert len(data) == 112
    assert data[:16] == struct.pack(">I", 7) + bytes(12)
    assert data[26:28] == b"\xab\xcd"
    assert data[96:] == hmac.new(KEY, data[:96], hashlib.sha256).digest()[:16]


def test_answer_echoes_the_senders_fields_and_carries_t2_t3_and_the_ttl():
    request = packet.encode_sender(SenderPacket(7, NOW_NS, ErrorEstimate(True, False, 5, 9), 0xABCD))
    data = packet.answer(
        request, sequence=3, receive_ns=NOW_NS + 10, send_ns=NOW_NS + 20, error_estimate=0x1234, ttl=61, ssid=0xABCD
    )
    assert len(data) == 44
    assert data[0:4] == struct.pack(">I", 3)
    assert data[12:14] == b"\x12\x34"
    assert data[14:16] == b"\xab\xcd"
    assert data[24:28] == request[0:4]
    assert data[28:36] == request[4:12]
    assert data[36:38] == request[12:14]
    assert data[38:] == b"\x00\x00" + bytes([61]) + bytes(3)
    assert packet.from_ntp(int.from_bytes(data[4:12], "big")) == NOW_NS + 20
    assert packet.from_ntp(int.from_bytes(data[16:24], "big")) == NOW_NS + 10


def test_authenticated_answer_has_the_fields_of_rfc_8762_at_their_octets():
    request = packet.encode_sender(SenderPacket(7, NOW_NS, ErrorEstimate(), 0xABCD), key=KEY)
    data = packet.answer(
        request, sequence=3, receive_ns=NOW_NS + 10, send_ns=NOW_NS + 20, error_estimate=1, ttl=61, ssid=0xABCD, key=KEY
    )
    assert len(data) == 112
    assert data[0:16] == struct.pack(">I", 3) + bytes(12)
    assert data[26:32] == b"\xab\xcd" + bytes(4)
    assert packet.from_ntp(int.from_bytes(data[32:40], "big")) == NOW_NS + 10
    assert data[40:48] == bytes(8)
    assert data[48:64] == struct.pack(">I", 7) + bytes(12)
    assert data[64:74] == request[16:26]
    assert data[80] == 61
    assert data[96:] == hmac.new(KEY, data[:96], hashlib.sha256).digest()[:16]


def test_scapys_stamp_dissector_reads_what_we_send_and_what_we_answer():
    stamp = pytest.importorskip("scapy.contrib.stamp", reason="scapy is not installed")
    request = packet.encode_sender(SenderPacket(7, NOW_NS, ErrorEstimate(True, False, 5, 9), 4711), size=80)
    seen = stamp.STAMPSessionSenderTestUnauthenticated(request)
    assert (seen.seq, seen.ssid, seen.mbz) == (7, 4711, 0)
    assert float(seen.ts) - NTP_1970 == pytest.approx(NOW_NS / 1e9, abs=1e-6)
    assert (seen.err_estimate.S, seen.err_estimate.Z, seen.err_estimate.scale, seen.err_estimate.multiplier) == (
        (1, 0, 5, 9)
    )
    [tlv] = seen.tlv_objects
    # by number: scapy names the flags from the lowest bit, the RFC's U is the highest
    assert (int(tlv.flags), tlv.type, tlv.len, len(tlv.value)) == (0x80, 1, 32, 32)
    data = packet.answer(
        request, sequence=3, receive_ns=NOW_NS + 10, send_ns=NOW_NS + 20, error_estimate=1, ttl=61, ssid=0xABCD
    )
    seen = stamp.STAMPSessionReflectorTestUnauthenticated(data)
    assert (seen.seq, seen.ssid, seen.seq_sender, seen.ttl_sender) == (3, 0xABCD, 7, 61)
    assert seen.err_estimate_sender.multiplier == 9
    assert float(seen.ts_sender) - NTP_1970 == pytest.approx(NOW_NS / 1e9, abs=1e-6)
    [tlv] = seen.tlv_objects
    assert (int(tlv.flags), tlv.type, tlv.len) == (0, 1, 32), "the reflector clears U: it understood the padding"


def test_we_read_what_scapy_builds():
    stamp = pytest.importorskip("scapy.contrib.stamp", reason="scapy is not installed")
    built = bytes(stamp.STAMPSessionSenderTestUnauthenticated(seq=12, ts=NTP_1970 + 1_000_000_000, ssid=99))
    read = packet.decode_sender(built)
    assert (read.sequence, read.timestamp_ns, read.ssid) == (12, 1_000_000_000 * 10**9, 99)


@given(times)
def test_ntp_timestamps_keep_every_nanosecond(ns):
    assert packet.from_ntp(packet.to_ntp(ns)) == ns


def test_ntp_era_1_is_read_as_after_2036():
    in_2037 = 2_114_380_800 * 10**9
    assert packet.to_ntp(in_2037) < 1 << 60, "the 32-bit seconds began again"
    assert packet.from_ntp(packet.to_ntp(in_2037)) == in_2037


def test_truncated_ptp_timestamps_of_a_peer_are_read():
    request = packet.encode_sender(SenderPacket(1, NOW_NS))
    data = bytearray(
        packet.answer(request, sequence=0, receive_ns=NOW_NS, send_ns=NOW_NS, error_estimate=0x4001, ttl=1)
    )
    data[4:12] = struct.pack(">II", 1_795_272_149, 123)
    data[16:24] = struct.pack(">II", 1_795_272_149, 99)
    read = packet.decode_reflector(bytes(data))
    assert read.timestamp_ns == 1_795_272_149_000_000_123
    assert read.receive_timestamp_ns == 1_795_272_149_000_000_099
    assert read.sender_timestamp_ns == NOW_NS, "ours stays NTP"


@given(st.integers(0, 10**14), st.booleans())
def test_error_estimate_is_the_smallest_not_below_the_error(error_ns, synchronized):
    estimate = ErrorEstimate.of_ns(error_ns, synchronized=synchronized)
    assert estimate.multiplier >= 1
    assert estimate.error_ns >= error_ns * (1 - 1e-9)
    assert estimate.error_ns <= max(1, error_ns) * 1.02 + 0.3
    assert ErrorEstimate.decode(estimate.encode()) == estimate


@given(st.binary(max_size=200), st.sampled_from([None, KEY]))
@settings(max_examples=300)
def test_any_octets_give_a_packet_or_a_parse_error(data, key):
    for decode in (packet.decode_sender, packet.decode_reflector):
        try:
            decode(data, key=key)
        except ParseError:
            continue


@given(st.binary(min_size=41, max_size=300), u32, times, times, st.integers(0, 255))
@settings(max_examples=300)
def test_an_answer_is_exactly_as_long_as_its_request_whatever_it_holds(request_data, sequence, t2, t3, ttl):
    data = packet.answer(request_data, sequence=sequence, receive_ns=t2, send_ns=t3, error_estimate=1, ttl=ttl)
    assert len(data) == len(request_data)
    read = packet.decode_reflector(data)
    assert (read.sequence, read.receive_timestamp_ns, read.timestamp_ns) == (sequence, t2, t3)
    assert data[24:38] == request_data[0:14]


@given(st.integers(0, 300), st.sampled_from([None, KEY]), u32, times, u16)
def test_padding_reaches_any_size_and_packets_survive_the_round_trip(size, key, sequence, time_ns, ssid):
    sent = SenderPacket(sequence, time_ns, ErrorEstimate(), ssid)
    data = packet.encode_sender(sent, key=key, size=size)
    assert len(data) == max(size, 44 if key is None else 112)
    assert packet.decode_sender(data, key=key) == sent


def test_a_wrong_key_or_one_flipped_bit_is_refused():
    data = packet.encode_sender(SenderPacket(7, NOW_NS), key=KEY)
    with pytest.raises(ParseError, match="HMAC"):
        packet.decode_sender(data, key=b"another secret altogether")
    for octet in range(112):
        flipped = bytearray(data)
        flipped[octet] ^= 1
        with pytest.raises(ParseError, match="HMAC"):
            packet.decode_sender(bytes(flipped), key=KEY)


def test_tlvs_come_back_marked_unrecognised_or_malformed():
    base = packet.encode_sender(SenderPacket(1, NOW_NS))
    unknown = bytes([0x80, 99, 0, 4]) + b"data"
    overlong = bytes([0x80, 1, 0, 200]) + b"data"
    data = packet.answer(base + unknown + overlong, sequence=0, receive_ns=0, send_ns=0, error_estimate=1, ttl=0)
    assert data[44:52] == unknown
    assert data[52:] == bytes([0xC0, 1, 0, 200]) + b"data"

import hashlib
import hmac
import os
import random
import socket
import struct
import threading
import time

import pytest

import linkrover
from linkrover.errors import ConfigError
from linkrover.loop import Loop
from linkrover.probe import packet
from linkrover.probe.reflector import StampReflector
from linkrover.probe.version import ask_version

from .exchange import received, run_until, running_reflector, udp

KEY = b"a shared secret of the two ends"


def ntp(unix_s):
    """RFC 5905 short form of this test's own."""
    return struct.pack(">II", int(unix_s) + 2_208_988_800, int(unix_s % 1 * 2**32))


def unix(eight):
    seconds, fraction = struct.unpack(">II", eight)
    return seconds - 2_208_988_800 + fraction / 2**32


def exchange(loop, sock, to, data, counters):
    before = counters.received
    sock.sendto(data, to)
    run_until(loop, lambda: counters.received > before)
    return received(sock)


def test_a_twamp_light_sender_written_from_rfc_5357_is_answered():
    """Sequence, timestamp, error estimate and 27 octets of padding; 41 octets back (RFC 5357, 4.1.2 and 4.2.1)."""
    with running_reflector() as (loop, reflector):
        sock = udp()
        to = ("127.0.0.1", reflector.port)
        for number in range(3):
            before = time.time()
            request = struct.pack(">I", number + 40) + ntp(before) + struct.pack(">BB", 0x3F, 0x01) + os.urandom(27)
            [reply] = exchange(loop, sock, to, request, reflector.counters)
            after = time.time()
            assert len(reply) == 41
            assert struct.unpack(">I", reply[0:4]) == (number,), "the reflector's own sequence"
            assert before - 1e-3 <= unix(reply[16:24]) <= unix(reply[4:12]) <= after + 1e-3, "T1 <= T2 <= T3 <= T4"
            assert reply[13] > 0, "an error estimate's multiplier is never zero"
            assert reply[24:38] == request[0:14], "sequence, timestamp and error estimate come back"
            assert reply[40] == 64, "the TTL the request arrived with"
        sock.close()


def test_an_authenticated_sender_written_from_rfc_8762_is_answered():
    with running_reflector(key=KEY) as (loop, reflector):
        sock = udp()
        body = struct.pack(">I", 9) + bytes(12) + ntp(time.time()) + b"\x00\x01" + b"\x12\x34" + bytes(68)
        request = body + hmac.new(KEY, body, hashlib.sha256).digest()[:16]
        [reply] = exchange(loop, sock, ("127.0.0.1", reflector.port), request, reflector.counters)
        assert len(reply) == 112
        assert reply[96:] == hmac.new(KEY, reply[:96], hashlib.sha256).digest()[:16]
        assert struct.unpack(">I", reply[48:52]) == (9,)
        assert reply[26:28] == b"\x12\x34"
        sock.close()


@pytest.mark.parametrize("key", [None, KEY])
def test_short_long_and_garbage_are_counted_and_never_answered_with_more_octets(key):
    chance = random.Random(7)
    with running_reflector(key=key) as (loop, reflector):
        sock = udp()
        counters = reflector.counters
        for size in [0, 1, 13, 14, 40, 41, 43, 44, 45, 111, 112, 113, 500, 1472, 9000, 65_507]:
            replies = exchange(loop, sock, ("127.0.0.1", reflector.port), chance.randbytes(size), counters)
            assert all(len(reply) == size for reply in replies)
            assert bool(replies) == (key is None and size >= 41)
        assert counters.received == counters.answered + counters.malformed + counters.unauthenticated
        assert counters.malformed == (5 if key is None else 10)
        assert counters.unauthenticated == (0 if key is None else 6)
        assert counters.answered_bytes <= counters.received_bytes
        sock.close()


def test_a_replayed_packet_is_counted_and_answered_with_a_fresh_number():
    with running_reflector() as (loop, reflector):
        sock = udp()
        request = struct.pack(">I", 5) + ntp(time.time()) + b"\x00\x01" + bytes(30)
        numbers = []
        for _ in range(4):
            [reply] = exchange(loop, sock, ("127.0.0.1", reflector.port), request, reflector.counters)
            numbers.append(int.from_bytes(reply[:4], "big"))
        assert numbers == [0, 1, 2, 3]
        assert reflector.counters.replayed == 3
        sock.close()


def test_a_flood_from_one_source_is_answered_up_to_the_rate_and_counted():
    with running_reflector(rate_per_s=100) as (loop, reflector):
        sock = udp()
        for number in range(2_000):
            sock.sendto(struct.pack(">I", number) + bytes(40), ("127.0.0.1", reflector.port))
            if number % 50 == 49:
                run_until(loop, lambda n=number: reflector.counters.received > n)
        counters = reflector.counters
        assert counters.rate_limited > 1_000
        assert counters.answered + counters.rate_limited == 2_000
        sock.close()


def test_invented_sessions_do_not_fill_the_memory():
    with running_reflector(rate_per_s=1e9) as (loop, reflector):
        sock = udp()
        for ssid in range(3_000):
            sock.sendto(bytes(14) + struct.pack(">H", ssid) + bytes(28), ("127.0.0.1", reflector.port))
            if ssid % 50 == 49:
                run_until(loop, lambda n=ssid: reflector.counters.received >= n + 1)
        assert reflector.counters.answered == 3_000
        assert len(reflector.sessions) <= 1_024
        sock.close()


def test_each_session_identifier_has_its_own_sequence():
    with running_reflector() as (loop, reflector):
        sock = udp()
        numbers = []
        for ssid in (1, 2, 1, 1, 2):
            request = bytes(14) + struct.pack(">H", ssid) + bytes(28)
            [reply] = exchange(loop, sock, ("127.0.0.1", reflector.port), request, reflector.counters)
            numbers.append((ssid, int.from_bytes(reply[:4], "big")))
        assert numbers == [(1, 0), (2, 0), (1, 1), (1, 2), (2, 1)]
        sock.close()


def test_the_answer_comes_from_the_address_that_was_asked_with_the_same_dscp():
    with running_reflector("") as (loop, reflector):
        sock = udp(host="127.0.0.1")
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, 46 << 2)
        sock.setsockopt(socket.IPPROTO_IP, 13, 1)  # IP_RECVTOS
        sock.sendto(bytes(44), ("127.0.0.77", reflector.port))
        run_until(loop, lambda: reflector.counters.answered == 1)
        _, ancillary, _, source = sock.recvmsg(100, 100)
        assert source == ("127.0.0.77", reflector.port)
        assert ancillary[0][2][0] >> 2 == 46
        sock.close()


def test_ipv6_is_answered_beside_ipv4_on_the_same_port():
    with running_reflector("") as (loop, reflector):
        if len(reflector.addresses) < 2:
            pytest.skip("this kernel has no IPv6")
        sock = udp(socket.AF_INET6, "::1")
        [reply] = exchange(loop, sock, ("::1", reflector.port), bytes(44), reflector.counters)
        assert reply[40] == 64
        sock.close()


def test_a_taken_port_a_foreign_address_and_a_missing_privilege_say_what_to_do():
    with running_reflector() as (loop, reflector):
        with pytest.raises(ConfigError, match="another --port"):
            StampReflector(loop, "127.0.0.1", reflector.port).start()
        with pytest.raises(ConfigError, match="ip address"):
            StampReflector(loop, "192.0.2.1", 0).start()
        with pytest.raises(ConfigError, match="give an IP address"):
            StampReflector(loop, "no-such-host.invalid", 0).start()


def test_counters_and_sockets_survive_stop_and_a_second_start():
    loop = Loop()
    reflector = StampReflector(loop, "127.0.0.1", 0)
    reflector.start()
    port = reflector.port
    reflector.stop()
    reflector.start()
    assert reflector.port == port
    reflector.stop()
    reflector.stop()
    loop.close()


@pytest.mark.parametrize("key", [None, KEY])
def test_our_reflector_tells_its_version_and_another_makes_none(key):
    with running_reflector(key=key) as (loop, reflector):
        thread = threading.Thread(target=loop.run)
        thread.start()
        assert ask_version("127.0.0.1", reflector.port, key=key) == linkrover.__version__
        loop.stop()
        thread.join(10)
        assert ask_version("127.0.0.1", reflector.port, key=key, timeout_s=0.05) is None
    request = packet.encode_sender(packet.SenderPacket(1, 1)) + packet.version_request()
    assert packet.version_of(request) is None, "a reflector that returns the TLV as it came is another make"
    assert packet.version_of(b"") is None

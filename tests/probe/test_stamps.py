import socket
import struct

from hypothesis import given
from hypothesis import strategies as st

from linkrover.probe import stamps
from linkrover.probe.stamps import PathError, SentStamp

from .exchange import udp

STAMP = (socket.SOL_SOCKET, stamps.SO_TIMESTAMPING, struct.pack("=6q", 1_795_000_000, 5, 0, 0, 0, 0))


def extended_error(number=0, origin=4, key=7):
    return (socket.IPPROTO_IP, stamps.IP_RECVERR, struct.pack("=IBBBBII", number, origin, 0, 0, 0, 0, key) + bytes(16))


def test_stamps_of_both_widths_and_both_options_are_read():
    assert stamps.stamp_of([STAMP]) == 1_795_000_000 * 10**9 + 5
    assert stamps.stamp_of([(socket.SOL_SOCKET, stamps.SO_TIMESTAMPING, struct.pack("=6i", 9, 5, 0, 0, 0, 0))]) == (
        9 * 10**9 + 5
    )
    assert stamps.stamp_of([(socket.SOL_SOCKET, stamps.SO_TIMESTAMPNS, struct.pack("=qq", 9, 5))]) == 9 * 10**9 + 5
    assert stamps.stamp_of([(socket.SOL_SOCKET, stamps.SO_TIMESTAMPING, bytes(48))]) is None, "zero = not given"
    assert stamps.stamp_of([]) is None


def test_an_error_queue_entry_is_a_send_stamp_or_an_icmp_error():
    assert stamps.queue_entry([STAMP, extended_error()]) == SentStamp(7, 1_795_000_000 * 10**9 + 5)
    assert stamps.queue_entry([extended_error(number=111, origin=2)]) == PathError(111)
    assert stamps.queue_entry([extended_error()]) is None, "a stamp's entry without its stamp"
    assert stamps.queue_entry([]) is None


@given(st.lists(st.tuples(st.sampled_from([0, 1, 41]), st.sampled_from([11, 25, 35, 37]), st.binary(max_size=60))))
def test_any_control_messages_are_read_or_passed_over(ancillary):
    stamps.stamp_of(ancillary)
    stamps.queue_entry(ancillary)


def test_the_kernel_counts_sends_from_zero_again_each_time_stamps_are_asked_for():
    sock, peer = udp(), udp()
    for _ in range(2):
        assert stamps.wants_send_stamps(sock)
        for _ in range(3):
            sock.sendto(b"x", peer.getsockname())
        keys = []
        for _ in range(1000):
            keys += [e.key for e in stamps.read_error_queue(sock)]
            if len(keys) == 3:
                break
        assert keys == [0, 1, 2]
    sock.close()
    peer.close()


def test_the_clock_error_is_what_the_kernel_says_or_16_seconds():
    estimate = stamps.clock_error()
    assert estimate.multiplier > 0
    assert estimate.synchronized or estimate.error_ns >= 16e9


def test_both_clocks_are_read_together():
    first, second = stamps.pair(), stamps.pair()
    assert second.mono_ns > first.mono_ns

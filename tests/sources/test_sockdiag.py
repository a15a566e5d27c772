"""TCP connections one by one: real ones against `ss` and the socket's own TCP_INFO, and hostile bytes."""

from __future__ import annotations

import os
import re
import shutil
import socket
import struct
import subprocess
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.errors import ParseError
from linkrover.records import Now, TcpConnection, Unknown
from linkrover.sources.netlink import pack
from linkrover.sources.sockdiag import TcpConnections, parse_address, parse_connection, parse_end, parse_tcp_info
from linkrover.sources.socket_process import ProcessNames

AT = Now(1, 2)


class Pair:
    """A connection over the loopback interface; what was sent stays with the receiver unread."""

    def __init__(self, address: str = "127.0.0.1", family: int = socket.AF_INET) -> None:
        self.listener = socket.create_server((address, 0), family=family)
        self.client = socket.create_connection(self.listener.getsockname()[:2])
        self.server, _ = self.listener.accept()

    @property
    def ports(self) -> tuple[int, int]:
        return self.client.getsockname()[1], self.server.getsockname()[1]

    def close(self) -> None:
        for one in (self.client, self.server, self.listener):
            one.close()


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    made.close()


@pytest.fixture
def connections() -> Iterator[TcpConnections]:
    made = TcpConnections("lo")
    yield made
    made.close()


def mine(connections: TcpConnections, pair: Pair) -> TcpConnection:
    local, remote = (f":{port}" for port in pair.ports)
    return next(one for one in connections.read() if one.local.endswith(local) and one.remote.endswith(remote))


def test_a_connections_bytes_and_queues_are_those_sent(connections: TcpConnections, pair: Pair):
    pair.client.sendall(bytes(50_000))
    found = mine(connections, pair)
    assert found.state == "established"
    assert found.local == f"127.0.0.1:{pair.ports[0]}"
    assert found.bytes_sent == 50_000
    assert found.bytes_acked + found.send_queue_bytes in (50_000, 50_001)  # acknowledged or waiting; the SYN counts
    assert pair.server.recv(50_000, socket.MSG_WAITALL)
    other = next(one for one in connections.read() if one.local == found.remote and one.remote == found.local)
    assert other.bytes_received == 50_000
    assert other.receive_queue_bytes == 0


def test_the_figures_are_those_of_the_sockets_own_tcp_info(connections: TcpConnections, pair: Pair):
    pair.client.sendall(b"x" * 1000)
    pair.server.recv(1000)
    info = parse_tcp_info(pair.client.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256))
    found = mine(connections, pair)
    for field in ("rtt_us", "rtt_var_us", "min_rtt_us", "congestion_window", "reordering", "retransmits", "bytes_sent"):
        assert getattr(found, field) == info[field], field
    assert found.rtt_us > 0
    name = pair.client.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16)
    assert found.congestion_control == name.rstrip(b"\0").decode()


def test_ss_says_the_same(connections: TcpConnections, pair: Pair):
    if shutil.which("ss") is None:
        pytest.skip("ss is not installed (Debian package iproute2)")
    pair.client.sendall(b"x" * 1000)
    pair.server.recv(1000)
    found = mine(connections, pair)
    text = subprocess.run(
        ["ss", "-tinH", "sport", "=", f":{pair.ports[0]}"], capture_output=True, text=True, check=True
    ).stdout
    assert f"cwnd:{found.congestion_window}" in text
    assert f"bytes_sent:{found.bytes_sent}" in text
    rtt = re.search(r"\brtt:([0-9.]+)/([0-9.]+)", text)
    assert float(rtt[1]) == pytest.approx(found.rtt_us / 1000)
    assert found.congestion_control in text
    if found.congestion_control == "bbr":
        bandwidth = re.search(r"bbr:\(bw:([0-9.]+)", text)
        assert bandwidth
        assert found.bbr_bandwidth_bps == pytest.approx(float(bandwidth[1]), rel=0.05)


def test_the_process_is_named(connections: TcpConnections, pair: Pair):
    found = mine(connections, pair)
    assert found.process.endswith(f"[{os.getpid()}]")


def test_another_users_process_is_not_permitted_rather_than_nameless():
    if os.getuid() != 0:
        pytest.skip("needs root to become another user")
    made = Pair()
    reader, writer = os.pipe()
    child = os.fork()  # not a new program: the other user may not be let into the folder of the checkout
    if child == 0:
        try:
            port = made.ports[0]
            made.close()  # this process's copies, else it would find itself
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            for one in TcpConnections("lo").read():
                if one.local.endswith(f":{port}"):
                    os.write(writer, f"{one.process} {one.unknown['process'].value} {one.rtt_us}".encode())
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        told = pipe.read()
    os.waitpid(child, 0)
    made.close()
    name, _, rest = told.partition(" ")
    assert name == "None"
    assert rest.startswith("not permitted ")
    assert int(rest.split()[-1]) > 0  # reading the connection itself needs no privilege


def test_ipv6_and_ipv4_through_an_ipv6_socket_are_told_apart(connections: TcpConnections):
    listener = socket.create_server(("::", 0), family=socket.AF_INET6, dualstack_ipv6=True)
    port = listener.getsockname()[1]
    clients = [socket.create_connection(("127.0.0.1", port)), socket.create_connection(("::1", port))]
    servers = [listener.accept()[0] for _ in clients]
    locals_ = {one.local for one in connections.read()}
    assert f"127.0.0.1:{port}" in locals_
    assert f"[::1]:{port}" in locals_
    for one in (*clients, *servers, listener):
        one.close()


def test_a_listening_socket_is_no_connection(connections: TcpConnections):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        assert not [one for one in connections.read() if one.local.endswith(f":{port}")]


def test_an_interface_that_is_not_there_has_no_connections():
    absent = TcpConnections("nobody0")
    assert absent.read() == []
    absent.close()


def test_a_new_socket_waits_for_the_next_walk_of_proc(pair: Pair):
    names = ProcessNames()
    inode = os.fstat(pair.client.fileno()).st_ino
    assert names.names({inode})[inode].endswith(f"[{os.getpid()}]")
    later = socket.socket()
    assert names.names({os.fstat(later.fileno()).st_ino}) == {}
    later.close()


def tcp_info(length: int) -> bytes:
    data = bytearray(length)
    struct.pack_into("=I", data, 68, 1500)
    struct.pack_into("=I", data, 80, 10)
    return bytes(data)


def test_a_shorter_tcp_info_of_an_older_kernel_gives_what_it_holds():
    found = parse_tcp_info(tcp_info(104))
    assert found["rtt_us"] == 1500
    assert "bytes_acked" not in found
    payload = bytes([socket.AF_INET, 1]) + bytes(70) + pack(2, tcp_info(104))
    record = parse_connection(payload, AT, "wlan0")
    assert record.bytes_acked is None
    assert record.unknown["bytes_acked"] is Unknown.UNSUPPORTED
    assert record.unknown["min_rtt_us"] is Unknown.NO_BASE
    assert record.unknown["process"] is Unknown.ABSENT  # inode 0: no process holds it


def test_values_that_mean_not_measured_are_unknown():
    data = bytearray(tcp_info(232))
    struct.pack_into("=Q", data, 104, 2**64 - 1)
    struct.pack_into("=I", data, 148, 2**32 - 1)
    struct.pack_into("=I", data, 68, 0)
    found = parse_tcp_info(bytes(data))
    assert not {"pacing_rate_bps", "min_rtt_us", "rtt_us", "delivery_rate_bps"} & found.keys()


@pytest.mark.parametrize(
    "payload",
    [b"", bytes(71), bytes([99]) + bytes(71), bytes([2, 1]) + bytes(70) + b"\xff\xff\x02\x00"],
)
def test_a_damaged_answer_is_a_parse_error(payload: bytes):
    with pytest.raises(ParseError):
        parse_connection(payload, AT, "wlan0")


@given(st.binary(max_size=150), st.sampled_from([socket.AF_INET, socket.AF_INET6]))
@settings(max_examples=200)
def test_any_bytes_are_a_connection_or_a_parse_error(tail: bytes, family: int):
    for data in (tail, bytes([family, 1]) + bytes(70) + tail, bytes([family]) + bytes(71) + pack(2, tail)):
        try:
            parse_connection(data, AT, "wlan0")
        except ParseError:
            continue
        assert parse_end(data).family in (socket.AF_INET, socket.AF_INET6)


@given(st.binary(max_size=60))
@settings(max_examples=100)
def test_any_bytes_are_an_address_or_a_parse_error(data: bytes):
    try:
        found = parse_address(data)
    except ParseError:
        return
    assert found is None or len(found[1]) in (4, 16)

from __future__ import annotations

import contextlib
import socket
import time

import pytest

from linkrover.errors import ConfigError
from linkrover.ros1.graph import Parameters
from linkrover.ros1.node import Ros1
from linkrover.ros1.rpc import Rpc, RpcError

from .conftest import Master


def test_a_silent_peer_costs_its_time_out_and_no_more() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        began = time.monotonic()
        with pytest.raises(RpcError, match="timed out"):
            Rpc(f"http://127.0.0.1:{silent.getsockname()[1]}", "/test", 0.3).call("getPid")
        assert time.monotonic() - began < 30


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\n<xm<", b"\x00\xff" * 50])
def test_a_peer_that_talks_nonsense_is_an_rpc_error(answer: bytes) -> None:
    import threading

    with socket.create_server(("127.0.0.1", 0)) as server:

        def talk() -> None:
            with contextlib.suppress(OSError):  # the test ends first
                for _ in range(2):  # the client tries a second time when a kept connection breaks
                    connection, _ = server.accept()
                    with connection:
                        connection.recv(4096)
                        connection.sendall(answer)

        threading.Thread(target=talk, daemon=True).start()
        with pytest.raises(RpcError):
            Rpc(f"http://127.0.0.1:{server.getsockname()[1]}", "/test", 2.0).call("getPid")


def test_a_master_answers_and_says_what_it_does_not_know(master: Master) -> None:
    rpc = Rpc(master.uri, "/test")
    assert isinstance(rpc.call("getPid"), int)
    with pytest.raises(RpcError, match="unknown node"):
        rpc.call("lookupNode", "/nobody")


def test_private_parameters_come_before_the_namespaces_and_those_before_global_ones(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    rpc = Rpc(master.uri, "/test")
    found = Parameters("node", ["__ns:=/robot", "_given:=[1, 2]"])
    assert found.get("rate") is None
    for key, value in (("/rate", 1), ("/robot/rate", 2), ("/robot/node/rate", 3)):
        rpc.call("setParam", key, value)
        assert found.get("rate") == value
    assert found.get("given") == [1, 2]


@pytest.mark.parametrize("name", ["", "2fast", "a/b", "a b"])
def test_a_name_no_ros_node_can_have_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="cannot be a ROS node name"):
        Ros1(name)

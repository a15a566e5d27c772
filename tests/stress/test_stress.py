import json
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.errors import ConfigError, ParseError
from linkrover.loop import Loop
from linkrover.probe.reflector import StampReflector
from linkrover.stress import client as client_module
from linkrover.stress import load, protocol
from linkrover.stress.client import StressClient
from linkrover.stress.protocol import Ask, Attach, Consent, Hello, Line, Load, Refusal, StressError
from linkrover.stress.server import StressServer

TOKEN = b"the token both ends agreed on"
HAS_NAMESPACES = os.geteuid() == 0 and subprocess.run(["which", "tc"], capture_output=True).returncode == 0


@contextmanager
def reflecting():
    loop = Loop()
    reflector = StampReflector(loop, "127.0.0.1", 0)
    reflector.start()
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        yield reflector
    finally:
        loop.stop()
        thread.join(10)
        reflector.stop()
        loop.close()


@pytest.fixture
def server():
    with reflecting() as reflector:
        said = []
        one = StressServer(
            TOKEN, "127.0.0.1", 0, reflector_port=reflector.port, seconds_most=5, rate_bps_most=50e6,
            on_event=said.append,
        )  # fmt: skip
        one.said = said
        one.start()
        yield one
        one.stop()


def client_of(server, token=TOKEN, **options):
    return StressClient("127.0.0.1", token, server.port, **options)


def dial(server):
    line = Line(socket.create_connection(("127.0.0.1", server.port), timeout=5), 5)
    return line, line.receive()


def ended(sock):
    """Whether the other end has closed."""
    try:
        return sock.recv(10) == b""
    except ConnectionResetError:
        return True


def wait_for(condition, timeout_s=20):
    ends = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < ends, "the condition was not met in time"
        time.sleep(0.01)


@pytest.mark.parametrize("name", ["camera", "tcp", "udp"])
def test_every_phase_gives_throughput_both_ways_and_probes(server, name, monkeypatch):
    monkeypatch.setattr(client_module, "PAUSE_S", 0.1)
    client = client_of(server)
    client.connect()
    seen = []
    report = client.run(load.profile(name), seconds=0.5, on_phase=seen.append)
    client.close()
    assert seen == ["idle", "up", "down", "both"]
    idle, up, down, both = report.phases
    assert idle.up_bps is idle.down_bps is idle.buffer_delay is None
    for phase in report.phases:
        assert phase.probes.answered > 0
        assert phase.errors == ()
    assert up.down_bps is None
    assert down.up_bps is None
    for rate in (up.up_bps, down.down_bps, both.up_bps, both.down_bps):
        if name == "tcp":
            assert rate > 20e6
        else:
            assert rate == pytest.approx(load.PROFILES[name].rate_bps, rel=0.25)
    if name == "udp":
        for lost in (up.up_lost, down.down_lost, both.up_lost, both.down_lost):
            assert lost < 0.1
    if name == "camera":
        assert up.frames_sent + up.frames_dropped == pytest.approx(15, abs=2)
    assert up.buffer_delay is not None
    assert report.probe_overhead_bps == 50 * 72 * 8
    assert server.counters.phases == 3
    assert "127.0.0.1 is through" in server.said[-1] or wait_for(lambda: "is through" in server.said[-1]) is None


def test_a_wrong_token_is_refused_and_nothing_is_sent(server):
    client = client_of(server, b"quite another token here")
    with pytest.raises(StressError, match="wrong consent token"):
        client.connect()
    client.close()
    assert server.counters.wrong_token == 1
    assert server.counters.phases == 0


def test_a_peer_that_cannot_prove_the_token_gets_no_load():
    """Someone else listens at the address: it says yes to anything."""
    listener = socket.create_server(("127.0.0.1", 0))

    def impostor():
        line = Line(listener.accept()[0], 5)
        line.send(Hello(protocol=1, version="9", nonce="00", seconds_most=60, rate_bps_most=1e9))
        line.receive()
        line.send(Consent(mac="ff" * 32, session="00" * 16, udp_port=9))
        line.close()

    thread = threading.Thread(target=impostor)
    thread.start()
    client = StressClient("127.0.0.1", TOKEN, listener.getsockname()[1])
    with pytest.raises(StressError, match="nothing is sent to it"):
        client.connect()
    client.close()
    thread.join(10)
    listener.close()


def test_no_server_a_foreign_server_and_one_that_goes_away_say_what_to_do():
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    for greeting, expected in ((b"SSH-2.0-OpenSSH_9.2\r\n", "no consent server"), (b"", "went away")):

        def answer(data=greeting):
            sock = listener.accept()[0]
            sock.sendall(data)
            sock.close()

        thread = threading.Thread(target=answer)
        thread.start()
        client = StressClient("127.0.0.1", TOKEN, port)
        with pytest.raises(StressError, match=expected):
            client.connect()
        client.close()
        thread.join(10)
    listener.close()
    with pytest.raises(StressError, match="--allow-stress"):
        StressClient("127.0.0.1", TOKEN, port).connect()


def test_one_client_at_a_time_and_its_stay_ends_with_its_connection(server):
    first, second = client_of(server), client_of(server)
    first.connect()
    with pytest.raises(StressError, match="another stress run"):
        second.connect()
    second.close()
    first.close()

    def free():
        again = client_of(server)
        try:
            again.connect()
        except StressError:
            return False
        finally:
            again.close()
        return True

    wait_for(free)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        (Load(profile="bulk", up=True, down=False, seconds=6), "at most 5 s"),
        (Load(profile="bulk", up=True, down=False, seconds=float("1e300")), "at most 5 s"),
        (Load(profile="bulk", up=True, down=False, seconds=-1), "at most 5 s"),
        (Load(profile="udp", up=True, down=True, seconds=1, rate_bps=60e6), "at most 50"),
        (Load(profile="camera", up=True, down=True, seconds=1, rate_bps=60e6), "at most 50"),
        (Load(profile="flood", up=True, down=True, seconds=1), "must be one of"),
        (Load(profile="bulk", up=True, down=True, seconds=1, rate_bps=1e6), "as fast as it can"),
    ],
)
def test_the_server_bounds_what_it_consents_to(server, request_, expected):
    client = client_of(server)
    client.connect()
    client._line.send(request_)
    answer = client._line.receive()
    assert isinstance(answer, Refusal)
    assert expected in answer.reason
    client.close()


def test_a_data_connection_needs_the_sessions_secret(server):
    client = client_of(server)
    client.connect()
    client._line.send(Load(profile="bulk", up=False, down=True, seconds=1))
    client._line.receive()
    for secret in ("", "00" * 16, "\udcff".encode("utf-8", "replace").decode()):
        line, _ = dial(server)
        line.send(Attach(session=secret, up=False))
        assert ended(line.sock)
        line.close()
    assert server.counters.refused == 3
    client.close()


def test_garbage_and_overlong_lines_are_counted_and_closed(server):
    for data in (
        b"GET / HTTP/1.1\r\n\r\n",
        b"x" * 10_000,
        b"[]\n",
        b'{"type":"Load"}\n',
        b"\xff\xfe\n",
        b"[" * 4000 + b"\n",
    ):
        line, _ = dial(server)
        line.sock.sendall(data)
        assert ended(line.sock)
        line.close()
    wait_for(lambda: server.counters.malformed == 6)
    client = client_of(server)
    client.connect()
    client.close()


def test_many_silent_connections_do_not_pile_up(server):
    silent = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(40)]
    wait_for(lambda: server.counters.connections == 40)
    assert server.counters.refused == 24
    for sock in silent:
        sock.close()
    wait_for(lambda: _connects(server))


def _connects(server):
    client = client_of(server)
    try:
        client.connect()
    except (StressError, OSError):
        return False
    finally:
        client.close()
    return True


@given(st.binary(max_size=300))
def test_any_line_is_a_message_or_a_parse_error(line):
    try:
        protocol.decode(line)
    except ParseError:
        return


def test_messages_survive_the_line():
    ask = Ask(protocol=1, version="1", nonce="ab", mac="cd")
    assert protocol.decode(protocol.encode(ask)) == ask


def test_a_proof_is_of_one_side_one_token_and_one_pair_of_nonces():
    mac = protocol.proof(TOKEN, "client", "a", "b")
    assert protocol.proves(mac, TOKEN, "client", "a", "b")
    assert not protocol.proves(mac, TOKEN, "server", "a", "b")
    assert not protocol.proves(mac, TOKEN, "client", "b", "a")
    assert not protocol.proves(mac, b"another", "client", "a", "b")
    assert not protocol.proves("é", TOKEN, "client", "a", "b")


def test_short_tokens_and_wrong_profiles_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="at least 16"):
        StressServer(b"short")
    (tmp_path / "t").write_text("short\n")
    with pytest.raises(ConfigError, match="openssl rand"):
        protocol.load_token(tmp_path / "t")
    with pytest.raises(ConfigError, match="cannot read"):
        protocol.load_token(tmp_path / "absent")
    with pytest.raises(ConfigError, match="one of camera"):
        load.profile("flood")
    with pytest.raises(ConfigError, match="a rate is for"):
        load.profile("bulk", 1e6)


def test_an_agent_consents_with_a_token_file(tmp_path):
    from linkrover.agent import Agent, AgentConfig
    from linkrover.agent.config import Reflector, Stress

    path = tmp_path / "token"
    path.write_bytes(TOKEN + b"\n")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    agent = Agent(
        AgentConfig(
            reflect=True, reflector=Reflector(host="127.0.0.1", port=0), stress=Stress(token_file=str(path), port=port)
        )
    )
    agent.start()
    thread = threading.Thread(target=agent.run)
    thread.start()
    try:
        client = StressClient("127.0.0.1", TOKEN, port)
        client.connect()
        assert client.probe_port() == agent.reflector.port
        [idle] = client.run(load.profile("camera"), seconds=0.3, phases=("idle",)).phases
        assert idle.probes.answered > 0
        client.close()
    finally:
        agent.request_stop()
        thread.join(20)
    with pytest.raises(StressError, match="no consent server"):
        StressClient("127.0.0.1", TOKEN, port).connect()


def run(*args, **options):
    return subprocess.run(args, capture_output=True, text=True, timeout=90, **options)


@contextmanager
def narrow_link():
    """Two namespaces; what robot sends passes 8 Mbit/s with a queue of 100 kB, some 100 ms."""
    robot, station = f"lrs{os.getpid()}a", f"lrs{os.getpid()}b"
    try:
        for name in (robot, station):
            run("ip", "netns", "add", name, check=True)
        run(
            "ip",
            "link",
            "add",
            "v0",
            "netns",
            robot,
            "type",
            "veth",
            "peer",
            "name",
            "v0",
            "netns",
            station,
            check=True,
        )
        for name, address in ((robot, "10.79.0.1/24"), (station, "10.79.0.2/24")):
            run("ip", "-n", name, "address", "add", address, "dev", "v0", check=True)
            run("ip", "-n", name, "link", "set", "v0", "up", check=True)
        run("tc", "-n", robot, "qdisc", "add", "dev", "v0", "root", "tbf", "rate", "8mbit", "burst", "10kb", "limit",
            "100kb", check=True)  # fmt: skip
        yield ("ip", "netns", "exec", robot), ("ip", "netns", "exec", station)
    finally:
        for name in (robot, station):
            run("ip", "netns", "delete", name)


@pytest.mark.netns
@pytest.mark.skipif(not HAS_NAMESPACES, reason="needs root and iproute2 (ip, tc) to make a link")
def test_a_link_local_ipv6_peer_can_be_loaded_by_udp(tmp_path):
    linkrover = (sys.executable, "-m", "linkrover")
    (tmp_path / "token").write_bytes(TOKEN)
    with narrow_link() as (robot, station):
        run(*robot, "ip", "address", "add", "fe80::76/64", "dev", "v0", "nodad", check=True)
        run(*station, "ip", "address", "add", "fe80::77/64", "dev", "v0", "nodad", check=True)
        reflector = subprocess.Popen(
            [*station, *linkrover, "reflect", "--stress-token-file", str(tmp_path / "token")],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            reflector.stdout.readline()
            done = run(*robot, *linkrover, "stress", "fe80::77%v0", "--profile", "udp", "--rate", "2", "--seconds", "1",
                       "--json", "--phase", "both", "--token-file", str(tmp_path / "token"))  # fmt: skip
            assert done.returncode == 0, done.stderr
            [both] = json.loads(done.stdout)["phases"]
            assert both["up_lost"] < 0.2
            assert both["down_lost"] < 0.2
        finally:
            reflector.terminate()
            reflector.communicate(timeout=20)


@pytest.mark.netns
@pytest.mark.skipif(not HAS_NAMESPACES, reason="needs root and iproute2 (ip, tc) to make a narrow link")
def test_the_command_sees_the_queue_of_a_narrow_link_fill_in_one_direction_only():
    linkrover = (sys.executable, "-m", "linkrover")
    with narrow_link() as (robot, station):
        reflector = subprocess.Popen(
            [*station, *linkrover, "reflect", "--allow-stress"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True,
        )  # fmt: skip
        try:
            token = reflector.stderr.readline().rpartition("token: ")[2].strip()
            environment = {**os.environ, "LINKROVER_STRESS_TOKEN": token}
            phases = ("--phase", "idle", "--phase", "up", "--phase", "down")
            options = ("--profile", "udp", "--rate", "12", "--json", "--seconds", "1.5", *phases)
            done = run(*robot, *linkrover, "stress", "10.79.0.2", *options, env=environment)
            assert done.returncode == 0, done.stderr
            idle, up, down = json.loads(done.stdout)["phases"]
            assert idle["probes"]["rtt"]["median_ns"] < 20e6
            assert 6e6 < up["up_bps"] < 8.5e6, "what the narrow link lets through"
            assert up["up_lost"] > 0.1
            assert up["probes"]["rtt"]["median_ns"] > 50e6, "the queue of the robot's own side"
            assert up["buffer_delay"] > 2
            assert down["down_bps"] > 10e6, "the other direction is not narrowed"
            assert down["down_lost"] < 0.1
            refused = run(*robot, *linkrover, "stress", "10.79.0.2", env={**environment, "LINKROVER_STRESS_TOKEN": ""})
            assert refused.returncode == 2
            assert "--allow-stress" in refused.stderr
        finally:
            reflector.terminate()
            reflector.communicate(timeout=20)
        assert reflector.returncode == 0

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

LINKROVER = [sys.executable, "-m", "linkrover"]
HAS_NAMESPACES = os.geteuid() == 0 and subprocess.run(["which", "ip"], capture_output=True).returncode == 0
needs_namespaces = pytest.mark.skipif(not HAS_NAMESPACES, reason="needs root and iproute2 to make network namespaces")


def read_until(process, pattern):
    """The first line that matches."""
    for line in process.stdout:
        found = re.search(pattern, line)
        if found:
            return found
    raise AssertionError(f"ended without a line like {pattern}: {process.stderr.read()}")


@contextmanager
def started(*args, prefix=()):
    process = subprocess.Popen(
        [*prefix, *LINKROVER, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)


@contextmanager
def reflecting(*args, prefix=()):
    with started("reflect", "--port", "0", *args, prefix=prefix) as process:
        yield process, read_until(process, r"answering on [\d.]+:(\d+)")[1]


def probe(*args, prefix=()):
    return subprocess.run([*prefix, *LINKROVER, "probe", *args], capture_output=True, text=True, timeout=60)


def test_probe_shows_each_answer_and_a_summary_and_reflect_its_counters():
    with reflecting() as (reflector, port):
        done = probe(f"127.0.0.1:{port}", "--count", "5", "--rate", "10")
        assert done.returncode == 0, done.stderr
        assert len(re.findall(r"^seq=\d rtt=\d+\.\d us$", done.stdout, re.MULTILINE)) == 5
        assert "sent 5, answered 5, lost 0" in done.stdout
        assert "clocks: sent kernel 5; received kernel 5" in done.stdout
        reflector.send_signal(signal.SIGINT)
        assert "received 5, answered 5" in reflector.stdout.read()
        assert reflector.wait(10) == 0


def test_json_is_one_object_and_a_thousand_a_second_prints_a_line_a_second(tmp_path):
    key = tmp_path / "key"
    key.write_text("an agreed key of the two ends\n")
    with reflecting("--key-file", str(key)) as (_, port):
        target = ("127.0.0.1", "--port", port, "--key-file", str(key))
        done = probe(*target, "--count", "20", "--rate", "100", "--size", "300", "--json")
        document = json.loads(done.stdout)
        assert document["summary"]["answered"] == document["summary"]["sent"] > 0
        assert document["summary"]["rtt"]["median_ns"] > 0
        assert document["packet_bytes"] == 300
        done = probe(*target, "--duration", "1.2", "--rate", "1000")
        assert done.returncode == 0
        assert len(done.stdout.splitlines()) < 20
        assert "last second:" in done.stdout


def test_nothing_answered_is_exit_status_1_and_says_why(tmp_path):
    with reflecting() as (reflector, port):
        reflector.send_signal(signal.SIGINT)
        reflector.wait(10)
    done = probe("127.0.0.1", "--port", port, "--count", "2", "--deadline", "0.3")
    assert done.returncode == 1
    assert f"nothing listens on UDP port {port} there" in done.stderr
    assert "linkrover reflect" in done.stderr


def test_wrong_usage_is_exit_status_2_and_names_the_range():
    done = probe("127.0.0.1", "--rate", "5000")
    assert done.returncode == 2
    assert "from 1 to 1000" in done.stderr
    assert probe().returncode == 2


def test_ctrl_c_ends_an_open_run_with_its_summary():
    with reflecting() as (_, port), started("probe", f"127.0.0.1:{port}") as process:
        read_until(process, "seq=3")
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
        assert process.wait(10) == 0
        assert "round trip: min" in rest


@contextmanager
def two_hosts():
    """Two namespaces joined by a veth pair, 10.77.0.1 and 10.77.0.2."""
    one, two = f"lrp{os.getpid()}a", f"lrp{os.getpid()}b"

    def ip(*args):
        subprocess.run(["ip", *args], check=True, capture_output=True)

    try:
        for name in (one, two):
            ip("netns", "add", name)
        ip("link", "add", "v0", "netns", one, "type", "veth", "peer", "name", "v0", "netns", two)
        for name, address in ((one, "10.77.0.1/24"), (two, "10.77.0.2/24")):
            ip("-n", name, "address", "add", address, "dev", "v0")
            ip("-n", name, "link", "set", "v0", "up")
            ip("-n", name, "link", "set", "lo", "up")
        yield one, two, ip
    finally:
        for name in (one, two):
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)


@needs_namespaces
@pytest.mark.netns
def test_an_interface_going_down_and_an_address_changing_do_not_end_the_measurement():
    with two_hosts() as (robot, station, ip):
        inside = ("ip", "netns", "exec", station)
        with reflecting(prefix=inside) as (_, port):
            arguments = (
                "probe", f"10.77.0.2:{port}", "--rate", "50", "--duration", "3", "--deadline", "0.5", "--json",
            )  # fmt: skip
            with started(*arguments, prefix=("ip", "netns", "exec", robot)) as process:
                time.sleep(1.0)
                ip("-n", robot, "link", "set", "v0", "down")
                time.sleep(0.4)
                ip("-n", robot, "address", "flush", "dev", "v0")
                ip("-n", robot, "address", "add", "10.77.0.9/24", "dev", "v0")
                ip("-n", robot, "link", "set", "v0", "up")
                document = json.loads(process.stdout.read())
                assert process.wait(20) == 0
        summary = document["summary"]
        assert summary["not_sent"] > 0, "the network was unreachable for a while"
        assert summary["answered"] > 20
        assert document["reflector"]["restarts"] == 1, "from the new address it is a new session"
        assert summary["sent"] + summary["not_sent"] + document["sender"]["missed_slots"] == 150


@needs_namespaces
@pytest.mark.netns
def test_a_link_local_ipv6_peer_is_reached_by_its_zone():
    with two_hosts() as (robot, station, ip):
        for name, address in ((robot, "fe80::76/64"), (station, "fe80::77/64")):
            ip("-n", name, "address", "add", address, "dev", "v0", "nodad")
        with reflecting(prefix=("ip", "netns", "exec", station)) as (_, port):
            done = probe(f"[fe80::77%v0]:{port}", "--count", "3", prefix=("ip", "netns", "exec", robot))
            assert done.returncode == 0, done.stderr
            assert "sent 3, answered 3" in done.stdout

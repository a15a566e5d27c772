import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from linkrover.doctor.examine import Examination
from linkrover.doctor.finding import Check, Finding, Status, judged, ok, run_checks
from linkrover.doctor.machine import Machine
from linkrover.doctor.render import as_json, as_lines, closing
from linkrover.errors import ConfigError, LinkRoverError

HAS_NAMESPACES = os.geteuid() == 0 and subprocess.run(["which", "ip"], capture_output=True).returncode == 0
LINKROVER = (sys.executable, "-m", "linkrover")


def test_a_check_that_breaks_is_shown_as_broken_and_the_others_go_on():
    def breaks():
        raise ZeroDivisionError("by nothing")

    def refused():
        raise LinkRoverError("the kernel refused")

    found = list(
        run_checks([Check("one", breaks), Check("two", refused), Check("three", lambda: [ok("three", "fine")] * 2)])
    )
    assert [f.status for f in found] == [Status.UNKNOWN, Status.UNKNOWN, Status.OK, Status.OK]
    assert found[0].failed
    assert "ZeroDivisionError: by nothing" in found[0].value
    assert not found[1].failed
    assert found[1].value == "the kernel refused"


def test_a_finding_shows_why_and_the_command_unbroken_only_where_something_is_to_be_done():
    command = "sudo sysctl -w " + "net.ipv4.something.long=1 " * 6
    bad = judged("buffers", Status.WARN, "too small " * 20, "because " * 20, command)
    lines = as_lines(bad, width=80)
    assert lines[0].startswith("WARN    buffers")
    assert lines[-1].endswith(command)
    assert all(len(line) <= 80 for line in lines[:-1])
    assert as_lines(ok("buffers", "large", "because")) == ["OK      buffers               large"]
    assert "\x1b[33m" in as_lines(bad, colour=True)[0]
    assert "\x1b" not in "".join(as_lines(ok("ssid", "evil\x1b[2Jname")))


def test_json_counts_each_verdict():
    found = [ok("a", "x"), Finding(check="b", status=Status.FAIL, value="y")]
    document = json.loads(as_json(found))
    assert document["counts"] == {"OK": 1, "WARN": 0, "FAIL": 1, "UNKNOWN": 0}
    assert document["findings"][1]["check"] == "b"
    assert closing(found) == "1 OK, 0 WARN, 1 FAIL, 0 UNKNOWN"


def test_facts_come_from_the_kernels_files(tmp_path):
    device = tmp_path / "sys/class/net/wlan0"
    (device / "phy80211").mkdir(parents=True)
    (device / "mtu").write_text("1492\n")
    (device / "flags").write_text("0x1003\n")
    (device / "ifindex").write_text("garbage\n")
    switch = tmp_path / "sys/class/bluetooth/hci0/rfkill3"
    switch.mkdir(parents=True)
    (switch / "soft").write_text("1\n")
    (switch / "hard").write_text("0\n")
    (tmp_path / "proc/sys/net/core").mkdir(parents=True)
    (tmp_path / "proc/sys/net/core/rmem_max").write_text("212992\n")
    (tmp_path / "proc/self").mkdir()
    (tmp_path / "proc/self/status").write_text("Name:\tx\nCapEff:\t0000000000001000\n")
    machine = Machine(tmp_path / "proc", tmp_path / "sys", tmp_path / "dev")
    assert machine.interfaces() == ["wlan0"]
    assert machine.is_wireless("wlan0")
    assert (machine.mtu("wlan0"), machine.multicast("wlan0"), machine.index("wlan0")) == (1492, True, None)
    assert machine.bluetooth() == (["hci0"], True)
    assert machine.sysctl("net.core.rmem_max") == "212992"
    assert machine.capabilities() == 1 << 12
    assert machine.tunnel() == (False, False)
    assert machine.clock_source() is None


def test_an_empty_machine_breaks_no_check(tmp_path):
    found = list(run_checks(Examination(machine=Machine(tmp_path, tmp_path, tmp_path), environ={}).checks()))
    assert not [f for f in found if f.failed]
    assert any("no network interface" in f.value for f in found)


def test_a_wrong_interface_name_proposes_those_there_are():
    with pytest.raises(ConfigError, match="lo"):
        Examination(interface="wlan99")


def test_every_part_of_the_page_is_there_on_this_machine():
    found = list(run_checks(Examination(interface="lo", environ={}).checks()))
    assert not [f for f in found if f.failed]
    names = {f.check for f in found}
    for name in (
        "driver and firmware", "MTU", "queue", "multicast", "fragmentation", "buffers", "subnets", "clock source",
        "clock synchronised", "ROS", "kernel time stamps", "reading the radio", "/dev/net/tun", "network namespaces",
    ):  # fmt: skip
        assert name in names
    assert any("not wireless" in f.value for f in found), "no radio: the page says so"


def run(*args, **options):
    return subprocess.run(args, capture_output=True, text=True, timeout=90, **options)


def ip(*args):
    run("ip", *args, check=True)


@contextmanager
def ailing_robot():
    """A robot with two interfaces in one subnet, a small MTU, no multicast; a station that reflects."""
    robot, station = f"lrd{os.getpid()}a", f"lrd{os.getpid()}b"
    try:
        for name in (robot, station):
            ip("netns", "add", name)
            ip("-n", name, "link", "set", "lo", "up")
        for device in ("w0", "w1"):
            ip("link", "add", device, "netns", robot, "type", "veth", "peer", "name", device, "netns", station)
        for name, device, address in (
            (robot, "w0", "10.76.0.1/24"), (robot, "w1", "10.76.0.11/24"), (station, "w0", "10.76.0.2/24"),
        ):  # fmt: skip
            ip("-n", name, "address", "add", address, "dev", device)
            ip("-n", name, "link", "set", device, "up")
        ip("-n", station, "link", "set", "w1", "up")
        ip("-n", robot, "link", "set", "w1", "mtu", "1000", "multicast", "off")
        yield ("ip", "netns", "exec", robot), ("ip", "netns", "exec", station)
    finally:
        for name in (robot, station):
            run("ip", "netns", "delete", name)


@pytest.mark.netns
@pytest.mark.skipif(not HAS_NAMESPACES, reason="needs root and iproute2 to make a robot with faults")
def test_the_command_finds_the_faults_of_an_ailing_robot_and_its_healthy_peer():
    environ = {**os.environ, "ROS_LOCALHOST_ONLY": "1"}
    with ailing_robot() as (robot, station):
        reflector = subprocess.Popen(
            [*station, *LINKROVER, "reflect", "--port", "0", "--stress-port", "0", "--allow-stress"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            stress_port, token = re.search(r"port (\d+); token: (\S+)", reflector.stderr.readline()).groups()
            port = re.search(r":(\d+)", reflector.stdout.readline())[1]
            environ["LINKROVER_STRESS_TOKEN"] = token
            done = run(
                *robot, *LINKROVER, "doctor", "--interface", "w1", "--peer", f"10.76.0.2:{port}", "--json",
                "--stress-port", stress_port, env=environ,
            )  # fmt: skip
            page = run(*robot, *LINKROVER, "doctor", "--interface", "w0", env=environ)
        finally:
            reflector.send_signal(signal.SIGINT)
            reflector.communicate(timeout=20)
    assert done.returncode == 1, done.stderr
    found = {}
    for finding in json.loads(done.stdout)["findings"]:
        assert not finding["failed"], finding
        found.setdefault(finding["check"], finding)
    assert found["subnets"]["status"] == "FAIL"
    assert "10.76.0.0/24" in found["subnets"]["value"]
    assert found["MTU"]["status"] == "FAIL"
    assert found["multicast"]["status"] == "WARN"
    assert found["route to the peer"]["status"] == "FAIL", "it goes by w0, not by w1"
    assert found["asymmetric routes"]["status"] in ("WARN", "FAIL"), "answers from 10.76.0.11 leave by w0"
    assert found["ROS 2 discovery"]["status"] == "FAIL"
    assert found["peer"]["status"] == "OK"
    assert found["round trip"]["status"] == "OK"
    assert found["large messages"]["status"] == "OK"
    assert found["clock offset"]["status"] == "OK"
    assert found["peer's version"]["status"] == "OK"
    assert found["buffer delay up"]["status"] in ("OK", "WARN")
    assert "-> sudo ip link set w1 down" in page.stdout
    assert page.returncode == 1
    assert re.search(r"\d+ OK, \d+ WARN, \d+ FAIL, \d+ UNKNOWN", page.stdout)


def test_a_silent_peer_fails_and_says_what_to_start(tmp_path):
    done = run(*LINKROVER, "doctor", "--interface", "lo", "--peer", "127.0.0.1:9")
    assert done.returncode == 1
    assert re.search(r"none of \d+ probes answered", done.stdout)
    assert "linkrover reflect" in done.stdout

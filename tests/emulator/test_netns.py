from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from linkrover.emulator import enter, netns
from linkrover.emulator.netns import NotPermittedError, check_tun, in_namespace, make_host
from linkrover.emulator.tap import Tap
from linkrover.probe.packet import DEFAULT_PORT

from .needs import as_nobody, packets

pytestmark = pytest.mark.netns


def test_the_devices_queue_is_as_long_as_asked(host):
    wanted = Path("/proc/thread-self/net/dev")
    assert in_namespace(host.netns_fd, lambda: "wlan0" in wanted.read_text())
    code = "print(open('/sys/class/net/wlan0/tx_queue_len').read())"
    command = [sys.executable, enter.__file__, str(host.netns_fd), "--", sys.executable, "-c", code]
    out = subprocess.run(command, pass_fds=[host.netns_fd], capture_output=True, text=True, check=True).stdout
    assert int(out) == netns.TX_QUEUE_PACKETS


@pytest.fixture
def host():
    packets()
    made = make_host("robot", "10.77.0.2")
    yield made
    made.close()


def namespaces_of_processes():
    found = set()
    for entry in Path("/proc").glob("[0-9]*/ns/net"):
        try:
            found.add(str(entry.readlink()))
        except OSError:
            continue
    return found


def test_a_host_has_loopback_and_one_device_and_this_process_stays_where_it_was(host):
    before = str(Path("/proc/self/ns/net").readlink())
    inside = in_namespace(host.netns_fd, lambda: sorted(name for _, name in socket.if_nameindex()))
    assert inside == ["lo", "wlan0"]
    assert str(Path("/proc/self/ns/net").readlink()) == before
    assert str(Path(f"/proc/self/fd/{host.netns_fd}").readlink()) != before


def test_packets_of_a_program_inside_arrive_at_the_device(host):
    handle = in_namespace(host.netns_fd, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    handle.sendto(b"hello", ("10.77.0.1", 9))
    handle.close()
    packet = os.read(host.tun_fd, 2048)
    assert packet.endswith(b"hello")
    assert packet[16:20] == bytes([10, 77, 0, 1])


def test_multicasts_leave_through_the_device_too(host):
    handle = in_namespace(host.netns_fd, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    handle.sendto(b"discovery", ("239.255.0.1", 7400))
    handle.close()
    while not (packet := os.read(host.tun_fd, 2048)).endswith(b"discovery"):
        pass
    assert packet[16:20] == bytes([239, 255, 0, 1])


def test_the_tap_tells_when_the_kernel_sent_a_probe_and_sees_nothing_else(host):
    tap = Tap(os.dup(host.tap_fd))
    handle = in_namespace(host.netns_fd, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    before = time.time_ns()
    for port in (9, DEFAULT_PORT):
        handle.sendto(b"probe", ("10.77.0.1", port))
    after = time.time_ns()
    handle.close()
    other, probe = os.read(host.tun_fd, 2048), os.read(host.tun_fd, 2048)
    assert tap.sent_ns(other) is None
    sent_ns = tap.sent_ns(probe)
    assert before <= sent_ns <= after
    assert tap.sent_ns(probe) is None
    tap.close()


def test_a_program_started_inside_sees_the_devices_of_its_namespace_in_sys_and_proc(host):
    code = "import os; print(sorted(os.listdir('/sys/class/net')), 'wlan0' in open('/proc/net/dev').read())"
    out = subprocess.run(
        [sys.executable, "-I", "-S", enter.__file__, str(host.netns_fd), "--", sys.executable, "-c", code],
        pass_fds=[host.netns_fd], capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert out.strip() == "['lo', 'wlan0'] True"


def test_a_program_dies_with_the_emulator_even_when_that_is_killed():
    starter = (
        "import subprocess, sys, time\n"
        f"child = subprocess.Popen([sys.executable, '-I', '-S', {enter.__file__!r}, '-1', '--', 'sleep', '60'],"
        " start_new_session=True)\n"
        "print(child.pid, flush=True)\ntime.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", starter], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    while Path(f"/proc/{child}/comm").read_text().strip() != "sleep":
        pass  # on its way through enter.py
    parent.kill()
    parent.wait()
    parent.stdout.close()
    for _ in range(500):
        try:
            state = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return
        if state == "Z":
            return
        subprocess.run(["sleep", "0.01"])
    raise AssertionError("the program outlived the killed emulator")


@pytest.mark.parametrize(
    ("arguments", "status"), [(["-1", "--", "/nonexistent"], 127), (["-1", "--", "/etc/hosts"], 126), (["x"], 1)]
)
def test_what_cannot_be_started_has_the_shells_status(arguments, status):
    done = subprocess.run([sys.executable, enter.__file__, *arguments], capture_output=True)
    assert done.returncode == status


def test_nothing_is_left_of_a_host_when_its_descriptors_are_closed():
    packets()
    made = make_host("robot", "10.77.0.2")
    name = str(Path(f"/proc/self/fd/{made.netns_fd}").readlink())
    made.close()
    assert name not in namespaces_of_processes()
    assert name not in Path("/proc/self/mountinfo").read_text()


def test_a_missing_or_closed_device_is_named_with_the_command_that_helps(tmp_path, monkeypatch):
    with pytest.raises(NotPermittedError, match=r"does not exist.*modprobe tun"):
        check_tun(str(tmp_path / "tun"))

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(netns.os, "open", refuse)
    with pytest.raises(NotPermittedError, match=r"permission to open /dev/net/tun.*sudo chmod 0666 /dev/net/tun"):
        check_tun()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("kernel.apparmor_restrict_unprivileged_userns", "1", "sudo sysctl -w kernel.apparmor_restrict_unprivileged_"),
        ("kernel.unprivileged_userns_clone", "0", "sudo sysctl -w kernel.unprivileged_userns_clone=1"),
        ("user.max_user_namespaces", "0", "sudo sysctl -w user.max_user_namespaces=10000"),
    ],
)
def test_a_sysctl_that_forbids_user_namespaces_is_named_with_its_command(name, value, expected, monkeypatch):
    real = Path.read_text
    asked = Path("/proc/sys") / name.replace(".", "/")

    def read(self, *args, **kwargs):
        if self == asked:
            return value + "\n"
        if self.is_relative_to("/proc/sys/kernel") or self.is_relative_to("/proc/sys/user"):
            raise FileNotFoundError
        return real(self, *args, **kwargs)

    monkeypatch.setattr(Path, "read_text", read)
    error = netns._no_userns(PermissionError(errno.EPERM, "Operation not permitted"))
    assert expected in error.grant
    assert name in error.missing


@pytest.mark.parametrize("lacking", ["net_admin", "sys_admin"])
def test_a_containers_root_without_a_capability_is_told_which(lacking):
    packets()
    code = "from linkrover.emulator.netns import why_not; print(why_not())"
    drop = ["setpriv", f"--bounding-set=-{lacking}", f"--inh-caps=-{lacking}"]
    done = subprocess.run([*drop, sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert f"needs CAP_{lacking.upper()}, which this container's root lacks" in done.stdout
    assert f"--cap-add={lacking.upper()}" in done.stdout


def test_an_ordinary_user_makes_hosts_where_the_device_is_open_to_him():
    packets()
    code = (
        "import os\nfrom linkrover.emulator.netns import become_namespace_root, make_host\n"
        "print(become_namespace_root(), os.getuid()); make_host('x', '10.77.0.9').close()\n"
    )
    with tempfile.TemporaryDirectory(prefix="lr-user-", dir="/tmp") as folder:
        command = as_nobody(0o666, [sys.executable, "-c", code], folder)
        done = subprocess.run(command, capture_output=True, text=True)
    if "user namespaces" in done.stderr:
        pytest.skip(f"this kernel or container forbids them: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["True", "0"]

"""Sets up the simulated air: radios in network namespaces, access points, stations, signal levels, traffic."""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from linkrover.records import EventKind, LinkEvent, ScanSnapshot
from linkrover.sources.nl80211 import Nl80211, RadioSample
from linkrover.sources.nl80211_events import RadioEvents
from linkrover.sources.nl80211_scan import Scanner

MODULE = Path("/guest-modules/mac80211_hwsim.ko")
DEBUG = Path("/sys/kernel/debug/ieee80211")
CLONE_NEWNET, CLONE_NEWNS = 0x40000000, 0x00020000
PASSPHRASE = "a link of robots"
FREQUENCIES = {1: 2412, 6: 2437, 11: 2462, 36: 5180, 40: 5200, 44: 5220, 48: 5240}

_libc = ctypes.CDLL(None, use_errno=True)


def run(*command: object, ns: str | None = None, check: bool = True) -> str:
    """A set-up command, in a namespace or not; its output."""
    prefix = ["ip", "netns", "exec", ns] if ns else []
    done = subprocess.run([*prefix, *map(str, command)], capture_output=True, text=True, timeout=30)
    if check and done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {done.stdout}{done.stderr}")
    return done.stdout


@contextlib.contextmanager
def inside(ns: str) -> Iterator[None]:
    """This thread in another network namespace."""
    home = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{ns}", os.O_RDONLY)
    try:
        _setns(there)
        yield
    finally:
        _setns(home)
        os.close(there)
        os.close(home)


def enter(ns: str) -> None:
    """This whole process into a namespace, with the /sys of it, as `ip netns exec` does."""
    there = os.open(f"/run/netns/{ns}", os.O_RDONLY)
    _setns(there)
    os.close(there)
    if _libc.unshare(CLONE_NEWNS):
        raise OSError(ctypes.get_errno(), "unshare")
    for command in (("mount", "--make-rslave", "/"), ("umount", "-l", "/sys"), ("mount", "-t", "sysfs", ns, "/sys")):
        subprocess.run(command, check=True)


def _setns(fd: int) -> None:
    if _libc.setns(fd, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "setns")


def wait_for(what: str, condition: Callable[[], object], timeout_s: float = 30.0, step_s: float = 0.05) -> object:
    """Wait until `condition()` is true; its value."""
    end = time.monotonic() + timeout_s
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > end:
            raise AssertionError(f"waited {timeout_s:g} s in vain for {what}")
        time.sleep(step_s)


class Radio:
    """One simulated radio: its phy, its interface, and the namespace it lives in."""

    def __init__(self, number: int, ns: str) -> None:
        self.number = number
        self.ns = ns
        self.iface = f"wlan{number}"
        self.phy = (Path("/sys/class/net") / self.iface / "phy80211/name").read_text().strip()
        self.mac = (Path("/sys/class/net") / self.iface / "address").read_text().strip()
        run("iw", "phy", self.phy, "set", "netns", "name", ns)

    def level(self, dbm: int) -> None:
        """Peers hear this radio at `dbm`, -100 to -1: its tx power is fixed at 0 dBm, and the rest is rx_rssi."""
        (DEBUG / self.phy / "hwsim" / "rx_rssi").write_text(str(dbm % 2**64))

    def address(self, address: str) -> None:
        """Give it an IPv4 address and bring it up."""
        run("ip", "address", "replace", address, "dev", self.iface, ns=self.ns)
        run("ip", "link", "set", self.iface, "up", ns=self.ns)
        run("iw", "dev", self.iface, "set", "txpower", "fixed", 0, ns=self.ns)
        self.level(-30)


class Daemon:
    """hostapd or wpa_supplicant in a namespace, with its log."""

    def __init__(self, command: list[str], ns: str, log: Path) -> None:
        self.log = log
        with log.open("wb") as out:
            self.process = subprocess.Popen(["ip", "netns", "exec", ns, *command], stdout=out, stderr=subprocess.STDOUT)

    def said(self, text: str) -> bool:
        """Whether the log holds it."""
        return text in self.log.read_text(errors="replace")

    def wait_said(self, text: str, timeout_s: float = 30.0) -> None:
        """Wait until the log holds it."""
        try:
            wait_for(text, lambda: self.said(text) or self.process.poll() is not None, timeout_s)
        except AssertionError as reason:
            raise AssertionError(f"{reason}\n{self.log.read_text(errors='replace')[-2000:]}") from None
        if not self.said(text):
            raise AssertionError(f"ended without saying {text}:\n{self.log.read_text(errors='replace')[-2000:]}")

    def stop(self, *, at_once: bool = False) -> None:
        """End it; at_once as a power cut would, without a farewell frame."""
        if self.process.poll() is None:
            if at_once:
                self.process.kill()
            else:
                self.process.terminate()
            self.process.wait(10)


class Air:
    """All that was set up, so that it can be taken down again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemons: list[Daemon] = []
        self._files = 0

    def access_point(
        self,
        radio: Radio,
        ssid: str,
        channel: int,
        *,
        passphrase: str | None = None,
        legacy: bool = False,
        more: str = "",
    ) -> Daemon:
        """Start hostapd and wait until it serves."""
        lines = [
            f"interface={radio.iface}",
            "driver=nl80211",
            f"ssid={ssid}",
            "country_code=US",
            f"hw_mode={'g' if channel < 15 else 'a'}",
            f"channel={channel}",
            f"ieee80211n={0 if legacy else 1}",
            f"wmm_enabled={0 if legacy else 1}",
            f"ctrl_interface=/run/hostapd-{radio.iface}",
            more,
        ]
        if passphrase:
            lines += ["wpa=2", f"wpa_passphrase={passphrase}", "wpa_key_mgmt=WPA-PSK", "rsn_pairwise=CCMP"]
        file = self._file("hostapd.conf", lines)
        daemon = self._start(["hostapd", str(file)], radio.ns)
        daemon.wait_said("AP-ENABLED")
        return daemon

    def station(
        self,
        radio: Radio,
        ssid: str,
        channels: list[int],
        *,
        passphrase: str | None = None,
        wait: bool = True,
        more: str = "",
    ) -> Daemon:
        """Start wpa_supplicant and wait until it is connected."""
        frequencies = " ".join(str(FREQUENCIES[channel]) for channel in channels)
        lines = [
            f"ctrl_interface=/run/wpa-{radio.iface}",
            "country=US",
            "network={",
            f'  ssid="{ssid}"',
            f"  scan_freq={frequencies}",
            f"  freq_list={frequencies}",
            f'  psk="{passphrase}"' if passphrase else "  key_mgmt=NONE",
            f"  {more}",
            "}",
        ]
        file = self._file("wpa.conf", lines)
        daemon = self._start(["wpa_supplicant", "-D", "nl80211", "-i", radio.iface, "-c", str(file)], radio.ns)
        if wait:
            daemon.wait_said("CTRL-EVENT-CONNECTED")
        return daemon

    def _start(self, command: list[str], ns: str) -> Daemon:
        self._files += 1
        daemon = Daemon(command, ns, self.folder / f"{self._files}-{command[0]}.log")
        self.daemons.append(daemon)
        return daemon

    def _file(self, name: str, lines: list[str]) -> Path:
        self._files += 1
        file = self.folder / f"{self._files}-{name}"
        file.write_text("\n".join(lines) + "\n")
        return file

    def close(self) -> None:
        """End all that was started."""
        for daemon in reversed(self.daemons):
            daemon.stop()


def radios(count: int, namespaces: list[str]) -> list[Radio]:
    """Load the simulator and give each radio its namespace."""
    run("insmod", MODULE, f"radios={count}")
    run("iw", "reg", "set", "US")
    for ns in namespaces:
        run("ip", "netns", "add", ns)
        run("ip", "link", "set", "lo", "up", ns=ns)
    return [Radio(number, namespaces[number]) for number in range(count)]


def datagrams(ns: str, address: str, count: int, size: int = 200) -> None:
    """UDP datagrams to a port where nobody listens: traffic for the radio, in one direction mostly."""
    with inside(ns):
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with sender:
        for _ in range(count):
            with contextlib.suppress(ConnectionRefusedError):
                sender.sendto(bytes(size), (address, 9))


class Eye:
    """A reader that lives in a namespace."""

    def __init__(self, radio: Radio, **options: int) -> None:
        self.radio = radio
        with inside(radio.ns):
            self.nl = Nl80211(**options)

    def read(self) -> RadioSample:
        """One sample with everything, also what seldom changes."""
        with inside(self.radio.ns):
            self.nl.refresh()
            return self.nl.read(self.radio.iface)

    def quick(self) -> RadioSample:
        """One sample as the agent takes it."""
        with inside(self.radio.ns):
            return self.nl.read(self.radio.iface)

    def close(self) -> None:
        """Give back the socket."""
        self.nl.close()


def scan(radio: Radio, *frequencies_mhz: int) -> ScanSnapshot:
    """One scan by our own scanner (`iw scan` at times spins for ever in this guest)."""
    with inside(radio.ns):
        scanner, reader = Scanner(), Nl80211()
        ours = reader.interface(radio.iface)
        assert ours.ifindex is not None
        scanner.start(ours.ifindex, frequencies_mhz)
        found = wait_for("the end of the scan", lambda: scanner.ready(radio.iface, ours), 30)
    scanner.close()
    reader.close()
    assert isinstance(found, ScanSnapshot)
    return found


class Ear:
    """A listener that lives in a namespace; keeps all events it heard."""

    def __init__(self, radio: Radio) -> None:
        self.radio = radio
        self.heard: list[LinkEvent] = []
        with inside(radio.ns):
            self.events = RadioEvents(radio.iface)

    def listen(self) -> list[LinkEvent]:
        """Everything heard so far."""
        with inside(self.radio.ns):
            self.heard += self.events.events()
        return self.heard

    def wait(self, kind: EventKind, timeout_s: float = 30.0) -> LinkEvent:
        """The first event of a kind that was not asked for yet; it and all before it are taken off."""

        def first() -> LinkEvent | None:
            select.select([self.events], [], [], 0.5)  # read at once, so that the times are right
            return next((event for event in self.listen() if event.kind is kind), None)

        try:
            found = wait_for(f"event {kind.value}", first, timeout_s)
        except AssertionError as reason:
            raise AssertionError(f"{reason}; heard: {[(e.kind.value, e.detail) for e in self.heard]}") from None
        assert isinstance(found, LinkEvent)
        del self.heard[: self.heard.index(found) + 1]
        return found

    def close(self) -> None:
        """Give back the sockets."""
        self.events.close()

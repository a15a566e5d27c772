"""CPU per sample: our sources against shell pipelines that fetch the same figures (children's CPU included)."""

from __future__ import annotations

import gc
import os
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from linkrover.sources.ethtool import EthtoolReader
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch, interface_names
from linkrover.sources.netdev import NetdevReader
from linkrover.sources.network_errors import NetworkErrorsSource
from linkrover.sources.snmp import NetstatReader, SnmpReader
from linkrover.sources.sysfs import SysfsReader
from linkrover.sources.utilization import UtilizationSource
from linkrover.sources.wext import WirelessFileReader

OURS_SAMPLES = 2000
SHELL_SAMPLES = 25
ROUNDS = 3
WIRELESS = (
    "Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE\n"
    " face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22\n"
    " wlan0: 0000   38.  -72.  -256        0      0      0      0      8        0\n"
)


def main() -> None:
    missing = [tool for tool in ("netstat", "ethtool", "awk") if shutil.which(tool) is None]
    if missing:
        print(f"needs the programs {', '.join(missing)} (Debian: net-tools, ethtool, mawk)")
        return
    iface = next((name for name in interface_names() if name.startswith(("eth", "en", "wl"))), "lo")
    with tempfile.TemporaryDirectory() as folder:
        wireless = Path(folder) / "wireless"
        wireless.write_text(WIRELESS)
        rows = _rows(iface, str(wireless))
        print(f"interface {iface}; CPU microseconds a sample, median of {ROUNDS} rounds, user + system + children")
        print(f"{'figures':<44} {'shell':>10} {'linkrover':>10} {'ratio':>8}")
        for title, shell, ours in rows:
            theirs_us = statistics.median(_cpu_us(shell, SHELL_SAMPLES) for _ in range(ROUNDS))
            ours_us = statistics.median(_cpu_us(ours, OURS_SAMPLES) for _ in range(ROUNDS))
            print(f"{title:<44} {theirs_us:>10.0f} {ours_us:>10.1f} {theirs_us / ours_us:>7.0f}x")
    print("aim: at least 100x for utilisation + errors together")


def _rows(iface: str, wireless: str) -> list[tuple[str, Callable[[], object], Callable[[], object]]]:
    sockets = InterfaceSocket()
    watch = InterfaceWatch(iface, sockets=sockets)
    netdev, snmp, netstat = NetdevReader(), SnmpReader(), NetstatReader()
    ethtool, sysfs = EthtoolReader(sockets), SysfsReader(sockets)
    index = sockets.index(iface) or 0
    utilization, errors = UtilizationSource([watch]), NetworkErrorsSource([watch], sockets=sockets)
    link = WirelessFileReader(wireless)

    def both() -> None:
        utilization.sample()
        errors.sample()

    def statistics_of_driver() -> object:
        return ethtool.statistics(iface, index)

    # What a node needs for one message each: one pipeline a figure, as shell-based nodes do it.
    device = f"cat /proc/net/dev | grep {iface}"
    tcp = [f"netstat -s | grep '{words}' | awk '{{print $1}}'" for words in ("segments sent out", "segments received")]
    udp = ["netstat -s -u | grep 'packets sent' | awk '{print $1}'",
           "netstat -s -u | grep 'packets received' | awk '{print $1}'"]  # fmt: skip
    bad = [f"netstat -s | grep '{words}' | awk '{{print $1}}'" for words in ("retransmitted", "bad segments")]
    bad.append("netstat -s -u | grep 'packet receive errors' | awk '{print $1}'")
    mac = [f"ethtool -S {iface} | grep '{word}' | awk '{{print $2}}'" for word in ("retries", "rx_drop")]
    utilization_way = [device, *tcp, *udp]
    errors_way = [device, *bad, *mac]
    return [
        ("/proc/net/dev: one interface", _shell([device]), lambda: netdev.read((iface,))),
        ("/proc/net/snmp: one TCP counter / all", _shell(tcp[:1]), snmp.read),
        ("/proc/net/netstat: one counter / all", _shell(bad[:1]), netstat.read),
        ("sysfs: five error counters", _shell([f"cat /sys/class/net/{iface}/statistics/*_errors"]),
         lambda: sysfs.read(iface, index)),
        ("ethtool: all driver statistics", _shell(mac[:1]), _or_none(statistics_of_driver)),
        ("/proc/net/wireless: one interface", _shell([f"cat {wireless} | grep wlan0"]), link.read),
        ("link utilisation, whole record", _shell(utilization_way), utilization.sample),
        ("network errors, whole record", _shell(errors_way), errors.sample),
        ("utilisation + errors together", _shell([*utilization_way, *errors_way]), both),
    ]  # fmt: skip


def _shell(pipelines: list[str]) -> Callable[[], object]:
    def sample() -> None:
        for pipeline in pipelines:
            subprocess.run(pipeline, shell=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)

    return sample


def _or_none(read: Callable[[], object]) -> Callable[[], object]:
    """A driver without statistics refuses, which also costs something."""
    from linkrover.errors import LinkRoverError

    def sample() -> object:
        try:
            return read()
        except LinkRoverError:
            return None

    return sample


def _cpu_us(sample: Callable[[], object], count: int) -> float:
    sample()
    gc.collect()
    before = _spent_ns()
    for _ in range(count):
        sample()
    return (_spent_ns() - before) / count / 1000


def _spent_ns() -> int:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time_ns() + round((children.ru_utime + children.ru_stime) * 1e9)


if __name__ == "__main__":
    os.environ.setdefault("LC_ALL", "C")
    main()

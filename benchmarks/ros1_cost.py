"""CPU, memory and link load of our ROS 1 nodes, against nodes that ask the shell for every sample, in one run."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from benchmarks._ros1 import LINKROVER, PLAY, Pair, cpu_s, resident_mb

WARM_UP_S = 20.0  # imports and connections, also on a busy machine
MEASURE_S = 40.0

# One pipeline a value, as measuring scripts commonly are: neutral equivalents, written for this comparison.
SHELL_NODE = r"""
import subprocess, sys
import rospy
from linkrover.ros1.types import message_class

what, iface = sys.argv[1:3]
DEV = "grep '%s:' /proc/net/dev | awk '{print $%d}'"
SNMP = "grep '%s:' /proc/net/snmp | tail -1 | awk '{print $%d}'"
PIPELINES = {
    "link_utilization": {
        "total_rx_bytes": DEV % (iface, 2), "total_rx_packets": DEV % (iface, 3),
        "total_tx_bytes": DEV % (iface, 10), "total_tx_packets": DEV % (iface, 11),
        "tcp_rx_segments": SNMP % ("Tcp", 11), "tcp_tx_segments": SNMP % ("Tcp", 12),
        "udp_rx_datagrams": SNMP % ("Udp", 2), "udp_tx_datagrams": SNMP % ("Udp", 5),
    },
    "network_errors": {
        "retransmits": "netstat -s | grep 'segments retransmit' | awk '{print $1}'",
        "badsegments": "netstat -s | grep 'bad segments' | awk '{print $1}'",
        "udperrors": "netstat -su | grep 'packet receive errors' | awk '{print $1}'",
        "tx_retires": "ethtool -S %s | grep tx_retries | awk '{print $2}'" % iface,
        "rx_dropped": "ethtool -S %s | grep rx_dropped | awk '{print $2}'" % iface,
        "nic_tx_errors": "cat /sys/class/net/%s/statistics/tx_errors" % iface,
        "nic_rx_errors": "cat /sys/class/net/%s/statistics/rx_errors" % iface,
        "nic_tx_dropped": "cat /sys/class/net/%s/statistics/tx_dropped" % iface,
        "nic_rx_dropped": "cat /sys/class/net/%s/statistics/rx_dropped" % iface,
    },
}[what]
cls = message_class("network_analysis/" + "".join(w.capitalize() for w in what.split("_")))
rospy.init_node("shell_" + what)
publisher = rospy.Publisher("shell/" + what, cls, queue_size=10)
rate = rospy.Rate(1)
while not rospy.is_shutdown():
    message = cls(iface=iface)
    message.header.stamp = rospy.Time.now()
    for field, pipeline in PIPELINES.items():
        text = subprocess.run(pipeline, shell=True, capture_output=True, text=True).stdout.strip()
        setattr(message, field, int(text.split()[0]) if text.split() and text.split()[0].isdigit() else 0)
    publisher.publish(message)
    rospy.loginfo("published %s", what)
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
"""


def main() -> None:
    if os.geteuid() != 0:
        print("needs root, to make network namespaces")
        return
    with Pair() as pair:
        _cpu(pair)
    with Pair() as pair:
        _link(pair)


def _cpu(pair: Pair) -> None:
    iface = pair.devices["robot"]
    pair.start("station", [*LINKROVER, "ping-server"])
    shell = [
        pair.start("robot", [sys.executable, "-c", SHELL_NODE, what, iface])
        for what in ("link_utilization", "network_errors")
    ]
    lean = ["--ping", "", "--wireless-rate", "0", "--tcp-rate", "0", "--traffic-period", "0"]
    ours = pair.start("robot", [*LINKROVER, "client", "-i", iface, "--node", "two_jobs", *lean, "--no-diagnostics"])
    whole = pair.start(
        "robot", [*LINKROVER, "client", "-i", iface, "--node", "whole", "--record", f"{pair.folder.name}/run"]
    )
    for topic, kind in (
        ("/shell/link_utilization", "LinkUtilization"),
        ("/shell/network_errors", "NetworkErrors"),
        (f"/robot/{iface}/network_analysis/link_utilization", "LinkUtilization"),
        (f"/robot/{iface}/network_analysis/network_errors", "NetworkErrors"),
    ):
        pair.start("station", [*PLAY, "swallow", topic, f"network_analysis/{kind}"])
    time.sleep(WARM_UP_S)
    rows: dict[str, list[subprocess.Popen[str]]] = {
        "shell pipelines, 2 nodes: utilisation + errors, 1 Hz": shell,
        "ours, 1 node: utilisation + errors, 1 Hz": [ours],
        "ours, everything: + wireless 10 Hz, action 1 Hz, STAMP 10 Hz, TCP, diagnostics, recording": [whole],
    }
    before = {title: (sum(cpu_s(p.pid) for p in found), time.monotonic()) for title, found in rows.items()}
    time.sleep(MEASURE_S)
    share = {
        title: 100 * (sum(cpu_s(p.pid) for p in found) - before[title][0]) / (time.monotonic() - before[title][1])
        for title, found in rows.items()
    }
    base = share[next(iter(rows))]
    print(f"{'node':<92} {'CPU % of a core':>16} {'ratio':>7} {'resident MB':>12}")
    for title, found in rows.items():
        memory = sum(resident_mb(p.pid) for p in found)
        print(f"{title:<92} {share[title]:>16.2f} {base / share[title]:>6.1f}x {memory:>12.1f}")
    print("aim: a 25th of the shell pipelines' CPU for utilisation + errors\n")


def _link(pair: Pair) -> None:
    """What measuring itself puts on the link between robot and station."""
    iface = pair.devices["robot"]
    print(f"{'on the link, both directions, with all headers':<92} {'bytes/s':>16}")

    def row(title: str, seconds: float = 20.0) -> float:
        time.sleep(5.0)
        before, began = pair.bytes(), time.monotonic()
        time.sleep(seconds)
        rate = (pair.bytes() - before) / (time.monotonic() - began)
        print(f"{title:<92} {rate:>16.0f}", flush=True)
        return rate

    row("master alone")
    server = pair.start("station", [*LINKROVER, "server", "-i", pair.devices["station"]])
    row("server on the station (its watch on the master)")
    client = pair.start("robot", [*LINKROVER, "client", "-i", iface])
    row("+ client on the robot: action 1 Hz and STAMP 10 Hz; no subscriber")
    listeners = [
        pair.start("station", [*PLAY, "swallow", topic, f"network_analysis/{kind}"])
        for topic, kind in (
            (f"/robot/{iface}/network_analysis/link_utilization", "LinkUtilization"),
            (f"/robot/{iface}/network_analysis/network_errors", "NetworkErrors"),
            ("/robot/network_analysis/network_delay", "NetworkDelay"),
        )
    ]
    row("+ the station subscribes to the three 1 Hz topics of 2021")
    for process in (*listeners, client, server):
        pair.stop(process)


if __name__ == "__main__":
    main()

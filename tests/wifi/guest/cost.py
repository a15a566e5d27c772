"""What one sample costs, in the guest: ours against `iw`, pyroute2 and /proc/net/wireless. Run by the benchmark."""

from __future__ import annotations

import importlib
import json
import os
import resource
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

from linkrover.records import Now, now
from linkrover.sources.netlink import NETLINK_ROUTE, NetlinkSocket
from linkrover.sources.nl80211 import Nl80211
from linkrover.sources.wext import WirelessFileReader

from .air import Air, datagrams, inside, radios

RTM_GETLINK = 18
NAMESPACES = ["robot", "station"]


def cpu_us(job: Callable[[], object], turns: int) -> float:
    """CPU of this process and its children per turn, microseconds; the best of three."""

    def spent() -> float:
        own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime

    job()
    best = float("inf")
    for _ in range(3):
        before = spent()
        for _ in range(turns):
            job()
        best = min(best, (spent() - before) / turns * 1e6)
    return best


def links_us(turns: int = 300) -> float:
    """A dump of the network interfaces by our codec: the same kind of work, which a machine without Wi-Fi has too."""
    route = NetlinkSocket(NETLINK_ROUTE)
    try:
        return cpu_us(lambda: route.request(RTM_GETLINK, bytes(16), dump=True), turns)
    finally:
        route.close()


def main() -> None:
    """Measure and write /result/cost.json."""
    robot, station = radios(2, NAMESPACES)
    robot.address("10.1.0.1/24")
    station.address("10.1.0.2/24")
    Path("/tmp/air").mkdir()
    air = Air(Path("/tmp/air"))
    air.access_point(robot, "cost", 36)
    air.station(station, "cost", [36])
    datagrams("station", "10.1.0.1", 20)
    found: dict[str, float] = {}
    with inside("station"):
        index = socket.if_nametoindex(station.iface)
        ours = Nl80211()
        at = now()
        turn = 0

        def sample() -> None:
            nonlocal turn
            turn += 1
            ours.read_index(station.iface, index, Now(0, turn * 100_000_000))  # as if 100 ms passed between two

        os.environ["PATH"] = "/usr/sbin:/usr/bin"
        file = WirelessFileReader()
        found["linkrover, as the agent samples (link, station, 1/10 survey, channel, ...)"] = cpu_us(sample, 200)
        found["linkrover, station dump alone"] = cpu_us(lambda: ours._stations(index, "wlan1", at, tids=False), 200)
        found["linkrover, station dump with TID counters"] = cpu_us(lambda: ours.stations(station.iface), 100)
        found["/proc/net/wireless kept open (station only)"] = cpu_us(file.read, 300)
        command = ["iw", "dev", station.iface, "station", "dump"]
        found["iw dev X station dump"] = cpu_us(lambda: subprocess.run(command, capture_output=True, check=True), 15)
        iw = importlib.import_module("pyroute2.iwutil").IW()
        found["pyroute2 get_stations"] = cpu_us(lambda: list(iw.get_stations(index)), 60)
        iw.close()
        found["links"] = links_us()
    air.close()
    Path("/result/cost.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main()

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
    """CPU of this process and its children per turn, microseconds."""

    def spent() -> float:
        own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime

    job()
    before = spent()
    for _ in range(turns):
        job()
    return (spent() - before) / turns * 1e6


def links(route: NetlinkSocket) -> list[bytes]:
    """A dump of the network interfaces by our codec: the same kind of work, which a machine without Wi-Fi has too."""
    return route.request(RTM_GETLINK, bytes(16), dump=True)


def main() -> None:
    """Measure and write /result/cost.json."""
    robot, station = radios(2, NAMESPACES)
    robot.address("10.1.0.1/24")
    station.address("10.1.0.2/24")
    Path("/tmp/air").mkdir(exist_ok=True)
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
        command = ["iw", "dev", station.iface, "station", "dump"]
        iw = importlib.import_module("pyroute2.iwutil").IW()
        route = NetlinkSocket(NETLINK_ROUTE)
        jobs: dict[str, tuple[Callable[[], object], int]] = {
            "linkrover, as the agent samples (link, station, 1/10 survey, channel, ...)": (sample, 50),
            "linkrover, station dump alone": (lambda: ours._stations(index, station.iface, at, tids=False), 50),
            "linkrover, station dump with TID counters": (lambda: ours.stations(station.iface), 15),
            "/proc/net/wireless kept open (clients only)": (file.read, 80),
            "iw dev X station dump": (lambda: subprocess.run(command, capture_output=True, check=True), 3),
            "pyroute2 get_stations": (lambda: list(iw.get_stations(index)), 15),
            "links": (lambda: links(route), 50),
        }
        for _ in range(16):  # short and in turns: on a busy machine the least is nearest to the cost
            for name, (job, turns) in jobs.items():
                found[name] = min(found.get(name, float("inf")), cpu_us(job, turns))
        iw.close()
        route.close()
    air.close()
    Path("/result/cost.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main()

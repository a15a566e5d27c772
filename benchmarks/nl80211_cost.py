"""CPU per sample of the radio: ours, `iw`, pyroute2 and /proc/net/wireless in one run of the guest kernel; and of TCP
connections by sock_diag against `ss`, here.

There is no radio on most machines that run this, so the native cost is an estimate: the guest's cost, divided by how
much slower the guest is at a dump of the network interfaces by the same codec (measured in the same run).
"""

from __future__ import annotations

import json
import shlex
import socket
import subprocess
import sys

from rich.console import Console
from rich.table import Table
from tests.wifi.boot import run_job
from tests.wifi.guest.cost import cpu_us, links
from tests.wifi.kernel import CACHE, PROJECT, GuestUnavailableError

from linkrover.sources.netlink import NETLINK_ROUTE, NetlinkSocket
from linkrover.sources.sockdiag import TcpConnections

CONNECTIONS = 20
OURS = "linkrover, as the agent samples (link, station, 1/10 survey, channel, ...)"
DUMP = "linkrover, station dump alone"


def main() -> None:
    console = Console(width=120)
    _radio(console)
    _tcp(console)


def _radio(console: Console) -> None:
    share = CACHE / "cost"
    (share / "cost.json").unlink(missing_ok=True)
    route = NetlinkSocket(NETLINK_ROUTE)
    here_us = min(cpu_us(lambda: links(route), 300) for _ in range(4))
    route.close()
    job = (
        f"cd {shlex.quote(str(PROJECT))}\nexport PYTHONPATH=src:.\n"
        f"exec {shlex.quote(sys.executable)} -m tests.wifi.guest.cost\n"
    )
    try:
        run = run_job(job, share, 300)
    except GuestUnavailableError as reason:
        console.print(f"nl80211: not measured, no guest kernel: {reason}")
        return
    if run.exit_code != 0:
        raise SystemExit(f"the guest failed:\n{run.console[-3000:]}")
    found: dict[str, float] = json.loads((share / "cost.json").read_text())
    slower = found.pop("links") / here_us
    table = Table(title="CPU of one radio sample in the guest kernel (one client, one peer)")
    table.add_column("by")
    table.add_column("us a sample", justify="right")
    table.add_column("times ours", justify="right")
    table.add_column("times our dump", justify="right")
    for name, spent_us in found.items():
        table.add_row(name, f"{spent_us:.0f}", f"{spent_us / found[OURS]:.2f}", f"{spent_us / found[DUMP]:.2f}")
    console.print(table)
    native_us = found[OURS] / slower
    console.print(
        f"The guest is {slower:.1f} times slower than this machine at a dump of the interfaces by the same codec.\n"
        f"Estimated here: {native_us:.0f} us a sample, {native_us * 10 / 1e4:.3f} % of one core at 10 Hz (aim: 0.2 %)."
    )


def _tcp(console: Console) -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=CONNECTIONS) as listener:
        pairs = [(socket.create_connection(listener.getsockname()), listener.accept()[0]) for _ in range(CONNECTIONS)]
        ours = TcpConnections("lo")
        count = len(ours.read())
        table = Table(title=f"CPU of one sample of {count} TCP connections, here")
        table.add_column("by")
        table.add_column("us a sample", justify="right")
        table.add_column("times ours", justify="right")
        mine_us = min(cpu_us(ours.read, 50) for _ in range(4))
        ss_us = min(
            cpu_us(lambda: subprocess.run(["ss", "-tinpH"], capture_output=True, check=True), 10) for _ in range(4)
        )
        table.add_row("linkrover, sock_diag", f"{mine_us:.0f}", "1.00")
        table.add_row("ss -tinpH", f"{ss_us:.0f}", f"{ss_us / mine_us:.2f}")
        console.print(table)
        ours.close()
        for pair in pairs:
            for one in pair:
                one.close()


if __name__ == "__main__":
    main()

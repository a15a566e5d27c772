"""The emulator's relay under load: Mbit/s through one hop, and how late packets leave against the model's times.

1,500-byte packets cross one emulated hop (5 GHz, 80 MHz, one stream, -40 dBm) between two namespaces in real time.
The sender is a process of its own, paced; the relay has one thread. Needs root or user namespaces, and /dev/net/tun.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from multiprocessing import Process

SECONDS = 4.0
RATES_MBPS = (50, 100, 200, 250, 300)


def send(netns_fd: int, rate_bps: float) -> None:
    from linkrover.emulator.netns import in_namespace

    handle = in_namespace(netns_fd, lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    payload = bytes(1472)
    per_burst = 8
    gap_ns = int(per_burst * 1500 * 8e9 / rate_bps)
    begin = due = time.monotonic_ns()
    while due < begin + SECONDS * 1e9:
        for _ in range(per_burst):
            handle.sendto(payload, ("10.77.0.1", 9))
        due += gap_ns
        time.sleep(max(0, due - time.monotonic_ns()) / 1e9)


class StillLink:
    def tick(self, medium, _at) -> None:
        for hop in medium.hops():
            medium.set_link(hop.sender, hop.receiver, rssi_dbm=-40.0, distance_m=1.0)


def measure(rate_mbps: float) -> tuple[float, float, float, float, float]:
    """Delivered Mbit/s, share delivered, release error median and p99 in us, CPU share of the relay."""
    from linkrover.emulator.medium import Medium, MediumConfig
    from linkrover.emulator.netns import make_host
    from linkrover.emulator.relay import Port, Relay, hurry

    hosts = [make_host("robot", "10.77.0.2"), make_host("station", "10.77.0.1")]
    config = MediumConfig(band_ghz=5.0, width_mhz=80, max_mcs=9)
    medium = Medium(config, access_point="station", stations=("robot",), seed=1, start_ns=time.monotonic_ns())
    relay = Relay(medium, [Port(h.name, h.address, h.tun_fd) for h in hosts], StillLink(), lambda _record: None)
    errors: list[int] = []
    tick = relay._tick

    def keep(at) -> None:
        errors.extend(relay._errors_ns)
        tick(at)

    relay._tick = keep
    sender = Process(target=send, args=(hosts[0].netns_fd, rate_mbps * 1e6))
    sender.start()
    timer = threading.Timer(SECONDS + 0.5, relay.stop)
    timer.start()
    hurry()
    cpu = time.thread_time()
    relay.run()
    cpu = time.thread_time() - cpu
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    sender.join()
    hop = medium.hop("robot", "station")
    for host in hosts:
        host.close()
    errors.sort()
    return (
        hop.delivered_octets * 8 / SECONDS / 1e6,
        hop.delivered_packets / max(1, hop.offered_packets),
        errors[len(errors) // 2] / 1e3,
        errors[len(errors) * 99 // 100] / 1e3,
        cpu / (SECONDS + 0.5),
    )


def main() -> None:
    from linkrover.emulator.netns import NotPermittedError, become_namespace_root

    try:
        become_namespace_root()
    except NotPermittedError as error:
        print(f"skipped: {error}")
        return
    print(f"Relay of 1,500-byte packets through one emulated hop, {SECONDS:.0f} s each, {os.cpu_count()} cores")
    print(f"{'offered':>10} {'delivered':>10} {'share':>7} {'late median':>12} {'late p99':>10} {'relay CPU':>10}")
    for rate in RATES_MBPS:
        mbps, share, median, p99, cpu = measure(rate)
        print(
            f"{rate:>5} Mb/s {mbps:>5.0f} Mb/s {share:>6.1%} {median:>9.0f} us {p99:>7.0f} us {cpu:>9.0%}",
            file=sys.stdout,
            flush=True,
        )


if __name__ == "__main__":
    main()

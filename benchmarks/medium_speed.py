"""What the medium's model costs a packet, beside the air time it stands for: saturated hops, 1,500 octets."""

from __future__ import annotations

import time

from linkrover.emulator.medium import Medium, MediumConfig, NodeConfig

SECOND = 1_000_000_000


def one(title, access_point, stations, source, destination, rssi_dbm, queue="drop-tail", seconds=2.0, **config):
    nodes = {name: NodeConfig(queue=queue) for name in (access_point, *stations)}
    medium = Medium(
        MediumConfig(**{"band_ghz": 5.0, "width_mhz": 80, "max_mcs": 9, **config}),
        access_point=access_point,
        stations=stations,
        seed=1,
        nodes=nodes,
    )
    for hop in medium.hops():
        medium.set_link(hop.sender, hop.receiver, rssi_dbm=rssi_dbm)
    delivered = offered = now_ns = 0
    began = time.perf_counter()
    while now_ns < seconds * SECOND:
        # a fair queue takes every packet and drops another: so fill it by its own count
        while medium.route(source, destination)[0].queue.packets < 250:
            medium.offer(now_ns, source, destination, 1500, offered)
            offered += 1
        now_ns = medium.next_event_ns()
        delivered += sum(fate.cause is None for fate in medium.advance(now_ns))
    cost = time.perf_counter() - began
    rate = delivered * 12_000 / seconds / 1e6
    print(f"{title:44} {rate:8.0f} {cost / delivered * 1e6:10.2f} {seconds / cost:14.0f}")


def main() -> None:
    print(f"{'case':44} {'Mbit/s':>8} {'us/packet':>10} {'x real time':>14}")
    one("one hop, strong signal", "station", ("robot",), "robot", "station", -40.0)
    one("one hop, fair queue", "station", ("robot",), "robot", "station", -40.0, queue="fair")
    one("one hop, fading each transmission", "station", ("robot",), "robot", "station", -60.0, fading_m=2.0)
    one("one hop, others take 40 %", "station", ("robot",), "robot", "station", -40.0, others_share=0.4)
    one("through a router", "router", ("robot", "station"), "robot", "station", -40.0)
    one("no aggregation, 20 MHz", "station", ("robot",), "robot", "station", -40.0, width_mhz=20, max_subframes=1)


if __name__ == "__main__":
    main()

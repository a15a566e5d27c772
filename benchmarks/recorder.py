"""The recorder against rosbags' Writer and mcap's Writer, and reading an hour of two ends: one run, ratios count.

Every writer gets the same 20,000 messages (wireless link and link utilisation in turn), encodes, writes and closes
them, in a process of its own. Ours starts from records, rosbags from message objects made beforehand, mcap (which
encodes nothing) from records through our codec. Ours writes everything twice, journal first, and survives a kill;
the others leave nothing readable behind then, unless mcap writes unchunked.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MESSAGES = 20_000
T0 = 1_700_000_000_000_000_000


def records(number: int) -> list:
    from linkrover.records import Bitrate, LinkUtilization, WirelessLink

    found = []
    for n in range(number // 2):
        at = {"wall_ns": T0 + n * 100_000_000, "mono_ns": n * 100_000_000, "iface": "wlan0"}
        rate = Bitrate(rate_bps=65_000_000 + n, mode="ht", mcs=7)
        found.append(WirelessLink(**at, source="nl80211", ssid="lab", rssi_dbm=-50.0 - n % 9, tx_bitrate=rate))
        found.append(LinkUtilization(**at, rx_bytes=n * 1000, tx_bytes=n, rx_rate_bps=1e6, tx_rate_bps=1e3))
    return found


def manifest(role: str = "robot"):
    from linkrover.records import Manifest, Role

    return Manifest(
        wall_ns=T0, mono_ns=0, linkrover_version="0", role=Role(role), host="h", kernel="k", machine="m", python="3"
    )  # fmt: skip


def ours(place: Path) -> int:
    from linkrover.bag import Recorder

    prepared = records(MESSAGES)
    recorder = Recorder(place / "ours", manifest(), compatible=False)
    with measured():
        for record in prepared:
            recorder.take(record)
        recorder.close()
    return recorder.bytes_written


def by_rosbags(place: Path) -> int:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from linkrover.messages import texts, to_message

    store = get_typestore(Stores.ROS2_HUMBLE)
    names = {"WirelessLink": "linkrover_msgs/WirelessLink", "LinkUtilization": "linkrover_msgs/LinkUtilization"}
    types = {}
    for name in ("linkrover_msgs/Bitrate", *names.values()):
        types.update(get_types_from_msg(texts.text(name), name.replace("/", "/msg/")))
    store.register(types)

    def build(name: str, message: dict):
        values = {}
        for field in texts.definitions(name)[name]:
            nested = "/" in field.type
            values[field.name] = build(field.type, message[field.name]) if nested else message[field.name]
        return store.types[name.replace("/", "/msg/")](**values)

    prepared = []
    for record in records(MESSAGES):
        name = names[type(record).__name__]
        prepared.append((name.replace("/", "/msg/"), record.wall_ns, build(name, to_message(record, "robot"))))
    size = 0
    with measured(), Writer(place / "rosbags", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {kind: writer.add_connection(f"/{kind}", kind, typestore=store) for kind, _, _ in prepared[:2]}
        for kind, ns, message in prepared:
            data = store.serialize_cdr(message, kind)
            writer.write(connections[kind], ns, data)
            size += len(data)
    return size


def by_mcap(place: Path, *, chunked: bool) -> int:
    from mcap.writer import Writer

    from linkrover.messages import Codec, texts, to_message, type_name

    prepared = records(MESSAGES)
    size = 0
    with measured(), (place / "x.mcap").open("wb") as file:
        writer = Writer(file, use_chunking=chunked)
        writer.start("ros2")
        known = {}
        flushed = time.monotonic()
        for record in prepared:
            kind = type(record)
            if kind not in known:
                text = texts.ros2_definition(type_name(kind)).encode()
                schema = writer.register_schema(type_name(kind).replace("/", "/msg/"), "ros2msg", text)
                channel = writer.register_channel(f"/{kind.__name__}", "cdr", schema)
                known[kind] = (channel, Codec(type_name(kind), texts.definitions(type_name(kind))))
            channel, codec = known[kind]
            data = codec.encode(to_message(record, "robot"))
            writer.add_message(channel, record.wall_ns, data, record.wall_ns)
            size += len(data)
            if not chunked and time.monotonic() - flushed > 0.5:
                file.flush()
                flushed = time.monotonic()
        writer.finish()
    return size


class measured:  # noqa: N801 - used as a function
    """Wall and CPU time and the growth of the process's memory, kept for the report of this process."""

    last: dict[str, float] = {}

    def __enter__(self) -> None:
        self._before = memory()
        self._cpu = time.process_time()
        self._wall = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        measured.last = {"wall": wall, "cpu": cpu, "memory": memory()}


def memory() -> float:
    """Most this process ever held, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def imports(place: Path) -> int:
    """Memory of a process that has only a recorder open."""
    from linkrover.bag import Recorder

    with measured(), Recorder(place / "idle", manifest()):
        pass
    return 0


def imports_rosbags(place: Path) -> int:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    with measured(), Writer(place / "idle-rosbags", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/t", "std_msgs/msg/String", typestore=get_typestore(Stores.ROS2_HUMBLE))
    return 0


def hour(place: Path) -> int:
    """An hour of two ends: wireless and probe at 10 Hz, odometry at 50 Hz, the rest at 1 Hz."""
    from linkrover.bag import Recorder
    from linkrover.records import LinkUtilization, NetworkErrors, Pose, ProbeResult, ProbeState, WirelessLink

    number = 0
    with measured():
        for role in ("robot", "station"):
            with Recorder(place / "run" / role, manifest(role)) as recorder:
                for n in range(36_000):
                    at = {"wall_ns": T0 + n * 100_000_000, "mono_ns": n * 100_000_000}
                    recorder.take(
                        WirelessLink(**at, iface="wlan0", source="nl80211", ssid="lab", rssi_dbm=-50.0 - n % 9)
                    )
                    state = ProbeState.LOST if n % 50 == 0 else ProbeState.ANSWERED
                    rtt_ns = None if n % 50 == 0 else 2_000_000 + n
                    recorder.take(ProbeResult(**at, peer="p", session=1, sequence=n, state=state, rtt_ns=rtt_ns))
                    number += 2
                    if role == "robot":
                        for k in range(5):
                            step = {"wall_ns": at["wall_ns"] + k * 20_000_000, "mono_ns": at["mono_ns"]}
                            recorder.take(Pose(**step, x_m=n * 0.05, y_m=k * 0.01, heading_rad=n * 1e-4))
                            number += 1
                    if n % 10 == 0:
                        recorder.take(LinkUtilization(**at, iface="wlan0", rx_bytes=n * 1000, tx_bytes=n))
                        recorder.take(NetworkErrors(**at, iface="wlan0", tcp_retransmits=n))
                        number += 2
                    if n % 1000 == 0:
                        time.sleep(0.002)  # an hour passes in seconds: let the writer have its turn
    return number


def read_hour(place: Path) -> int:
    from linkrover.bag import find_recordings
    from linkrover.bag.frames import read_frames

    with measured():
        return sum(len(f) for path in find_recordings(place / "run") for f in read_frames(path).values())


def stream_hour(place: Path) -> int:
    from linkrover.bag import find_recordings
    from linkrover.bag.frames import iter_frames

    rows = 0
    with measured():
        for path in find_recordings(place / "run"):
            for frames in iter_frames(path):
                rows += sum(len(frame) for frame in frames.values())
    return rows


def records_of_hour(place: Path) -> int:
    from linkrover.bag import find_recordings, read_recording

    with measured():
        return sum(1 for path in find_recordings(place / "run") for _ in read_recording(path).records())


STEPS = {
    "ours": ours,
    "rosbags": by_rosbags,
    "mcap chunked": lambda place: by_mcap(place, chunked=True),
    "mcap unchunked": lambda place: by_mcap(place, chunked=False),
    "idle": imports,
    "idle rosbags": imports_rosbags,
    "hour": hour,
    "read": read_hour,
    "stream": stream_hour,
    "records": records_of_hour,
}


def in_own_process(step: str, place: Path) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.recorder", step, place], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=110)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        table = Table("writer", "messages/s", "MB/s", "CPU us a message", "against rosbags", "most memory MB")
        found: dict[str, list[dict[str, float]]] = {}
        names = ("ours", "rosbags", "mcap chunked", "mcap unchunked")
        for turn in range(3):
            for name in names:
                (place / f"{name}{turn}").mkdir()
                found.setdefault(name, []).append(in_own_process(name, place / f"{name}{turn}"))
        best = {name: min(runs, key=lambda run: run["cpu"]) for name, runs in found.items()}
        for name in names:
            run = best[name]
            table.add_row(
                {"ours": "LinkRover, journal and finished recording"}.get(name, f"{name}"),
                f"{MESSAGES / run['wall']:,.0f}",
                f"{run['result'] / run['wall'] / 1e6:.1f}",
                f"{run['cpu'] / MESSAGES * 1e6:.1f}",
                f"{best['rosbags']['cpu'] / run['cpu']:.2f}x",
                f"{run['memory']:.0f}",
            )
        console.print(table)
        idle, theirs = in_own_process("idle", place), in_own_process("idle rosbags", place)
        console.print(
            f"A process with an open recorder: {idle['memory']:.0f} MB; with rosbags' {theirs['memory']:.0f} MB."
        )
        made = in_own_process("hour", place)
        size = sum(file.stat().st_size for file in (place / "run").rglob("*.mcap"))
        console.print(
            f"An hour of two ends, {made['result']:,.0f} records with their 2021 and standard twins: recorded in "
            f"{made['wall']:.1f} s ({made['cpu'] / made['result'] * 1e6:.0f} us CPU a record, "
            f"{made['cpu'] / 7200:.2%} of one core an end), {size / 1e6:.0f} MB on disk, "
            f"at most {made['memory']:.0f} MB of memory."
        )
        for step, what in (("read", "as data frames"), ("stream", "in batches"), ("records", "record by record")):
            run = in_own_process(step, place)
            console.print(
                f"Read {what}: {run['wall']:.2f} s, {run['result']:,.0f} rows, at most {run['memory']:.0f} MB."
            )


if __name__ == "__main__":
    if len(sys.argv) == 3:
        result = STEPS[sys.argv[1]](Path(sys.argv[2]))
        print(json.dumps({**measured.last, "result": result}))
    else:
        main()

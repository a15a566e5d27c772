"""The real samples behind the repeated rows: change detection per topic of the 2021 recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from linkrover.records import Role

from .sheet import NOTHING_YET, Sheet

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Column = NDArray[np.float64] | NDArray[np.int64]
    Columns = dict[str, Column]

DEADLINE_NS = 2_000_000_000
MAX_MBIT_A_MESSAGE = 200.0  # no adapter of the experiments moves more in one loop; the paper's own limit too
GAP_INTERVALS = 1.6  # a longer silence hides messages that were never received
ENDS = (("c", Role.ROBOT), ("s", Role.STATION))
INTERFACES = (("", "iface1"), ("2", "iface2"))


@dataclass(slots=True)
class EndTopics:
    """What one end published. Keys of the per-interface tables are interface names."""

    utilization: dict[str, Columns] = field(default_factory=dict)
    errors: dict[str, Columns] = field(default_factory=dict)
    wireless: dict[str, Columns] = field(default_factory=dict)
    delay: Columns | None = None
    pose: Columns | None = None
    command: Columns | None = None


def recover(sheet: Sheet) -> tuple[dict[Role, EndTopics], list[str]]:
    """Every topic's samples and the list of what was mended on the way."""
    repairs: list[str] = []
    ends: dict[Role, EndTopics] = {}
    for prefix, role in ENDS:
        end = EndTopics()
        for suffix, iface in INTERFACES:
            label = f"{role.value}/{iface}"
            if (table := _utilization(sheet, prefix, suffix, label, repairs)) is not None:
                end.utilization[iface] = table
            if (table := _errors(sheet, prefix, suffix, label, repairs)) is not None:
                end.errors[iface] = table
            if (table := _wireless(sheet, prefix, suffix, label, repairs)) is not None:
                end.wireless[iface] = table
        ends[role] = end
    robot = ends[Role.ROBOT]
    robot.delay = _delay(sheet, repairs)
    robot.pose = _pose(sheet, repairs)
    robot.command = _command(sheet)
    return ends, repairs


def _changed(sheet: Sheet, names: list[str]) -> tuple[NDArray[np.intp], dict[str, NDArray[np.float64]]] | None:
    """Rows at which a new message of the topic must have come, and the columns there are; None = never received."""
    import numpy as np

    present = {name: sheet.columns[name] for name in names if name in sheet.columns}
    if not present:
        return None
    stacked = np.stack(list(present.values()))
    received = (stacked != NOTHING_YET).any(axis=0)
    if not received.any():
        return None
    new = np.concatenate(([True], (stacked[:, 1:] != stacked[:, :-1]).any(axis=0)))
    rows = np.flatnonzero(new & received)
    return rows, {name: values[rows] for name, values in present.items()}


def _utilization(sheet: Sheet, end: str, suffix: str, label: str, repairs: list[str]) -> Columns | None:
    import numpy as np

    names = [f"{end}_total_{part}mbps{suffix}" for part in ("tx_", "rx_", "")]
    found = _changed(sheet, names)
    if found is None:
        return None
    rows, values = found
    tx, rx, total = (values.get(name) for name in names)
    if tx is None or rx is None:
        if total is None:
            return None
        repairs.append(f"{label}: only the sum of both directions is there; it is given as received bytes")
        tx, rx = np.zeros(len(rows)), total
    elif total is not None and (bad := int((np.abs(total - tx - rx) > 1e-3).sum())):
        repairs.append(f"{label}: {bad} messages whose total is not tx + rx; tx and rx were taken")
    impossible = (tx < 0) | (rx < 0) | (tx + rx >= MAX_MBIT_A_MESSAGE)
    if impossible.any():
        repairs.append(f"{label}: {int(impossible.sum())} messages with an impossible throughput; taken as a reset")
    sound_tx, sound_rx = np.where(impossible, 0.0, tx), np.where(impossible, 0.0, rx)
    wall = sheet.wall_ns[rows]
    gaps = np.diff(wall)
    usual = float(np.median(gaps)) if len(gaps) else 1e9
    # the robot writes the file itself: after a stall its next message holds all bytes since; what the station
    # sent during an outage never came
    lost = np.concatenate(([False], gaps > GAP_INTERVALS * usual)) if end == "s" else np.zeros(len(rows), bool)
    if lost.any():
        repairs.append(f"{label}: {int(lost.sum())} gaps in which messages were not received; no rate over them")
    if not impossible[-1] and tx[-1] == 0 == rx[-1] and sheet.wall_ns[-1] - wall[-1] > GAP_INTERVALS * usual:
        repairs.append(f"{label}: silent from its last message on; a sample at the end of the file says so")
        wall = np.append(wall, sheet.wall_ns[-1])
        sound_tx, sound_rx = np.append(sound_tx, 0.0), np.append(sound_rx, 0.0)
        impossible, lost = np.append(impossible, False), np.append(lost, False)
    interval = np.concatenate(([0], np.diff(wall)))
    return {
        "wall_ns": wall,
        "interval_ns": interval,
        "tx_bytes": np.cumsum(np.rint(sound_tx * 125_000).astype(np.int64)),
        "rx_bytes": np.cumsum(np.rint(sound_rx * 125_000).astype(np.int64)),
        "reset": impossible.astype(np.int64),
        "back": lost.astype(np.int64),
    }


def _errors(sheet: Sheet, end: str, suffix: str, label: str, repairs: list[str]) -> Columns | None:
    import numpy as np

    names = {"mac_tx_retries": f"{end}_tx_retires{suffix}", "tcp_retransmits": f"{end}_retransmits{suffix}"}
    found = _changed(sheet, list(names.values()))
    if found is None:
        return None
    rows, values = found
    table: Columns = {"wall_ns": sheet.wall_ns[rows]}
    for name, column in names.items():
        raw = values.get(column)
        if raw is None:
            continue
        sound = (raw >= 0) & (raw < 2**62)
        if bad := int((~sound & (raw != NOTHING_YET)).sum()):
            repairs.append(f"{label}: {bad} impossible values of {column} left out")
        counter = np.where(sound, raw, np.nan)
        falls = int((np.diff(counter[sound]) < 0).sum())
        if falls:
            repairs.append(f"{label}: {column} falls {falls} times (reset, or counters of two publishers); kept raw")
        table[name] = counter
    return table


def _wireless(sheet: Sheet, end: str, suffix: str, label: str, repairs: list[str]) -> Columns | None:
    import numpy as np

    names = {key: f"{end}_{key}{suffix}" for key in ("rssi", "lqi", "rssi_status")}
    found = _changed(sheet, list(names.values()))
    if found is None:
        return None
    rows, values = found
    missing = np.full(len(rows), np.nan)
    rssi = values.get(names["rssi"], missing)
    lqi = values.get(names["lqi"], missing)
    status = values.get(names["rssi_status"], missing)
    reading = (rssi > -200) & (rssi < -4)
    odd = int((~reading & ~np.isin(rssi, (NOTHING_YET, -256.0, 0.0)) & np.isfinite(rssi)).sum())
    if odd:
        repairs.append(f"{label}: {odd} impossible RSSI values taken as unknown")
    known = np.isin(status, (0.0, 1.0))
    against = int(((reading & known & (status == 0)) | ((rssi == -256.0) & known & (status == 1))).sum())
    if against:
        repairs.append(f"{label}: {against} statuses contradict their RSSI; both kept, the figures leave them out")
    return {
        "wall_ns": sheet.wall_ns[rows],
        "rssi_dbm": np.where(reading, rssi, np.nan),
        "link_quality": np.where(lqi >= 0, lqi, np.nan),
        "connected": np.where(known, status, np.nan),
        "nothing_yet": (rssi == NOTHING_YET).astype(np.int64),
    }


def _delay(sheet: Sheet, repairs: list[str]) -> Columns | None:
    """Pings by their time of sending; a stretch of -1 holds one lost ping every two seconds."""
    import numpy as np

    found = _changed(sheet, ["network_delay"])
    if found is None:
        return None
    rows, values = found
    delay = values["network_delay"]
    wall = sheet.wall_ns[rows]
    answered = (delay > 0) & (delay < 1e7)
    lost = delay == -1
    odd = ~answered & ~lost
    if odd.any():
        repairs.append(f"network_delay: {int(odd.sum())} impossible values left out")
    delay_ns = np.rint(np.where(answered, delay, 0.0) * 1e6).astype(np.int64)
    ends = np.append(wall[1:], sheet.wall_ns[-1])
    times, delays = [wall[answered] - delay_ns[answered]], [delay_ns[answered]]
    inferred = 0
    for begin, end in zip(wall[lost], ends[lost], strict=True):
        count = max(1, round((end - begin) / DEADLINE_NS))
        inferred += count - 1
        times.append(begin - DEADLINE_NS + np.arange(count) * DEADLINE_NS)
        delays.append(np.full(count, -1))
    if inferred:
        repairs.append(
            f"network_delay: {int(lost.sum())} stretches of -1 hold {inferred + int(lost.sum())} lost pings "
            "(one every 2 s, the 2021 deadline); all but the first of each stretch are inferred"
        )
    sent, value = np.concatenate(times).astype(np.int64), np.concatenate(delays).astype(np.int64)
    settled = sent + np.where(value >= 0, value, DEADLINE_NS)
    order = np.argsort(settled, kind="stable")
    return {"wall_ns": sent[order], "delay_ns": value[order]}


def _pose(sheet: Sheet, repairs: list[str]) -> Columns | None:
    """Every odometry row: the paper's own method weighs by rows."""
    import numpy as np

    c = sheet.columns
    if "robot_pos_x" not in c or "robot_pos_y" not in c:
        repairs.append("no odometry columns: no pose, and the paper's method cannot weigh by rows")
        return None
    zero, one = np.zeros(len(sheet.wall_ns)), np.ones(len(sheet.wall_ns))
    x, y, z = (c.get(f"robot_orien_{axis}", zero) for axis in "xyz")
    w = c.get("robot_orien_w", one)
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    table: Columns = {
        "wall_ns": sheet.wall_ns,
        "x_m": c["robot_pos_x"],
        "y_m": c["robot_pos_y"],
        "heading_rad": heading,
    }
    for name, column in (("forward_m_per_s", "robot_twist_x"), ("turn_rad_per_s", "robot_twist_z")):
        if column in c and not (c[column] == NOTHING_YET).all():
            table[name] = c[column]
    return table


def _command(sheet: Sheet) -> Columns | None:
    import numpy as np

    found = _changed(sheet, ["vel_x", "vel_y", "vel_w"])
    if found is None:
        return None
    rows, values = found
    zero = np.zeros(len(rows))
    return {
        "wall_ns": sheet.wall_ns[rows],
        "forward_m_per_s": values.get("vel_x", zero),
        "sideways_m_per_s": values.get("vel_y", zero),
        "turn_rad_per_s": values.get("vel_w", zero),
    }

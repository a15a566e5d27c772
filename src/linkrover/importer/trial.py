"""One imported trial: its samples, its set-up, and the records a recording of each end holds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkrover import __version__
from linkrover.records import (
    Continuity,
    Interface,
    LinkUtilization,
    Manifest,
    NetworkDelay,
    NetworkErrors,
    Pose,
    Record,
    Role,
    Unknown,
    VelocityCommand,
    WirelessLink,
)

from .naming import Setup, guess_setup
from .sheet import Sheet, read_sheet
from .topics import DEADLINE_NS, EndTopics, recover

if TYPE_CHECKING:
    from collections.abc import Callable

    from .topics import Columns

NOT_RECORDED = "not recorded"
METHOD = "ros1 action"


@dataclass(frozen=True, slots=True)
class Trial:
    """A file of the 2021 data as samples per end."""

    name: str
    sheet: Sheet
    setup: Setup
    ends: dict[Role, EndTopics]
    repairs: tuple[str, ...]

    def manifest(self, role: Role) -> Manifest:
        """What the recording of one end says of itself."""
        notes = {
            "rows": str(len(self.sheet.wall_ns)),
            "rows_in_file": str(self.sheet.rows_read),
            "publisher": "2021",
            **self.setup.factors(),
        }
        if self.sheet.summary:
            notes["summary_rows"] = json.dumps(self.sheet.summary)
        end = self.ends[role]
        ifaces = sorted({*end.utilization, *end.errors, *end.wireless})
        first = int(self.sheet.wall_ns[0])
        return Manifest(
            wall_ns=first,
            mono_ns=first,
            linkrover_version=__version__,
            role=role,
            host=NOT_RECORDED,
            kernel=NOT_RECORDED,
            machine=NOT_RECORDED,
            python=NOT_RECORDED,
            interfaces=tuple(Interface(name=iface) for iface in ifaces),
            peer=(Role.STATION if role is Role.ROBOT else Role.ROBOT).value,
            middleware="ros1",
            case=self.setup.case,
            trial=self.setup.trial,
            run=self.name,
            imported_from=Path(self.sheet.file).name,
            repairs=self.repairs,
            notes=notes,
        )

    def records(self, role: Role) -> list[Record]:
        """All records of one end in the order of their recording."""
        stamped = [pair for source in _sources(self.ends[role]) for pair in source]
        stamped.sort(key=lambda pair: pair[0])
        return [record for _, record in stamped]


def load_trial(path: str | Path, case: str | None = None, trial: int | None = None, name: str | None = None) -> Trial:
    """Read one CSV file of the 2021 data. Raises ParseError for any other file."""
    sheet = read_sheet(path)
    ends, mended = recover(sheet)
    setup = guess_setup(path, case, trial)
    return Trial(name or run_name(path), sheet, setup, ends, (*sheet.repairs, *mended))


def run_name(path: str | Path) -> str:
    """A folder name for the run of a file."""
    kept = "".join(c if c.isalnum() or c in "-_." else "_" for c in Path(path).stem).strip(".")
    return kept or "run"


def _sources(end: EndTopics) -> Iterator[Iterator[tuple[int, Record]]]:
    for iface, table in end.utilization.items():
        yield _utilization(iface, table)
    for iface, table in end.errors.items():
        yield _errors(iface, table)
    for iface, table in end.wireless.items():
        moved = end.utilization.get(iface)
        carries = moved is not None and int(moved["tx_bytes"][-1] + moved["rx_bytes"][-1]) > 0
        yield _wireless(iface, table, carries)
    if end.delay is not None:
        yield _delay(end.delay)
    if end.pose is not None:
        yield _plain(Pose, end.pose)
    if end.command is not None:
        yield _plain(VelocityCommand, end.command)


def _plain(kind: Callable[..., Record], table: Columns) -> Iterator[tuple[int, Record]]:
    names = list(table)[1:]
    for wall, *values in zip(*(column.tolist() for column in table.values()), strict=True):
        yield wall, kind(wall_ns=wall, mono_ns=wall, **dict(zip(names, values, strict=True)))


def _utilization(iface: str, table: Columns) -> Iterator[tuple[int, Record]]:
    no_base = {"tx_rate_bps": Unknown.NO_BASE, "rx_rate_bps": Unknown.NO_BASE}
    before: tuple[int, int] | None = None
    for wall, interval, tx, rx, reset, back in zip(*(column.tolist() for column in table.values()), strict=True):
        if reset or back or before is None:
            continuity = Continuity.RESET if reset else Continuity.BACK if back else Continuity.FIRST
            yield (
                wall,
                LinkUtilization(
                    wall_ns=wall,
                    mono_ns=wall,
                    iface=iface,
                    continuity=continuity,
                    tx_bytes=tx,
                    rx_bytes=rx,
                    unknown=no_base,
                ),
            )
        else:
            yield (
                wall,
                LinkUtilization(
                    wall_ns=wall,
                    mono_ns=wall,
                    iface=iface,
                    interval_ns=interval,
                    tx_bytes=tx,
                    rx_bytes=rx,
                    tx_rate_bps=(tx - before[0]) * 8e9 / interval,
                    rx_rate_bps=(rx - before[1]) * 8e9 / interval,
                ),
            )
        before = (tx, rx)


def _errors(iface: str, table: Columns) -> Iterator[tuple[int, Record]]:
    names = [name for name in ("mac_tx_retries", "tcp_retransmits") if name in table]
    last: dict[str, float] = {}
    for wall, *values in zip(table["wall_ns"].tolist(), *(table[name].tolist() for name in names), strict=True):
        known: dict[str, float] = {name: value for name, value in zip(names, values, strict=True) if value == value}
        continuity = Continuity.STEADY if last else Continuity.FIRST
        if any(value < last.get(name, value) for name, value in known.items()):
            continuity = Continuity.RESET
        last = {**last, **known}
        yield (
            wall,
            NetworkErrors(
                wall_ns=wall,
                mono_ns=wall,
                iface=iface,
                continuity=continuity,
                unknown={name: Unknown.ABSENT for name in names if name not in known},
                **{str(name): int(value) for name, value in known.items()},
            ),
        )


def _wireless(iface: str, table: Columns, carries_traffic: bool) -> Iterator[tuple[int, Record]]:
    import numpy as np

    # an access point has no line of its own in /proc/net/wireless: "not connected" would be a wrong word for it
    silent_ap = carries_traffic and not np.isfinite(table["rssi_dbm"]).any()
    names = ("wall_ns", "rssi_dbm", "link_quality", "connected")
    for wall, rssi, quality, connected in zip(*(table[name].tolist() for name in names), strict=True):
        unknown: dict[str, Unknown] = {}
        if rssi != rssi:
            unknown["rssi_dbm"] = (
                Unknown.UNSUPPORTED if silent_ap else Unknown.NOT_CONNECTED if connected == 0 else Unknown.ABSENT
            )
        if silent_ap:
            unknown["connected"] = Unknown.UNSUPPORTED
        yield (
            wall,
            WirelessLink(
                wall_ns=wall,
                mono_ns=wall,
                iface=iface,
                source="wext",
                connected=None if silent_ap or connected != connected else bool(connected),
                mode="ap" if silent_ap else None,
                rssi_dbm=rssi if rssi == rssi else None,
                link_quality=quality if quality == quality else None,
                unknown=unknown,
            ),
        )


def _delay(table: Columns) -> Iterator[tuple[int, Record]]:
    pairs = zip(table["wall_ns"].tolist(), table["delay_ns"].tolist(), strict=True)
    for sequence, (wall, delay) in enumerate(pairs):
        answered = delay >= 0
        yield (
            wall + (delay if answered else DEADLINE_NS),
            NetworkDelay(
                wall_ns=wall,
                mono_ns=wall,
                iface="",
                peer=Role.STATION.value,
                method=METHOD,
                sequence=sequence,
                delay_ns=delay if answered else None,
                alive=answered,
                late=answered and delay > DEADLINE_NS,
                deadline_ns=DEADLINE_NS,
                unknown={} if answered else {"delay_ns": Unknown.TIMED_OUT},
            ),
        )

"""A recording, a folder with both ends, or a CSV file of 2021: to one run on one clock."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from linkrover.errors import LinkRoverError, ParseError
from linkrover.records import LinkEvent, Manifest, Role, ScanSnapshot

from .columns import RawEnd
from .directions import share_lost_back
from .run import HOLD_S, Clock, End, Run
from .window import Window

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from linkrover.importer.trial import Trial

    from .run import Columns

    Times = NDArray[np.int64]

ENDS = ("robot", "station")
CLOCK_STEP_NS = 50_000_000
TIGHT = 1.5


def load_run(
    path: str | Path, *, case: str | None = None, trial: int | None = None, topics: str | Path | None = None
) -> Run:
    """Load a run: a folder with `robot/` and `station/`, one recording, a ROS 1 bag, or a CSV file of 2021.

    `case` and `trial` override what the recording says; `topics` is a TOML table of topic patterns for other people's
    bags. Raises LinkRoverError where there is nothing to read; what is damaged or missing stands in `Run.problems`.
    """
    path = Path(path)
    if not path.exists():
        raise LinkRoverError(f"{path}: no such run; give a folder with robot/ and station/, a recording or a CSV file")
    if path.suffix.lower() == ".csv":
        from linkrover.importer.trial import load_trial

        return run_of_trial(load_trial(path, case, trial))
    from .recorded import read_raw

    raws, problems = read_raw(path, Path(topics) if topics is not None else None)
    bag = path.suffix.lower() == ".bag"
    run = build_run(path.stem if bag else path.resolve().name, str(path), raws, problems)
    if bag and run.case is None:
        from linkrover.importer.naming import guess_setup

        setup = guess_setup(path.name)
        run.case, run.trial, run.factors = setup.case, setup.trial, setup.factors()
    run.case = case if case is not None else run.case
    run.trial = trial if trial is not None else run.trial
    return run


def run_of_trial(trial: Trial) -> Run:
    """The run of an imported file, straight from its columns."""
    import numpy as np

    raws: dict[str, RawEnd] = {}
    for role, topics in trial.ends.items():
        raw = RawEnd(manifest=trial.manifest(role))
        if not (topics.utilization or topics.errors or topics.wireless or topics.pose is not None):
            continue
        util: dict[tuple[str, ...], Columns] = {}
        for iface, table in topics.utilization.items():
            word = np.full(len(table["wall_ns"]), "steady", object)
            word[0] = "first"
            word[table["back"] == 1] = "back"
            word[table["reset"] == 1] = "reset"
            util[(iface,)] = {k: v for k, v in table.items() if k not in ("reset", "back")} | {"continuity": word}
        raw.tables["LinkUtilization"] = util
        raw.tables["NetworkErrors"] = {(i,): dict(t) for i, t in topics.errors.items()}
        wireless: dict[tuple[str, ...], Columns] = {}
        for iface, table in topics.wireless.items():
            wireless[(iface,)] = dict(table)
            wireless[(iface,)]["source"] = np.full(len(table["wall_ns"]), "wext", object)
        raw.tables["WirelessLink"] = wireless
        if topics.delay is not None:
            delay = np.where(topics.delay["delay_ns"] >= 0, topics.delay["delay_ns"], np.nan)
            raw.tables["NetworkDelay"] = {
                ("ros1 action",): {
                    "wall_ns": topics.delay["wall_ns"],
                    "delay_ns": delay,
                    "deadline_ns": np.full(len(delay), 2e9),
                }
            }
        if topics.pose is not None:
            raw.tables["Pose"] = {(): dict(topics.pose)}
        if topics.command is not None:
            raw.tables["VelocityCommand"] = {(): dict(topics.command)}
        for tables in raw.tables.values():
            for columns in tables.values():
                columns["mono_ns"] = columns["wall_ns"]
        raws[role.value] = raw
    return build_run(trial.name, trial.sheet.file, raws, [])


def build_run(name: str, path: str, raws: dict[str, RawEnd], problems: list[str]) -> Run:
    """Join what was read of each end. `raws` may also hold "truth"."""
    problems = [*problems, *(f"{role}: {p}" for role, raw in raws.items() for p in raw.problems)]
    manifests = [raw.manifest for raw in raws.values() if raw.manifest is not None]
    published = any(m.notes.get("publisher") == "2021" for m in manifests) or any(
        r.published_2021 for r in raws.values()
    )
    shifts, clock = _join_clocks(raws, published, problems)
    local = {role: _Clock(raw, shifts.get(role), problems, role) for role, raw in raws.items()}
    firsts = [c.first for role, c in local.items() if c.first is not None and role in ENDS]
    if not firsts:
        raise ParseError(path, "recordings", "at least one sample from one end", "none")
    origin = local["robot"].first if "robot" in local and local["robot"].first is not None else min(firsts)
    assert origin is not None
    ends = {role: _end(role, raw, local[role], origin) for role, raw in raws.items() if role in ENDS}
    for role in ENDS:
        if role not in ends:
            problems.append(f"{role}: no recording of this end; its figures are missing")
    span = _span(local, origin, problems)
    _say_what_is_missing(ends, problems)
    if published:
        _say_what_is_double(ends, problems)
    notes: dict[str, str] = {}
    for manifest in reversed(manifests):
        notes.update(manifest.notes)
    truth_tables = raws["truth"].tables if "truth" in raws else {}
    truth = {
        f"{kind}:{'/'.join(key)}": {"t_s": local["truth"].seconds(table, origin), **table}
        for kind, groups in truth_tables.items()
        for key, table in groups.items()
    }
    rows = notes.get("rows_in_file", "")
    return Run(
        name=next((m.run for m in manifests if m.run), name),
        path=path,
        ends=ends,
        origin_ns=origin,
        span=span,
        clock=clock,
        case=next((m.case for m in manifests if m.case is not None), None),
        trial=next((m.trial for m in manifests if m.trial is not None), None),
        factors=_factors(next((m.case for m in manifests if m.case is not None), None), notes),
        published_2021=published,
        problems=tuple(dict.fromkeys(problems)),
        repairs=tuple(dict.fromkeys(r for m in manifests for r in m.repairs)),
        truth=truth,
        summary_rows=_summary_rows(notes, problems),
        rows_in_file=int(rows) if rows.isdigit() else None,
    )


def _factors(case: str | None, notes: dict[str, str]) -> dict[str, str]:
    """What is varied between cases: from the manifest's notes, else as far as the case's name says it."""
    from linkrover.importer.naming import factors_of_case

    found = factors_of_case(case) if case is not None else {}
    found |= {k: notes[k] for k in ("ap", "band", "adapter") if k in notes}
    return found | {k.removeprefix("factor."): v for k, v in notes.items() if k.startswith("factor.")}


def _summary_rows(notes: dict[str, str], problems: list[str]) -> dict[str, list[float]]:
    text = notes.get("summary_rows")
    if not text:
        return {}
    try:
        found = json.loads(text)
        return {str(k): [float(x) for x in v] for k, v in found.items()}
    except (ValueError, TypeError, AttributeError):
        problems.append("manifest: the note summary_rows cannot be read; the file's appended rows are left out")
        return {}


class _Clock:
    """One end's samples in nanoseconds on the joined clock: monotonic within the end, wall between the ends."""

    def __init__(self, raw: RawEnd, shift: Shift | None, problems: list[str], role: str) -> None:
        import numpy as np

        tables = [t for kind, groups in raw.tables.items() for t in groups.values() if len(t["wall_ns"])]
        stamped = [t for kind, groups in raw.tables.items() if kind not in _EARLY for t in groups.values()]
        stamped = [t for t in stamped if len(t["wall_ns"])] or tables
        self.first: int | None = None
        self.last: int | None = None
        if not stamped:
            return
        anchor = min(stamped, key=lambda t: int(t["mono_ns"][0]))
        self._shift = shift
        self._offset = int(anchor["wall_ns"][0] - anchor["mono_ns"][0])
        self.first = int(min(self.nanoseconds(t).min() for t in stamped))
        self.last = int(max(self.nanoseconds(t).max() for t in stamped))
        drift = max(float(np.abs(t["wall_ns"] - t["mono_ns"] - self._offset).max()) for t in stamped)
        if drift > CLOCK_STEP_NS:
            problems.append(f"{role}: its wall clock was stepped by {drift / 1e9:.3f} s; monotonic times were taken")

    def nanoseconds(self, table: Columns) -> Times:
        import numpy as np

        mono = np.asarray(table["mono_ns"], dtype=np.int64)
        wall: Times = mono + np.int64(self._offset)
        return wall if self._shift is None else np.asarray(wall + self._shift.at(wall), dtype=np.int64)

    def seconds(self, table: Columns, origin: int) -> NDArray[np.float64]:
        out: NDArray[np.float64] = (self.nanoseconds(table) - origin) / 1e9
        return out


SHORT_OF_USUAL = 0.4  # of the median interval between messages
DOUBLE_AT_LEAST = 5
_EARLY = frozenset({"NetworkDelay", "ProbeResult"})  # stamped at their sending, recorded later


class Shift:
    """Nanoseconds to add to an end's wall clock to get the robot's: the measured offsets, linear between them.

    Only offsets whose bound is near the best one count: a loaded link gives wide bounds, which say little.
    """

    def __init__(self, table: Columns, sign: int) -> None:
        import numpy as np

        bound = table["error_bound_ns"]
        kept = bound <= TIGHT * np.nanmin(bound)
        self._from = int(table["wall_ns"][kept][0])
        self._knots = (table["wall_ns"][kept] - self._from).astype(np.float64)
        self._values = sign * table["offset_ns"][kept]
        self.bound_ns = float(bound[kept].max())

    def at(self, wall_ns: Times) -> Times:
        """The shift at each time of the end's clock."""
        import numpy as np

        shift = np.interp(wall_ns - self._from, self._knots, self._values)
        return np.asarray(np.rint(shift), dtype=np.int64)


def _join_clocks(raws: dict[str, RawEnd], published: bool, problems: list[str]) -> tuple[dict[str, Shift], Clock]:
    """How to get from each end's wall clock to the robot's."""
    import numpy as np

    if not {"robot", "station"} <= set(raws):
        return {}, Clock("one end only", None, None)
    if published:
        return {}, Clock("one clock: the robot wrote both ends' messages", 0, None)
    for role, sign in (("robot", -1), ("station", 1)):
        table = raws[role].table("ClockOffset")
        if table is None or not np.isfinite(table["error_bound_ns"]).any():
            continue
        best = int(np.nanargmin(table["error_bound_ns"]))
        shift = Shift(table, sign)
        return {"station": shift}, Clock("probe", -sign * int(table["offset_ns"][best]), int(shift.bound_ns))
    boots = {raw.manifest.boot_id for role, raw in raws.items() if role in ENDS and raw.manifest is not None}
    if len(boots) == 1 and None not in boots:
        return {}, Clock("same machine", 0, 0)
    problems.append(
        "no clock offset was measured (no probe between the ends): the ends are joined by their wall clocks as they "
        "are, so one-way delays are not given"
    )
    return {}, Clock("wall clocks as they are", None, None)


def _span(local: dict[str, _Clock], origin: int, problems: list[str]) -> Window:
    """The time of the run: that of the robot's recording, else the station's."""
    spans = {r: (c.first, c.last) for r, c in local.items() if r in ENDS and c.first is not None and c.last is not None}
    if len(spans) == 2:
        (a, b), (c, d) = spans["robot"], spans["station"]
        if d <= a or c >= b:
            gap = max(a - d, c - b) / 1e9
            problems.append(
                f"the recordings do not overlap in time: {gap:.1f} s lie between them; each end's figures are of its "
                "own time"
            )
        elif (min(b, d) - max(a, c)) < 0.9 * (max(b, d) - min(a, c)):
            problems.append(
                f"the ends were recorded together for {(min(b, d) - max(a, c)) / 1e9:.1f} s only, of "
                f"{(max(b, d) - min(a, c)) / 1e9:.1f} s in all"
            )
    begin, end = spans.get("robot") or spans["station"]
    return Window.of((begin - origin) / 1e9, (end - origin) / 1e9)


def _say_what_is_missing(ends: dict[str, End], problems: list[str]) -> None:
    for what in ("case", "trial"):
        said = {role: getattr(e.manifest, what) for role, e in ends.items() if e.manifest is not None}
        if len({value for value in said.values() if value is not None}) > 1:
            words = ", ".join(f"the {role} {value}" for role, value in said.items())
            problems.append(f"the ends disagree on the {what}: {words}; are they recordings of one run?")
    if all(e.probe is None for e in ends.values()) and not any(e.delays for e in ends.values()):
        problems.append("no probe and no application delay was recorded: delay, loss and outages are unknown")
    if all(e.pose is None for e in ends.values()):
        problems.append("no odometry was recorded: no trajectory, and standing still cannot be told from moving")
    for role, end in ends.items():
        if not end.utilization:
            problems.append(f"{role}: no link utilisation was recorded")
        if not end.wireless:
            problems.append(f"{role}: no wireless link was recorded")


def _say_what_is_double(ends: dict[str, End], problems: list[str]) -> None:
    """A node started twice publishes every second's traffic twice: short and long intervals in turn."""
    import numpy as np

    for role, end in ends.items():
        for iface, table in end.utilization.items():
            taken = table["has_base"] & (table["bits"] > 0)
            length = (table["t_s"] - table["begin_s"])[taken]
            short = length < SHORT_OF_USUAL * np.median(length) if len(length) else length
            if short.sum() >= DOUBLE_AT_LEAST:
                share = table["bits"][taken][short].sum() / max(float(table["bits"][taken].sum()), 1.0)
                problems.append(
                    f"{role}/{iface}: {int(short.sum())} messages came from a second publisher; throughput of this "
                    f"interface is up to {100 * share:.0f} % too high"
                )


def _end(role: str, raw: RawEnd, clock: _Clock, origin: int) -> End:
    import numpy as np

    def ready(table: Columns) -> Columns:
        t_s = clock.seconds(table, origin)
        out = {"t_s": t_s, "time_ns": clock.nanoseconds(table), **table}
        del out["mono_ns"]
        if "t1_ns" not in table and "offset_ns" not in table:
            del out["wall_ns"]
        if len(t_s) > 1 and (np.diff(t_s) < 0).any():
            order = np.argsort(t_s, kind="stable")
            out = {name: column[order] for name, column in out.items()}
        return out

    def by_iface(kind: str) -> dict[str, Columns]:
        # taken out of the raw tables, so that long recordings are not held twice
        return {key[0]: ready(t) for key, t in raw.tables.pop(kind, {}).items() if len(t["wall_ns"])}

    def single(kind: str) -> Columns | None:
        table = raw.tables.pop(kind, {}).get(())
        return ready(table) if table is not None and len(table["wall_ns"]) else None

    end = End(role=role, manifest=raw.manifest)
    if clock.first is None:
        return end
    end.utilization = {iface: _increments(table) for iface, table in by_iface("LinkUtilization").items()}
    end.errors = by_iface("NetworkErrors")
    end.stations = by_iface("StationLink")
    end.wireless = _wireless(by_iface("WirelessLink"), end.stations)
    end.connections = by_iface("TcpConnection")
    end.probe, end.offset, end.account = single("ProbeResult"), single("ClockOffset"), single("SelfAccount")
    end.probe = _one_fate(end.probe)
    end.pose, end.command = single("Pose"), single("VelocityCommand")
    # an answer after the deadline is recorded under "METHOD late" beside the loss it does not undo
    end.delays = {method: table for method, table in by_iface("NetworkDelay").items() if not method.endswith(" late")}
    if end.probe is not None:
        end.delays.pop("stamp", None)  # the probe's own results in short
    end.traffic = {
        (key[0], key[1], key[2], key[3]): ready(t)
        for key, t in raw.tables.pop("TopicTraffic", {}).items()
        if len(t["wall_ns"])
    }
    end.surveys = {
        (key[0], int(key[1])): ready(t) for key, t in raw.tables.pop("ChannelSurvey", {}).items() if len(t["wall_ns"])
    }
    end.events = tuple(sorted(((_event_time(e, clock, origin), e) for e in raw.events), key=lambda pair: pair[0]))
    end.scans = tuple(sorted(((_event_time(e, clock, origin), e) for e in raw.scans), key=lambda pair: pair[0]))
    end.alive = _alive([*end.utilization.values(), *end.errors.values(), *end.wireless.values()])
    return end


def _one_fate(probes: Columns | None) -> Columns | None:
    """Each probe once, by its last record: a loss is reported again when its direction is known.

    Of several peers the one with most probes: delays to two stations are two links.
    """
    import numpy as np

    if probes is None:
        return None
    peers = probes.pop("peer").tolist()
    names = set(peers)
    if len(names) > 1:
        most = max(names, key=peers.count)
        kept = np.array([p == most for p in peers])
        probes = {name: column[kept] for name, column in probes.items()}
    session, sequence, reflected = (probes.pop(n) for n in ("session", "sequence", "reflector_sequence"))
    order = np.lexsort((np.arange(len(session)), sequence, session))
    last = np.ones(len(order), bool)
    last[:-1] = (np.diff(session[order]) != 0) | (np.diff(sequence[order]) != 0)
    rows = np.sort(order[last])
    if not last.all():
        probes = {name: column[rows] for name, column in probes.items()}
    share = share_lost_back(session[rows], sequence[rows], reflected[rows], probes["state"])
    return {**probes, "share_lost_back": share}


def _event_time(event: LinkEvent | ScanSnapshot, clock: _Clock, origin: int) -> float:
    import numpy as np

    return float(clock.seconds({"mono_ns": np.array([event.mono_ns])}, origin)[0])


def _alive(tables: Iterable[Columns]) -> Window:
    import numpy as np

    times = [t["t_s"] for t in tables]
    if not times:
        return Window(np.zeros(0), np.zeros(0))
    every = np.unique(np.concatenate(times))
    stops = np.minimum(np.append(every[1:], np.inf), every + HOLD_S)
    joined = np.concatenate(([False], stops[:-1] >= every[1:]))
    return Window(every[~joined], stops[np.append(~joined[1:], True)])


def _increments(table: Columns) -> Columns:
    """Bits of each interval from the counters; `has_base` where the counters ran through it.

    `published` is the increment of the message whatever the interval, for the paper's method.
    """
    import numpy as np

    t = table["t_s"]
    word = table["continuity"]
    begin = np.concatenate(([t[0]], t[:-1]))
    baseless = np.isin(word, ("first", "reset", "gone", "back"))
    baseless[0] = True
    out: Columns = {**table, "begin_s": begin}
    wrapped = word == "wrapped"
    good = ~baseless
    for direction in ("tx", "rx"):
        counter = table[f"{direction}_bytes"].astype(np.float64)
        step = np.diff(counter, prepend=0.0) * 8
        if wrapped.any() and f"{direction}_rate_bps" in table:
            step = np.where(wrapped, table[f"{direction}_rate_bps"] * table["interval_ns"] / 1e9, step)
        out[f"{direction}_published"] = np.where(word == "reset", np.nan, step / 1e6)
        good = good & np.isfinite(step) & (step >= 0)
        out[f"{direction}_bits"] = step
    good = good & (t > begin)
    for direction in ("tx", "rx"):
        out[f"{direction}_bits"] = np.where(good, out[f"{direction}_bits"], 0.0)
    out["bits"] = out["tx_bits"] + out["rx_bits"]
    out["has_base"] = good
    return out


def _wireless(links: dict[str, Columns], stations: dict[str, Columns]) -> dict[str, Columns]:
    """Signal tables by interface; an access point without readings of its own takes those of its stations."""
    import numpy as np

    out: dict[str, Columns] = {}
    for iface, table in links.items():
        out[iface] = _one_peer(table)
    for iface, table in stations.items():
        known = out.get(iface)
        if known is None or not np.isfinite(known["rssi_dbm"]).any():
            filled = _one_peer(table)
            nothing = np.full(len(filled["t_s"]), np.nan)
            out[iface] = {"connected": np.ones(len(nothing)), "link_quality": nothing, **filled}
    return out


def _one_peer(table: Columns) -> Columns:
    """Of an access point's peers the one with the most readings: one robot's link, not a mixture."""
    import numpy as np

    peers = table.get("peer")
    if peers is None:
        return table
    names = [p for p in peers.tolist() if p]
    if len(set(names)) < 2:
        return table
    most = max(set(names), key=names.count)
    kept = np.array([p == most or not p for p in peers.tolist()])
    return {name: column[kept] for name, column in table.items()}


__all__ = ["Manifest", "Role", "build_run", "load_run", "run_of_trial"]

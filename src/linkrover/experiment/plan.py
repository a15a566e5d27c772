"""A plan: cases x trials as data (TOML), decoded strictly; every wrong key is named with what is allowed there."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any, Literal

import msgspec

from linkrover.emulator import presets
from linkrover.emulator.channel import ChannelConfig
from linkrover.emulator.medium_config import MediumConfig, NodeConfig
from linkrover.emulator.presets import Case
from linkrover.emulator.robot import ROUTES, Drive, Route, Waypoint
from linkrover.emulator.traffic import Traffic
from linkrover.emulator.world import WorldSettings
from linkrover.errors import ConfigError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class CasePlan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One set-up. The emulator's models start from a preset and are changed by channel, medium, nodes and places.

    preset: one of the ten cases by name; by default the one of the same name, else the one with the same
    access_point, adapter and band. robot_interfaces, station_interfaces: what a real campaign measures.
    """

    name: str
    preset: str | None = None
    access_point: Literal["router", "robot", "station"] | None = None
    adapter: str | None = None
    band_ghz: float | None = None
    robot_interfaces: tuple[str, ...] = ("wlan0",)
    station_interfaces: tuple[str, ...] = ("wlan0",)
    trials: int | None = None
    note: str = ""
    channel: dict[str, Any] = {}
    medium: dict[str, Any] = {}
    nodes: dict[str, dict[str, Any]] = {}
    places: dict[str, tuple[float, float]] = {}
    signal_at_access_point: bool = False


class Trajectory(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A route by name, or by waypoints ({x_m, y_m, stop_s}, metres and seconds); and how the robot drives it."""

    route: str = "lab-2021"
    waypoints: tuple[Waypoint, ...] = ()
    drive: Drive = Drive()


class Rates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Samples a second of the agents."""

    wireless_hz: float = 10.0
    utilization_hz: float = 1.0
    errors_hz: float = 1.0


class ProbePlan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The probes of the agents."""

    rate_hz: float = 10.0
    deadline_s: float = 2.0


class Campaign(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A real campaign: where the two agents' control ports are, and the file with the key they share."""

    robot: str = "robot"
    station: str = "station"
    key_file: str | None = None
    peer: str | None = None
    least_free_bytes: int = 500_000_000
    largest_clock_offset_s: float = 1.0


class Plan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """See the module's text. duration_s: of a trial; absent = until the drive is over. robots: how many share the
    air; all but the first only send the traffic (real time only).
    """

    name: str
    cases: tuple[CasePlan, ...]
    trials: int = 1
    seed: int = 1
    duration_s: float | None = None
    robots: int = 1
    note: str = ""
    trajectory: Trajectory = Trajectory()
    traffic: Traffic = Traffic()
    rates: Rates = Rates()
    probe: ProbePlan = ProbePlan()
    campaign: Campaign = Campaign()


class TrialPlan(msgspec.Struct, frozen=True, kw_only=True):
    """One run of a plan."""

    case: CasePlan
    trial: int
    seed: int

    @property
    def folder(self) -> str:
        """Where it goes, within the folder of the plan's runs."""
        return f"{self.case.name}/trial-{self.trial}"


def load_plan(path: Path) -> Plan:
    """Read a plan.

    Raises:
        ConfigError: it cannot be read, or a key or value in it cannot be used; names the key and what is allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read the plan {path}: {error}") from error
    return parse_plan(text, str(path))


def parse_plan(text: str, file: str = "plan") -> Plan:
    """Decode and check a plan's text.

    Raises:
        ConfigError: as load_plan.
    """
    try:
        tree = msgspec.toml.decode(text.encode("utf-8", "surrogatepass"))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{file} is not TOML: {error}") from error
    plan: Plan = convert(tree, Plan, file, "")
    _check(plan, file)
    return plan


def convert(tree: Any, kind: type[Any], file: str, prefix: str) -> Any:
    """Strictly to `kind`.

    Raises:
        ConfigError: names the key, and the nearest or all that are allowed.
    """
    try:
        return msgspec.convert(tree, kind, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(_explain(str(error), kind, file, prefix)) from error
    except ConfigError as error:
        # the value checks of the models name the key themselves
        raise ConfigError(f"{file}: {prefix.rpartition('].')[0]}{']: ' if prefix else ''}{error}") from error


def _explain(message: str, kind: type[Any], file: str, prefix: str) -> str:
    what, _, place = message.partition(" - at `$")
    place = prefix + place.rstrip("`").lstrip(".")
    unknown = re.search(r"unknown field `([^`]*)`", what)
    if unknown is None:
        return f"{file}: {place or 'the plan'}: {what}"
    key = unknown.group(1)
    allowed = _fields_at(kind, place.removeprefix(prefix))
    near = difflib.get_close_matches(key, allowed, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else f"; allowed are: {', '.join(allowed)}"
    return f"{file}: unknown key '{place + '.' if place else ''}{key}'{hint}"


def _fields_at(kind: type[Any], place: str) -> list[str]:
    """Names of the fields of the struct at a place such as "cases[0]"."""
    names = [part for part in re.split(r"[.\[\]0-9]+", place) if part and part != "..."]
    for name in names:
        found = next((field.type for field in msgspec.structs.fields(kind) if field.name == name), None)
        inner = getattr(found, "__args__", (found,))[0]
        if not (isinstance(inner, type) and issubclass(inner, msgspec.Struct)):
            break
        kind = inner
    return [field.name for field in msgspec.structs.fields(kind)]


def _check(plan: Plan, file: str) -> None:
    def refuse(key: str, value: object, allowed: str) -> None:
        raise ConfigError(f"{file}: {key} = {value!r}: must be {allowed}")

    if not _NAME.fullmatch(plan.name):
        refuse("name", plan.name, "1 to 64 letters, digits, '.', '_' or '-': it names the folder of the runs")
    if not plan.cases:
        refuse("cases", [], "at least one case ([[cases]])")
    if not 1 <= plan.trials <= 1000:
        refuse("trials", plan.trials, "1 to 1000")
    if plan.duration_s is not None and not 1 <= plan.duration_s <= 86400:
        refuse("duration_s", plan.duration_s, "1 to 86400 seconds, or absent: until the drive is over")
    if plan.trajectory.route not in ROUTES and not plan.trajectory.waypoints:
        refuse("trajectory.route", plan.trajectory.route, f"one of {', '.join(ROUTES)}; or give waypoints")
    if plan.trajectory.waypoints:
        try:
            Route(waypoints=plan.trajectory.waypoints)
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from error
    for key in ("wireless_hz", "utilization_hz", "errors_hz"):
        value = getattr(plan.rates, key)
        if not (value == 0 or 0.001 <= value <= 1000):
            refuse(f"rates.{key}", value, "0 (off) or 0.001 to 1000")
    if not 1 <= plan.probe.rate_hz <= 1000:
        refuse("probe.rate_hz", plan.probe.rate_hz, "1 to 1000")
    if not 0.001 <= plan.probe.deadline_s <= 60:
        refuse("probe.deadline_s", plan.probe.deadline_s, "0.001 to 60")
    seen: set[str] = set()
    for index, case in enumerate(plan.cases):
        if not _NAME.fullmatch(case.name):
            refuse(f"cases[{index}].name", case.name, "1 to 64 letters, digits, '.', '_' or '-': it names a folder")
        if case.name in seen:
            refuse(f"cases[{index}].name", case.name, "unlike every other case's")
        seen.add(case.name)
        if case.trials is not None and not 1 <= case.trials <= 1000:
            refuse(f"cases[{index}].trials", case.trials, "1 to 1000")
        if case.band_ghz is not None and case.band_ghz not in (2.4, 5.0, 6.0):
            refuse(f"cases[{index}].band_ghz", case.band_ghz, "2.4, 5 or 6")
        for key in ("robot_interfaces", "station_interfaces"):
            if not getattr(case, key):
                refuse(f"cases[{index}].{key}", [], "at least one interface, such as ['wlan0']")


def trials(plan: Plan, only: tuple[str, ...] = ()) -> list[TrialPlan]:
    """All runs in order: the first trial of each case, then the second, so that time of day is spread over the cases.

    Raises:
        ConfigError: a name in `only` is no case of the plan.
    """
    names = [case.name for case in plan.cases]
    for name in only:
        if name not in names:
            raise ConfigError(f"case {name!r}: no such case in the plan; there are {', '.join(names)}")
    found = []
    for trial in range(1, max(case.trials or plan.trials for case in plan.cases) + 1):
        for index, case in enumerate(plan.cases):
            if trial <= (case.trials or plan.trials) and (not only or case.name in only):
                found.append(TrialPlan(case=case, trial=trial, seed=plan.seed + 1000 * (index + 1) + trial))
    return found


def emulated_case(case: CasePlan, file: str = "plan") -> Case:
    """The emulator's case: the preset with the plan's changes.

    Raises:
        ConfigError: no preset fits, or a change names an unknown key or an impossible value.
    """
    base = _preset(case, file)
    where = f"cases[{case.name}]"
    channel = _changed(base.channel, case.channel, file, f"{where}.channel")
    medium = _changed(base.medium, case.medium, file, f"{where}.medium")
    nodes = dict(base.nodes)
    for name, change in case.nodes.items():
        if name not in ("router", "robot", "station"):
            raise ConfigError(f"{file}: {where}.nodes.{name}: must be one of router, robot, station")
        nodes[name] = _changed(nodes.get(name, NodeConfig()), change, file, f"{where}.nodes.{name}")
    for name in case.places:
        if name not in base.still:
            raise ConfigError(
                f"{file}: {where}.places.{name}: must be one of {', '.join(base.still)} (what stands still)"
            )
    return msgspec.structs.replace(
        base, name=case.name, channel=channel, medium=medium, nodes=nodes, places={**base.places, **case.places}
    )


def _preset(case: CasePlan, file: str) -> Case:
    if case.preset is not None:
        try:
            return presets.find(case.preset)
        except ConfigError as error:
            raise ConfigError(f"{file}: cases[{case.name}].preset: {error}") from error
    if case.name in presets.BY_NAME:
        return presets.BY_NAME[case.name]
    fitting = [
        each
        for each in presets.CASES
        if case.access_point == each.access_point
        and case.adapter in (None, each.adapter)
        and case.band_ghz == each.band_ghz
    ]
    if len(fitting) == 1:
        return fitting[0]
    raise ConfigError(
        f"{file}: cases[{case.name}]: no preset has this name, and access_point, adapter and band_ghz fit "
        f"{len(fitting)} of them: give preset, one of {', '.join(presets.BY_NAME)}"
    )


def _changed(base: Any, change: dict[str, Any], file: str, where: str) -> Any:
    if not change:
        return base
    kind: type[MediumConfig | ChannelConfig | NodeConfig] = type(base)
    allowed = [field.name for field in msgspec.structs.fields(kind)]
    for key in change:
        if key not in allowed:
            near = difflib.get_close_matches(key, allowed, n=1, cutoff=0.5)
            hint = f"did you mean '{near[0]}'?" if near else f"allowed are: {', '.join(allowed)}"
            raise ConfigError(f"{file}: unknown key '{where}.{key}'; {hint}")
    return convert({**msgspec.to_builtins(base), **change}, kind, file, where + ".")


def world_settings(plan: Plan, run: TrialPlan, duration_s: float | None, file: str = "plan") -> WorldSettings:
    """What the emulator is told for one run; duration_s overrides the plan's.

    Raises:
        ConfigError: as emulated_case.
    """
    trajectory = plan.trajectory
    route = Route(waypoints=trajectory.waypoints) if trajectory.waypoints else ROUTES[trajectory.route]
    seconds = duration_s if duration_s is not None else plan.duration_s
    return WorldSettings(
        case=emulated_case(run.case, file),
        seed=run.seed,
        route=route if seconds is None else route.fitted(seconds, trajectory.drive),
        drive=trajectory.drive,
        traffic=plan.traffic,
        robots=plan.robots,
        trial=run.trial,
        run=f"{plan.name}/{run.folder}",
        access_point_shows_signal=run.case.signal_at_access_point,
        rates=msgspec.to_builtins(plan.rates),
        probe=msgspec.to_builtins(plan.probe),
    )

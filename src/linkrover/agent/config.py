"""The agent's configuration: TOML, decoded strictly."""

from __future__ import annotations

import difflib
import typing
from pathlib import Path
from typing import Any

import msgspec

from linkrover.errors import ConfigError
from linkrover.records import Role

RATE_HIGHEST_HZ = 1000.0


class Rates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Samples per second of each kind; 0 turns one off."""

    wireless_hz: float = 10.0
    utilization_hz: float = 1.0
    errors_hz: float = 1.0
    account_hz: float = 1.0
    tcp_hz: float = 1.0
    clock_hz: float = 1.0


class Probe(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """STAMP probes to each peer. An answer after the deadline counts as lost. packet_bytes pads the test packet."""

    rate_hz: float = 10.0
    deadline_s: float = 2.0
    packet_bytes: int = 44
    key_file: str | None = None


class Reflector(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the reflector listens; port None = the probe's default port, host "" = every address."""

    host: str = ""
    port: int | None = None


class Stress(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Consent to `linkrover stress` from whoever holds the token in token_file; None = no consent."""

    token_file: str | None = None
    port: int | None = None


class Outage(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A time without an answered probe longer than threshold_s is an outage."""

    threshold_s: float = 1.0


class AgentConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything an agent can be told. Paths are taken from the working directory."""

    interfaces: tuple[str, ...] = ()
    role: Role = Role.ROBOT
    peers: tuple[str, ...] = ()
    reflect: bool = False
    record: str | None = None
    duration_s: float | None = None
    feed: str | None = None
    wireless_path: str | None = None
    wait: bool = False
    case: str | None = None
    trial: int | None = None
    run: str | None = None
    emulated: bool = False
    log_period_s: float = 5.0
    scan_period_s: float = 0.0  # 0 = never: a scan disturbs the link
    scan_mhz: tuple[int, ...] = ()  # channels to scan; none named = all that the radio may use
    rates: Rates = msgspec.field(default_factory=Rates)
    probe: Probe = msgspec.field(default_factory=Probe)
    reflector: Reflector = msgspec.field(default_factory=Reflector)
    outage: Outage = msgspec.field(default_factory=Outage)
    stress: Stress = msgspec.field(default_factory=Stress)
    notes: dict[str, str] = {}


def load_config(path: Path | str) -> AgentConfig:
    """Read a TOML file.

    Raises:
        ConfigError: it cannot be read, is no TOML, or holds a key or value that is not allowed; names the key.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read the configuration {path}: {error}") from error
    return parse_config(text, str(path))


def parse_config(text: str, file: str = "configuration") -> AgentConfig:
    """Decode TOML text and check it.

    Raises:
        ConfigError: as load_config.
    """
    try:
        tree = msgspec.toml.decode(text.encode("utf-8", "surrogatepass"))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{file} is not TOML: {error}") from error
    _check_keys(tree, AgentConfig, file, "")
    try:
        config = msgspec.convert(tree, AgentConfig, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{file}: {_named(str(error))}") from error
    return check(config, file)


def check(config: AgentConfig, file: str = "configuration") -> AgentConfig:
    """The configuration, if every value is within its range.

    Raises:
        ConfigError: names the key, the value and what is allowed.
    """
    rates = [(f"rates.{field}", getattr(config.rates, field), 0.001) for field in Rates.__struct_fields__]
    for key, hertz, lowest in [*rates, ("probe.rate_hz", config.probe.rate_hz, 1.0)]:
        if not (hertz == 0 or lowest <= hertz <= RATE_HIGHEST_HZ):
            raise ConfigError(f"{file}: {key} = {hertz}: must be 0 (off) or {lowest:g} to {RATE_HIGHEST_HZ:g} Hz")
    for key, value, least, most in (
        ("probe.deadline_s", config.probe.deadline_s, 0.001, 60),
        ("probe.packet_bytes", config.probe.packet_bytes, 44, 1472),
        ("outage.threshold_s", config.outage.threshold_s, 0.01, 3600),
        ("log_period_s", config.log_period_s, 0.1, 86400),
        ("scan_period_s", config.scan_period_s or None, 5, 86400),
        ("duration_s", config.duration_s, 0.001, 1e9),
        ("trial", config.trial, 0, 1e9),
        ("reflector.port", config.reflector.port, 0, 65535),
        ("stress.port", config.stress.port, 0, 65535),
    ):
        if value is not None and not least <= value <= most:
            raise ConfigError(f"{file}: {key} = {value}: must be within {least:g} to {most:g}")
    doubled = {name for name in config.interfaces if config.interfaces.count(name) > 1}
    if doubled:
        raise ConfigError(f"{file}: interfaces: {', '.join(sorted(doubled))} is named twice")
    return config


def to_toml(config: msgspec.Struct) -> str:
    """The configuration as TOML that parse_config reads back; defaults included, unset keys left out."""
    plain: dict[str, Any] = msgspec.to_builtins(config)
    lines: list[str] = []
    tables: list[str] = []
    for key, value in plain.items():
        if isinstance(value, dict):
            body = [f"{_toml(k)} = {_toml(v)}" for k, v in value.items() if v is not None]
            if body:
                tables += ["", f"[{key}]", *body]
        elif value is not None:
            lines.append(f"{key} = {_toml(value)}")
    return "\n".join([*lines, *tables]) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml(item) for item in value)}]"
    # JSON's strings, numbers and booleans are TOML's, but for DEL
    return msgspec.json.encode(value).decode().replace("\x7f", "\\u007f")


def _check_keys(tree: dict[str, Any], kind: type[msgspec.Struct], file: str, prefix: str) -> None:
    fields = {field.name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in tree.items():
        if key not in fields:
            near = _elsewhere(key) or difflib.get_close_matches(key, fields, n=1, cutoff=0.5)
            hint = f"; did you mean '{near[0]}'?" if near else f"; allowed are: {', '.join(fields)}"
            raise ConfigError(f"{file}: unknown key '{prefix}{key}'{hint}")
        inner = fields[key]
        if isinstance(value, dict) and isinstance(inner, type) and issubclass(inner, msgspec.Struct):
            _check_keys(value, inner, file, f"{prefix}{key}.")


def _elsewhere(key: str) -> list[str]:
    """Keys of the same name in other tables: wireless_hz at the top belongs into [rates]."""
    tables = [(name, kind) for name, kind in typing.get_type_hints(AgentConfig).items() if isinstance(kind, type)]
    return [
        f"{name}.{field.name}"
        for name, kind in tables
        if issubclass(kind, msgspec.Struct)
        for field in msgspec.structs.fields(kind)
        if field.name == key
    ]


def _named(message: str) -> str:
    """Msgspec's 'Expected `int`, got `str` - at `$.rates.x`' with the key in front."""
    what, found, place = message.rpartition(" - at `$.")
    if place == "role`":
        what += f"; allowed are: {', '.join(role.value for role in Role)}"
    return f"{place.rstrip('`')}: {what}" if found else message

"""What a ROS 1 node of ours is told: command line first, then parameters as the 2021 package named them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import msgspec

from linkrover.agent import AgentConfig, Probe, Rates
from linkrover.errors import ConfigError
from linkrover.middleware.diagnostics import Thresholds
from linkrover.middleware.sink import Layout
from linkrover.records import Role
from linkrover.sources.interface import interface_names

log = logging.getLogger("linkrover.ros1")

DEFAULT_INTERFACE = "wlan0"
"""The published package's default."""


class Ros1Options(msgspec.Struct, frozen=True, kw_only=True):
    """Everything about one node. None = not given: the parameter server and then the default decide.

    interface: names, each optionally as ALIAS=NAME. ping: action to ask; answer: action to serve; "" = none.
    """

    node: str = "linkrover_client"
    end: str = "robot"
    interface: tuple[str, ...] | None = None
    prefix: str | None = None
    peer: tuple[str, ...] | None = None
    ping: str | None = None
    answer: str | None = None
    reflect: int | None = None  # UDP port of the STAMP reflector, 0 = none
    wireless_hz: float | None = None
    utilization_hz: float | None = None
    errors_hz: float | None = None
    delay_hz: float | None = None
    timeout_s: float | None = None
    odom: str | None = None
    cmd_vel: str | None = None
    frame: str | None = None
    base_frame: str = "base_link"
    traffic_s: float | None = None
    tcp_hz: float = 1.0
    record: str | None = None
    duration_s: float | None = None
    wireless_path: str | None = None
    case: str | None = None
    trial: int | None = None
    emulated: bool = False
    diagnostics: bool = True
    markers: bool = True
    key_file: str | None = None
    thresholds: Thresholds = Thresholds()


PARAMETERS: dict[str, str] = {
    "INTERFACE_NAME": "interface",
    "update_rate_wireless_quality": "wireless_hz",
    "update_rate_link_utilization": "utilization_hz",
    "update_rate_network_errors": "errors_hz",
    "update_rate_network_delay": "delay_hz",
    "timeout_network_delay": "timeout_s",
    "prefix": "prefix",
    "peer": "peer",
    "ping": "ping",
    "answer": "answer",
    "reflect": "reflect",
    "odom": "odom",
    "cmd_vel": "cmd_vel",
    "frame": "frame",
    "traffic_period": "traffic_s",
    "record": "record",
    "case": "case",
    "trial": "trial",
}
"""Parameter -> option; the first six are those of the 2021 package."""

DEFAULTS: dict[str, Any] = {
    "prefix": "{end}/{iface}",
    "peer": (),
    "wireless_hz": 10.0,
    "utilization_hz": 1.0,
    "errors_hz": 1.0,
    "delay_hz": 1.0,
    "timeout_s": 2.0,
    "ping": "",
    "answer": "",
    "reflect": 0,
    "traffic_s": 5.0,
}


def resolve(
    options: Ros1Options, parameter: Callable[[str], Any], defaults: dict[str, Any] | None = None
) -> Ros1Options:
    """Fill what was not given on the command line.

    Raises:
        ConfigError: a parameter of the wrong kind; names it.
    """
    fields = {f.name: f.type for f in msgspec.structs.fields(Ros1Options)}
    found: dict[str, Any] = {}
    for name, field in PARAMETERS.items():
        if getattr(options, field) is not None:
            continue
        value = parameter(name)
        if value is None:
            continue
        if field in ("interface", "peer"):
            value = tuple(str(value).replace(",", " ").split()) if isinstance(value, str) else value
        try:
            found[field] = msgspec.convert(value, fields[field], strict=False)
        except msgspec.ValidationError as error:
            raise ConfigError(f"parameter {name} = {value!r}: {error}") from None
    thresholds = parameter("thresholds")
    if thresholds is not None:
        try:
            found["thresholds"] = msgspec.convert(thresholds, Thresholds, strict=False)
        except msgspec.ValidationError as error:
            raise ConfigError(f"parameter thresholds: {error}") from None
    for field, value in {**DEFAULTS, **(defaults or {})}.items():
        if getattr(options, field) is None:
            found.setdefault(field, value)
    if options.interface is None and "interface" not in found:
        found["interface"] = _default_interface()
    return msgspec.structs.replace(options, **found)


def _default_interface() -> tuple[str, ...]:
    names = interface_names()
    if DEFAULT_INTERFACE not in names:
        log.warning(
            "INTERFACE_NAME is not set and there is no %s here; waiting for it. Set ~INTERFACE_NAME or --interface to "
            "one of: %s", DEFAULT_INTERFACE, ", ".join(names),
        )  # fmt: skip
    return (DEFAULT_INTERFACE,)


def split_interfaces(given: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, str]]:
    """("iface1=wlan0", "wlan1") -> (("wlan0", "wlan1"), {"wlan0": "iface1"}).

    Raises:
        ConfigError: an empty name.
    """
    names: list[str] = []
    aliases: dict[str, str] = {}
    for text in given:
        alias, equals, name = text.rpartition("=")
        if not name or (equals and not alias):
            raise ConfigError(f"interface '{text}': expected NAME or ALIAS=NAME")
        names.append(name)
        if alias:
            aliases[name] = alias
    return tuple(names), aliases


def layout(options: Ros1Options) -> Layout:
    """Where the topics lie."""
    names, aliases = split_interfaces(options.interface or ())
    return Layout(prefix=options.prefix or "", aliases=aliases).check(names)


def agent_config(options: Ros1Options) -> AgentConfig:
    """The agent's part of it. Interfaces are waited for: a robot's adapter may come late or go."""
    names, _ = split_interfaces(options.interface or ())
    missing = [name for name in names if name not in interface_names()]
    if missing:
        log.error(
            "no interface %s here (there are: %s); waiting for it", ", ".join(missing), ", ".join(interface_names())
        )
    return AgentConfig(
        interfaces=names,
        role=Role.ROBOT if options.end == "robot" else Role.STATION,
        peers=options.peer or (),
        reflect=bool(options.reflect),
        reflector=msgspec.convert({"port": options.reflect or None}, type=_reflector()),
        record=options.record,
        duration_s=options.duration_s,
        wireless_path=options.wireless_path,
        wait=True,
        case=options.case,
        trial=options.trial,
        emulated=options.emulated,
        rates=Rates(
            wireless_hz=options.wireless_hz or 0.0,
            utilization_hz=options.utilization_hz or 0.0,
            errors_hz=options.errors_hz or 0.0,
            tcp_hz=options.tcp_hz,
        ),
        probe=Probe(deadline_s=options.timeout_s or 2.0, key_file=options.key_file),
    )


def _reflector() -> Any:
    from linkrover.agent import Reflector

    return Reflector

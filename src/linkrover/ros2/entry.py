"""Runs a ROS 2 node of ours from the command line."""

from __future__ import annotations

import functools
import logging
import signal
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from linkrover.agent import Agent
from linkrover.live.output import Output
from linkrover.ros1.options import DEFAULT_INTERFACE, Ros1Options, agent_config, layout, resolve

from .network import read_network
from .node import Ros2
from .part import Ros2Part
from .stderr import CapturedStderr

DEFAULT_REFLECTOR_PORT = 8620
_NOTHING = {"wireless_hz": 0.0, "utilization_hz": 0.0, "errors_hz": 0.0, "delay_hz": 0.0, "tcp_hz": 0.0}
NODES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    # node: (fixed options, defaults)
    "client": ({"node": "linkrover_client", "end": "robot"}, {"ping": "Ping"}),
    "server": (
        {"node": "linkrover_server", "end": "station"},
        {"answer": "Ping", "reflect": DEFAULT_REFLECTOR_PORT},
    ),
    "ping-server": (
        {"node": "linkrover_ping_server", "end": "station", "interface": (), "diagnostics": False, **_NOTHING},
        {"answer": "Ping", "reflect": DEFAULT_REFLECTOR_PORT, "prefix": ""},
    ),
}

log = logging.getLogger("linkrover.ros2")


class Ros2Options(Ros1Options, frozen=True, kw_only=True):
    """As a ROS 1 node is told, and which DDS domain to join. dds_peers: hosts to find by unicast, multicast off."""

    domain: int | None = None
    dds_peers: tuple[str, ...] = ()


def run(kind: str, changes: dict[str, Any], remappings: Sequence[str] = ()) -> int:
    """Run a node until SIGINT or SIGTERM, or for its duration. Returns the exit status.

    Raises:
        LinkRoverError: an option, variable or path that cannot be used.
    """
    fixed, defaults = NODES[kind]
    options = Ros2Options(**{**fixed, **changes})
    captured = CapturedStderr()
    output = Output(captured.terminal)
    captured.start(output.write)
    handler = _ToOutput(output)
    family = logging.getLogger("linkrover")
    family.setLevel(logging.INFO)
    family.propagate = False
    family.addHandler(handler)
    node: Ros2 | None = None
    try:
        node = Ros2(options.node, remappings, network=read_network(options.domain, options.dds_peers))
        options = _resolved(options, defaults)
        places = layout(options)
        config = agent_config(options)
        agent = Agent(config, parts=[Ros2Part(node, options, places)], middleware=node.describe())
        if options.record is not None:
            _record(agent, Path(options.record) / config.role.value)
        stopped_by: list[int] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, functools.partial(_stop, agent, stopped_by))
        node.start()
        agent.run()
        cut_short = options.duration_s is not None and signal.SIGINT in stopped_by
        return 130 if cut_short else 0
    finally:
        if node is not None:
            node.close()
        family.removeHandler(handler)
        captured.close()
        output.close()


def _resolved(options: Ros2Options, defaults: dict[str, Any]) -> Ros2Options:
    """Fill in what was not given; ROS 2 has no parameter server to ask."""
    port_given = options.reflect is not None
    if options.interface is None:
        names = [name for _, name in socket.if_nameindex()]
        if DEFAULT_INTERFACE not in names:
            log.warning(
                "no --interface given and no %s here; waiting for it (there are: %s)",
                DEFAULT_INTERFACE, ", ".join(names),
            )  # fmt: skip
        options = msgspec.structs.replace(options, interface=(DEFAULT_INTERFACE,))
    found = resolve(options, lambda _: None, defaults)
    assert isinstance(found, Ros2Options)
    if found.reflect and not port_given:
        found = msgspec.structs.replace(found, reflect=_free_port(found.reflect))
    return found


def _free_port(port: int) -> int:
    """The default port, or another where it is taken: clients find it in the node's user data."""
    with socket.socket(socket.AF_INET6 if socket.has_dualstack_ipv6() else socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind(("", port))
        except OSError:
            trial.bind(("", 0))
            other = int(trial.getsockname()[1])
            log.warning("UDP port %d is taken: STAMP probes are answered on %d", port, other)
            return other
    return port


def _stop(agent: Agent, stopped_by: list[int], number: int, _frame: object) -> None:
    stopped_by.append(number)
    agent.request_stop()


def _record(agent: Agent, directory: Path) -> None:
    from linkrover.bag.recorder import Recorder

    recorder = Recorder(directory, agent.manifest, on_event=lambda event: agent.publish_from(recorder, event))
    agent.add_sink(recorder)
    log.info("recording to %s", directory)


class _ToOutput(logging.Handler):
    """Lines to standard error through a thread: a stalled terminal must not hold up sampling."""

    def __init__(self, output: Output) -> None:
        super().__init__(logging.INFO)
        self.setFormatter(logging.Formatter("linkrover: %(levelname)s: %(message)s"))
        self._output = output

    def emit(self, record: logging.LogRecord) -> None:
        self._output.write(self.format(record) + "\n")

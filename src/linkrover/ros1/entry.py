"""Runs a node: from the command line, from rosrun and roslaunch, or by its published name."""

from __future__ import annotations

import functools
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from linkrover.agent import Agent
from linkrover.errors import LinkRoverError
from linkrover.live.output import Output

from .graph import Parameters
from .node import Ros1
from .options import Ros1Options, agent_config, layout, resolve
from .part import Ros1Part
from .rosout import RosoutHandler
from .rpc import RpcError

log = logging.getLogger("linkrover.ros1")

DEFAULT_REFLECTOR_PORT = 8620
LEAVE_S = 5.0
_NOTHING = {
    "wireless_hz": 0.0,
    "utilization_hz": 0.0,
    "errors_hz": 0.0,
    "delay_hz": 0.0,
    "traffic_s": 0.0,
    "tcp_hz": 0.0,
}
_2021: dict[str, Any] = {"prefix": ""}
NODES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    # node: (fixed options, defaults)
    "client": ({"node": "linkrover_client", "end": "robot"}, {"ping": "Ping"}),
    "server": (
        {"node": "linkrover_server", "end": "station"},
        {"answer": "Ping", "reflect": DEFAULT_REFLECTOR_PORT},
    ),
    "pingactionserver": (
        {"node": "pingactionserver", "end": "station", "interface": (), **_NOTHING},
        {"answer": "Ping", "reflect": DEFAULT_REFLECTOR_PORT, "prefix": ""},
    ),
    "link_utilization": ({"node": "link_utilization", **_NOTHING, "utilization_hz": None}, _2021),
    "network_errors": ({"node": "network_errors", **_NOTHING, "errors_hz": None}, _2021),
    "wireless_quality": ({"node": "wireless_quality", **_NOTHING, "wireless_hz": None}, _2021),
    "network_delay": ({"node": "network_delay", **_NOTHING, "delay_hz": None}, {**_2021, "ping": "Ping"}),
}


def main(kind: str, arguments: Sequence[str]) -> int:
    """A node as rosrun and roslaunch start it: no options but remappings and parameters.

    Returns the exit status.
    """
    try:
        fixed, defaults = NODES[kind]
        return run(Ros1Options(**fixed), arguments, defaults)
    except LinkRoverError as error:
        print(f"{kind}: {error}", file=sys.stderr)
        return 1


def run(options: Ros1Options, arguments: Sequence[str] = (), defaults: dict[str, Any] | None = None) -> int:
    """Run a node until SIGINT or SIGTERM, or for its duration. Returns the exit status.

    Raises:
        LinkRoverError: an option, parameter or path that cannot be used.
    """
    output = Output(sys.stderr.fileno())
    handler = _ToOutput(output)
    family = logging.getLogger("linkrover")
    family.setLevel(logging.INFO)
    family.propagate = False
    family.addHandler(handler)
    node = Ros1(options.node, arguments)
    code = 1
    try:
        parameter = _parameter(node)
        port_given = options.reflect is not None or parameter("reflect") is not None
        options = resolve(options, parameter, defaults)
        if options.reflect and not port_given:
            options = msgspec.structs.replace(options, reflect=_free_port(options.reflect))
        places = layout(options)
        config = agent_config(options)
        part = Ros1Part(node, options, places)
        agent = Agent(config, parts=[part], middleware=node.describe())
        if options.record is not None:
            _record(agent, Path(options.record) / config.role.value)
        rosout = RosoutHandler(node)
        family.addHandler(rosout)
        stopped_by: list[int] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, functools.partial(_stop, agent, stopped_by))
        node.start()
        agent.run()
        family.removeHandler(rosout)
        cut_short = options.duration_s is not None and signal.SIGINT in stopped_by
        code = 130 if cut_short else 0
        return code
    finally:
        node.close()
        family.removeHandler(handler)
        output.close()
        _end_in_time(code)


def _free_port(port: int) -> int:
    """The default port, or another where it is taken: clients find it by the parameter stamp_reflector."""
    with socket.socket(socket.AF_INET6 if socket.has_dualstack_ipv6() else socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind(("", port))
        except OSError:
            trial.bind(("", 0))
            other = int(trial.getsockname()[1])
            log.warning("UDP port %d is taken: STAMP probes are answered on %d", port, other)
            return other
    return port


def _end_in_time(code: int) -> None:
    """Everything is closed by now; threads of rospy that hang on a dead link must not hold the process for a minute."""
    last = threading.Timer(LEAVE_S, os._exit, (code,))
    last.daemon = True
    last.start()


def _stop(agent: Agent, stopped_by: list[int], number: int, _frame: object) -> None:
    stopped_by.append(number)
    agent.request_stop()


def _record(agent: Agent, directory: Path) -> None:
    from linkrover.bag.recorder import Recorder

    recorder = Recorder(directory, agent.manifest, on_event=lambda event: agent.publish_from(recorder, event))
    agent.add_sink(recorder)
    log.info("recording to %s", directory)


def _parameter(node: Ros1) -> Callable[[str], Any]:
    """Looks parameters up; without a master only those of the command line are there."""
    parameters = Parameters(node.node, node.argv)
    state = {"away": False}

    def get(name: str) -> Any:
        if not state["away"]:
            try:
                return parameters.get(name)
            except RpcError as error:
                state["away"] = True
                log.warning("no ROS master (%s): using the command line and the defaults instead of parameters", error)
        return parameters.private(name)

    return get


class _ToOutput(logging.Handler):
    """Lines to standard error through a thread: a stalled terminal must not hold up sampling."""

    def __init__(self, output: Output) -> None:
        super().__init__(logging.INFO)
        self.setFormatter(logging.Formatter("linkrover: %(levelname)s: %(message)s"))
        self._output = output

    def emit(self, record: logging.LogRecord) -> None:
        self._output.write(self.format(record) + "\n")

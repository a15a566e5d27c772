"""What the master knows: parameters and the graph, asked by calls that end in time."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any

from linkrover.middleware.protocol import Graph, TopicInfo

from .rpc import Rpc, master_uri


class Parameters:
    """Parameters as ROS users set them: `~name` first, then `name` in the namespace, then `/name`."""

    def __init__(self, node: str, argv: Sequence[str] = (), timeout_s: float = 2.0) -> None:
        given = dict(a.split(":=", 1) for a in argv if ":=" in a)
        self.node = given.get("__name", node)
        namespace = "/" + given.get("__ns", os.environ.get("ROS_NAMESPACE", "/")).strip("/")
        self.namespace = namespace if namespace.endswith("/") else namespace + "/"
        self._private = {k[1:]: v for k, v in given.items() if re.match(r"_[A-Za-z]", k)}
        self._timeout_s = timeout_s

    def private(self, name: str) -> Any:
        """The value given on the command line (`_name:=value`), None = not given."""
        if name not in self._private:
            return None
        import yaml

        return yaml.safe_load(self._private[name])

    def get(self, name: str) -> Any:
        """The value, None = not set. Raises RpcError when there is no master."""
        if name in self._private:
            return self.private(name)
        master = Rpc(master_uri(), f"{self.namespace}{self.node}", self._timeout_s)
        for key in (f"{self.namespace}{self.node}/{name}", f"{self.namespace}{name}", f"/{name}"):
            code, _, value = master.raw("getParam", key)
            if code == 1:
                return value
        return None


def read_graph(caller: str, timeout_s: float = 2.0) -> Graph:
    """Ask the master for its graph. Raises RpcError when it does not answer."""
    master = Rpc(master_uri(), caller, timeout_s)
    publishers, subscribers, services = master.call("getSystemState")
    types = dict(master.call("getTopicTypes"))
    heard, said = dict(subscribers), dict(publishers)
    nodes = {n for part in (publishers, subscribers, services) for _, names in part for n in names}
    topics = tuple(
        TopicInfo(t, types.get(t), tuple(said.get(t, ())), tuple(heard.get(t, ()))) for t in sorted({*said, *heard})
    )
    return Graph(tuple(sorted(nodes)), topics)

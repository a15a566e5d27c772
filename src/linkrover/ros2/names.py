"""Names on a ROS 2 graph: namespace, remapping, and what a topic is called in DDS."""

from __future__ import annotations

import re
from collections.abc import Sequence

from linkrover.errors import ConfigError

_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
TOPIC_PREFIX = "rt"


class Names:
    """How this node's names are resolved: `__ns:=/r1`, `__node:=name`, `/odom:=/r1/odom`, as after ros2's -r.

    Raises:
        ConfigError: a name that ROS 2 does not allow.
    """

    def __init__(self, node: str, remappings: Sequence[str] = ()) -> None:
        rules = [(before, after) for before, _, after in (text.partition(":=") for text in remappings)]
        given = [after for before, after in rules if before in ("__node", "__name")]
        spaces = [after for before, after in rules if before == "__ns"]
        self.node = given[-1] if given else node
        if not _TOKEN.fullmatch(self.node):
            raise ConfigError(
                f"'{self.node}' cannot be a ROS 2 node name: letters, digits and _, not beginning with a digit"
            )
        self.namespace = "/" + (spaces[-1] if spaces else "").strip("/")
        if self.namespace != "/":
            _check(self.namespace)
        self._rules = {
            self._absolute(before): self._absolute(after) for before, after in rules if not before.startswith("__")
        }

    @property
    def full_name(self) -> str:
        """Of the node, with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    def resolve(self, name: str) -> str:
        """The full name of a topic: `/a` as it is, `a` in the namespace, `~/a` under the node; then remapped."""
        full = self._absolute(name)
        return self._rules.get(full, full)

    def _absolute(self, name: str) -> str:
        if name.startswith("~"):
            full = f"{self.full_name}/{name[1:].lstrip('/')}"
        elif name.startswith("/"):
            full = name
        else:
            full = f"{self.namespace.rstrip('/')}/{name}"
        return _check(full)


def _check(full: str) -> str:
    if not all(_TOKEN.fullmatch(token) for token in full[1:].split("/")):
        raise ConfigError(
            f"'{full}' cannot be a ROS 2 name: its parts are letters, digits and _, not beginning with a digit"
        )
    return full


def dds_topic(full: str) -> str:
    """What DDS calls "/odom": "rt/odom"."""
    return TOPIC_PREFIX + full


def ros_topic(dds: str) -> str | None:
    """What ROS 2 calls "rt/odom": "/odom"; None: no topic of ROS 2 (a service, an action's service, plain DDS)."""
    head, slash, tail = dds.partition("/")
    return f"/{tail}" if slash and head == TOPIC_PREFIX else None

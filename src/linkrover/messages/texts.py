"""The message texts of this package, and their ROS 2 form with every dependency, as a recording embeds it."""

from __future__ import annotations

import functools
from importlib import resources

from linkrover.errors import LinkRoverError

from .schema import Definitions, parse_text

SEPARATOR = "=" * 80
PACKAGES = ("linkrover_msgs", "network_analysis")
_STANDARD = ("builtin_interfaces", "std_msgs", "geometry_msgs", "nav_msgs")


@functools.cache
def text(name: str) -> str:
    """The text of message `name` ("linkrover_msgs/WirelessLink") as it is on disk."""
    package, _, short = name.partition("/")
    root = resources.files(__package__)
    if package in PACKAGES:
        folder = root / package
    elif package in _STANDARD:
        folder = root / "common_interfaces" / package
    else:
        raise LinkRoverError(f"no message text for {name}: known packages are {', '.join(PACKAGES + _STANDARD)}")
    file = folder / "msg" / f"{short}.msg"
    if not short.isidentifier() or not file.is_file():
        raise LinkRoverError(f"no message text for {name}")
    return file.read_text(encoding="utf-8")


def names(package: str) -> tuple[str, ...]:
    """The messages of one of our packages, as "package/Name"."""
    folder = resources.files(__package__) / package / "msg"
    return tuple(sorted(f"{package}/{f.name[:-4]}" for f in folder.iterdir() if f.name.endswith(".msg")))


def action_text(name: str) -> str:
    """The text of an action, such as "network_analysis/Ping"."""
    package, _, short = name.partition("/")
    return (resources.files(__package__) / package / "action" / f"{short}.action").read_text(encoding="utf-8")


@functools.cache
def definitions(name: str) -> Definitions:
    """`name` and all it is made of, parsed."""
    found: Definitions = {}
    waiting = [name]
    while waiting:
        one = waiting.pop()
        if one in found:
            continue
        found[one] = parse_text(text(one), one)
        waiting += [field.type for field in found[one] if "/" in field.type]
    return found


@functools.cache
def ros2_definition(name: str) -> str:
    """`name` as MCAP's "ros2msg" encoding wants it: its own text, then every dependency under a separator line.

    The only change against ROS 1 texts is the spelling `std_msgs/Header header`.
    """
    parts = [_ros2(text(name))]
    for dependency in sorted(definitions(name).keys() - {name}):
        parts += [SEPARATOR, f"MSG: {dependency}", _ros2(text(dependency))]
    return "\n".join(parts)


def _ros2(body: str) -> str:
    lines = [f"std_msgs/{line}" if line.startswith("Header ") else line for line in body.rstrip("\n").split("\n")]
    return "\n".join(lines)

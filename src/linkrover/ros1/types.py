"""Message classes: the user's workspace first, then ours from the wheel, then the installed .msg texts."""

from __future__ import annotations

import functools
import importlib
import logging
import os
import sys
from pathlib import Path
from typing import Any

from linkrover.errors import LinkRoverError

GENERATED = Path(__file__).parent / "generated"
SHIPPED = ("network_analysis", "linkrover_msgs")
PUBLISHED_MD5 = {
    "network_analysis/LinkUtilization": "fe180c2d13f8a73ccbdae55558ed29d4",
    "network_analysis/NetworkErrors": "79da7b66b469678c1bb1f95de3ebcf28",
    "network_analysis/WirelessLink": "d72fdb8c37115631164be6c511faa451",
    "network_analysis/NetworkDelay": "6050d41552a71fd0a5d0a11f9f6b844d",
    "network_analysis/NetworkAnalysis": "ee161b982526f7b4505b542ef2133ad9",
    "network_analysis/WirelessLinkVector": "f278651966a0b0d3decc219fee385163",
    "network_analysis/PingAction": "01d6954ff3b652e0fe6ec1e3f0cd933b",
    "network_analysis/PingActionGoal": "e9cf06cc4d0470f71c42a26ba50fe665",
    "network_analysis/PingActionResult": "755c8fa72237360914e0bddf7d33fcc2",
    "network_analysis/PingActionFeedback": "32475dec3f3b87581b1404301219ae23",
    "network_analysis/PingGoal": "705bdfa3e0e08abae54f3acdf06f1a9d",
    "network_analysis/PingResult": "4646f5e06440d78571c439e8eabcd8d9",
    "network_analysis/PingFeedback": "64d12b326124d8fe576ffce2ad5eb111",
}
"""md5sums of the messages as published in 2021; peers with others cannot talk to us."""

log = logging.getLogger("linkrover.ros1")


class Ros1MissingError(LinkRoverError):
    """A part of ROS 1 is not installed here; the message names the package."""


def use_shipped_messages() -> None:
    """Let `import network_analysis` find our generated classes, behind everything the user's workspace has."""
    if str(GENERATED) not in sys.path:
        sys.path.append(str(GENERATED))


@functools.cache
def message_class(name: str) -> Any:
    """The class of a message type such as "network_analysis/NetworkDelay".

    Raises:
        Ros1MissingError: neither a Python package nor a .msg text of that type is installed.
    """
    use_shipped_messages()
    package, _, base = name.partition("/")
    found = _imported(package, base)
    if found is None:
        found = _from_text(name)
    wanted = PUBLISHED_MD5.get(name)
    if wanted is not None and found._md5sum != wanted:
        log.error(
            "%s in this workspace has md5sum %s, the published one is %s: peers with the published messages will not "
            "connect. Remove the other '%s' package from PYTHONPATH or rebuild it from the published texts.",
            name, found._md5sum, wanted, package,
        )  # fmt: skip
    return found


def _imported(package: str, base: str) -> Any | None:
    try:
        return getattr(importlib.import_module(f"{package}.msg"), base, None)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] != package:
            raise Ros1MissingError(
                f"{package}/{base} needs the ROS 1 package '{error.name.partition('.')[0]}': "
                f"apt install ros-noetic-{error.name.partition('.')[0].replace('_', '-')} (Ubuntu) or "
                f"python3-{error.name.partition('.')[0].replace('_', '-')} (Debian)"
            ) from None
        return None


def _share_folders() -> list[Path]:
    places = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if p]
    places += [Path("/opt/ros/noetic/share"), Path("/usr/share")]
    return [p for p in places if p.is_dir()]


def _from_text(name: str) -> Any:
    """Debian ships many message packages as texts only; their classes are made in memory, as rosbag does."""
    from genmsg import MsgContext, load_depends, load_msg_by_type
    from genmsg.gentools import compute_full_text
    from genmsg.msg_loader import MsgNotFound
    from genpy.dynamic import generate_dynamic

    search: dict[str, list[str]] = {}
    for folder in _share_folders():
        for texts in folder.glob("*/msg"):
            search.setdefault(texts.parent.name, []).append(str(texts))
    context = MsgContext.create_default()
    try:
        spec = load_msg_by_type(context, name, search)
        load_depends(context, spec, search)
        text = compute_full_text(context, spec)
    except (MsgNotFound, KeyError) as error:
        package = name.partition("/")[0].replace("_", "-")
        raise Ros1MissingError(
            f"message type {name} is not installed: apt install ros-noetic-{package} (Ubuntu) or ros-{package} (Debian)"
        ) from error
    return generate_dynamic(name, text)[name]


def class_from_definition(name: str, definition: str) -> Any:
    """The class of a type as its publisher describes it in the connection header."""
    from genpy.dynamic import generate_dynamic

    return generate_dynamic(name, definition)[name]

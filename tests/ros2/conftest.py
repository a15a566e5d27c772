"""A DDS domain of a test's own: on the loopback, by unicast, in a number nobody else is likely to use."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import pytest

from tests.middleware.contract import Driver

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install 'linkrover[ros2]'")

_numbers = itertools.count(os.getpid() * 7)


def fresh_environment() -> dict[str, str]:
    """Up to domain 100 the ports of DDS lie below those the kernel gives to others."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "CYCLONEDDS_"))}
    return {**kept, "ROS_DOMAIN_ID": str(1 + next(_numbers) % 100), "ROS_LOCALHOST_ONLY": "1"}


@pytest.fixture
def environment() -> dict[str, str]:
    return fresh_environment()


@pytest.fixture
def drivers() -> Iterator[list[Driver]]:
    found: list[Driver] = []
    yield found
    for driver in found:
        driver.stop()

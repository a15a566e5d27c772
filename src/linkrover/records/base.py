"""The ground every record stands on: when it was taken, and why a value is unknown."""

from __future__ import annotations

import enum
import time

import msgspec


class Role(enum.Enum):
    """Which end of the link a record comes from."""

    ROBOT = "robot"
    STATION = "station"


class Unknown(enum.Enum):
    """Why a value is `None`."""

    UNSUPPORTED = "unsupported"  # this kernel, driver or interface mode does not give it
    NOT_CONNECTED = "not connected"
    NOT_PERMITTED = "not permitted"
    TIMED_OUT = "timed out"
    ABSENT = "absent"  # the interface or file is not there
    NO_BASE = "no base"  # a rate needs two samples without a reset between them
    STALE = "stale"  # the last reading is too old to stand for now


class Now(msgspec.Struct, frozen=True):
    """One instant on both clocks, integer nanoseconds."""

    wall_ns: int
    mono_ns: int


def now() -> Now:
    """Read CLOCK_REALTIME and CLOCK_MONOTONIC back to back."""
    return Now(time.time_ns(), time.monotonic_ns())


class Record(msgspec.Struct, frozen=True, kw_only=True, tag=True, tag_field="type"):
    """Base of every record; as JSON it carries its class name under "type".

    wall_ns: CLOCK_REALTIME of the sample, for joining. mono_ns: CLOCK_MONOTONIC of the sample, for durations.
    unknown: why a field is `None`, by field name, where a reason is known.
    """

    wall_ns: int
    mono_ns: int
    unknown: dict[str, Unknown] = {}

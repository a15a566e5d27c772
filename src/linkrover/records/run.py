"""What a recording says of itself."""

from __future__ import annotations

import msgspec

from .base import Record, Role


class Interface(msgspec.Struct, frozen=True, kw_only=True):
    """A network interface as it was when the recording began."""

    name: str
    mac: str | None = None
    addresses: tuple[str, ...] = ()
    driver: str | None = None
    driver_version: str | None = None
    firmware: str | None = None
    mtu: int | None = None
    speed_bps: int | None = None
    frequency_mhz: int | None = None
    width_mhz: int | None = None
    power_save: bool | None = None
    mode: str | None = None


class Manifest(Record, frozen=True, kw_only=True):
    """Everything about one end that a reader of its recording may need later."""

    linkrover_version: str
    role: Role
    host: str
    kernel: str
    machine: str
    python: str
    boot_id: str | None = None
    clock_source: str | None = None
    interfaces: tuple[Interface, ...] = ()
    peer: str | None = None
    middleware: str | None = None  # "ros1 noetic rosmaster http://...", None = none
    sysctls: dict[str, str] = {}
    case: str | None = None
    trial: int | None = None
    run: str | None = None
    simulated: bool = False  # made in virtual time: no packet was sent
    emulated: bool = False  # real packets over an emulated radio
    imported_from: str | None = None
    repairs: tuple[str, ...] = ()  # what an import had to mend
    config: str = ""  # the agent's own configuration, TOML
    notes: dict[str, str] = {}


class SelfAccount(Record, frozen=True, kw_only=True):
    """What measuring cost, and how punctual it was, since the last account."""

    interval_ns: int
    cpu_ns: int
    rss_bytes: int
    samples: int = 0
    missed_slots: int = 0
    lateness_median_ns: int | None = None
    lateness_max_ns: int | None = None
    records_written: int = 0
    records_lost: int = 0
    bytes_written: int = 0

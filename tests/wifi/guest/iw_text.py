"""What `iw` prints, taken apart: the yardstick for our own codec."""

from __future__ import annotations

import re

from linkrover.records import Bitrate


def stations(text: str) -> dict[str, dict[str, str]]:
    """`iw dev X station dump`: values by name, by peer."""
    found: dict[str, dict[str, str]] = {}
    for line in text.splitlines():
        begun = re.match(r"Station ([0-9a-f:]{17})", line)
        if begun:
            values = found[begun[1]] = {}
        elif ":" in line and found:
            name, _, value = line.strip().partition(":")
            values[name] = value.strip()
    return found


def surveys(text: str) -> list[dict[str, str]]:
    """`iw dev X survey dump`: values by name, by channel."""
    found: list[dict[str, str]] = []
    for line in text.splitlines():
        if line.startswith("Survey data"):
            found.append({})
        elif ":" in line and found:
            name, _, value = line.strip().partition(":")
            found[-1][name] = value.strip()
    return found


def bitrate(rate: Bitrate) -> str:
    """A rate as iw prints it (iw 5.19, station.c)."""
    assert rate.rate_bps is not None
    text = f"{rate.rate_bps / 1e6:.1f} MBit/s"
    if rate.mode == "ht":
        text += f" MCS {rate.mcs}"
    elif rate.mode in ("vht", "he"):
        text += f" {rate.mode.upper()}-MCS {rate.mcs}"
    if rate.width_mhz in (40, 80, 160):
        text += f" {rate.width_mhz}MHz"
    if rate.mode in ("ht", "vht") and rate.guard_interval_ns == 400:
        text += " short GI"
    if rate.mode in ("vht", "he"):
        text += f" {rate.mode.upper()}-NSS {rate.nss}"
    return text

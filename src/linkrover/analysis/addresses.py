"""Which machine an address belongs to, so that what never leaves a machine is not counted as being on the air."""

from __future__ import annotations

import ipaddress

from .run import End, Run


def host(place: str) -> str:
    """The address of "address:port" or "[address]:port"; an address alone is returned as it is."""
    if place.startswith("["):
        return place[1:].partition("]")[0]
    return place.rpartition(":")[0] if place.count(":") == 1 else place


def own_addresses(end: End) -> dict[str, str]:
    """Interface by address, as they were when the recording began."""
    if end.manifest is None:
        return {}
    return {a.partition("/")[0]: i.name for i in end.manifest.interfaces for a in i.addresses}


def stays_inside(end: End, local: str | None, remote: str | None) -> bool | None:
    """Whether both ends of a connection are on this machine; `None` where the addresses do not tell."""
    if not remote:
        return None
    far = host(remote)
    if (local and host(local) == far) or far in own_addresses(end):
        return True
    try:
        return ipaddress.ip_address(far.partition("%")[0]).is_loopback
    except ValueError:
        return None


def interface_of(end: End, local: str | None) -> str | None:
    """The interface a local address belongs to, else the one that carried the most."""
    return own_addresses(end).get(host(local)) or end.primary if local else end.primary


def owner_of_mac(run: Run, mac: str) -> str | None:
    """The end and interface with this hardware address, such as "robot wlan0"; `None` where it is of neither end."""
    for role, end in run.ends.items():
        for interface in end.manifest.interfaces if end.manifest is not None else ():
            if interface.mac and interface.mac.lower() == mac.lower():
                return f"{role} {interface.name}"
    return None

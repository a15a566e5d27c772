"""Checks of the ROS environment of this shell. Pure: environment in, findings out."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Collection, Mapping
from urllib.parse import urlsplit

from .finding import Finding, Status, judged, ok

ROS1_VARIABLES = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME")
ROS2_VARIABLES = (
    "ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "CYCLONEDDS_URI",
    "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER",
)  # fmt: skip
DOMAIN_SAFE_MOST, DOMAIN_MOST = 101, 232


def environment(
    environ: Mapping[str, str],
    *,
    peer: bool,
    local: Collection[str],
    reachable: Callable[[str, int], bool],
    exists: Callable[[str], bool],
) -> list[Finding]:
    """What the ROS variables will do. peer: another machine takes part. local: this machine's addresses.

    reachable(host, port) tries a TCP connection; exists(path) looks for a file.
    """
    version = environ.get("ROS_VERSION")
    first = version == "1" or any(environ.get(name) for name in ROS1_VARIABLES)
    second = version == "2" or any(environ.get(name) for name in ROS2_VARIABLES)
    if not first and not second:
        return [ok("ROS", "no ROS variable is set in this shell", "LinkRover measures without ROS")]
    found = []
    if first:
        found += _master(environ.get("ROS_MASTER_URI", ""), peer, reachable)
        found.append(_own_name(environ, peer, local))
    if second:
        found += [_domain(environ.get("ROS_DOMAIN_ID", "")), _range(environ, peer), *_middleware(environ, exists)]
    return found


def _master(uri: str, peer: bool, reachable: Callable[[str, int], bool]) -> list[Finding]:
    name, why = (
        "ROS 1 master",
        "every node asks the master; without it nothing starts, and every log line may block on it",
    )
    if not uri:
        return [judged(name, Status.WARN, "ROS_MASTER_URI is not set", why, "export ROS_MASTER_URI=http://HOST:11311")]
    parts = urlsplit(uri)
    try:
        host, port = parts.hostname, parts.port or 11_311
    except ValueError:
        host, port = None, 0
    if parts.scheme != "http" or not host:
        return [
            judged(name, Status.FAIL, f"ROS_MASTER_URI={uri} is no URI", why, "export ROS_MASTER_URI=http://HOST:11311")
        ]
    up = reachable(host, port)
    found = [
        judged(
            name, Status.OK if up else Status.FAIL, f"{uri} {'answers' if up else 'does not answer'}", why,
            f"start roscore on {host}, or open TCP port {port} there",
        )
    ]  # fmt: skip
    if peer and _is_loopback(host):
        found.append(
            judged(
                name, Status.WARN, f"{uri} means this machine only",
                "the peer's ROS_MASTER_URI must name this machine by an address it can reach",
                "export ROS_MASTER_URI=http://ADDRESS:11311 at both ends",
            )
        )  # fmt: skip
    return found


def _own_name(environ: Mapping[str, str], peer: bool, local: Collection[str]) -> Finding:
    name = "ROS 1 own address"
    why = "other nodes connect back to this name; where they cannot resolve it, topics are listed but stay silent"
    given = environ.get("ROS_HOSTNAME") or environ.get("ROS_IP")
    if not given:
        mend = "export ROS_IP=ADDRESS of the interface towards the peer"
        return judged(name, Status.WARN, "neither ROS_IP nor ROS_HOSTNAME is set: the host name goes out", why, mend)
    if peer and _is_loopback(given):
        return judged(name, Status.FAIL, f"{given} means each machine itself", why, "export ROS_IP=ADDRESS")
    if _is_address(given) and not _is_loopback(given) and given not in local:
        mend = f"export ROS_IP= one of {', '.join(sorted(local)) or '(no address)'}"
        return judged(name, Status.FAIL, f"{given} is no address of this machine now", why, mend)
    return ok(name, given, why)


def _domain(text: str) -> Finding:
    name, why = "ROS 2 domain", "only participants of one domain see each other; it must be the same at both ends"
    if not text:
        return ok(name, "0 (ROS_DOMAIN_ID is not set)", why)
    value = int(text) if text.isascii() and text.isdigit() else -1
    if not 0 <= value <= DOMAIN_MOST:
        return judged(
            name, Status.FAIL, f"ROS_DOMAIN_ID={text}", why, f"export ROS_DOMAIN_ID=0 (0 to {DOMAIN_SAFE_MOST})"
        )
    if value > DOMAIN_SAFE_MOST:
        return judged(
            name, Status.WARN, f"{value}: its ports lie among those the kernel gives out by itself", why,
            f"export ROS_DOMAIN_ID=0 (0 to {DOMAIN_SAFE_MOST})",
        )  # fmt: skip
    return ok(name, str(value), why)


def _range(environ: Mapping[str, str], peer: bool) -> Finding:
    name, why = "ROS 2 discovery", "with discovery kept to this machine, no other is ever found, without any error"
    only = environ.get("ROS_LOCALHOST_ONLY", "")
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if only in ("", "0") and reach.upper() in ("", "SUBNET", "SYSTEM_DEFAULT"):
        return ok(name, "the subnet", why)
    value = f"ROS_LOCALHOST_ONLY={only}" if only not in ("", "0") else f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}"
    mend = "unset ROS_LOCALHOST_ONLY ROS_AUTOMATIC_DISCOVERY_RANGE"
    return judged(name, Status.FAIL if peer else Status.WARN, value, why, mend)


def _middleware(environ: Mapping[str, str], exists: Callable[[str], bool]) -> list[Finding]:
    why = "both ends should use the same middleware; its settings file decides on interfaces and fragment sizes"
    found = [ok("ROS 2 middleware", environ.get("RMW_IMPLEMENTATION") or "the distribution's default", why)]
    for variable in ("CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        value = environ.get(variable, "")
        if not value or value.lstrip().startswith("<"):
            continue  # not set, or the settings themselves
        path = value.removeprefix("file://")
        if not exists(path):
            mend = f"unset {variable}, or put the file there"
            found.append(judged("ROS 2 middleware", Status.FAIL, f"{variable}: {path} is not there", why, mend))
    return found


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)

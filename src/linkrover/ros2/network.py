"""Which DDS domain to join and over what, from the variables ROS 2 users set; checked before Cyclone DDS sees it.

pip's cyclonedds knows nothing of ROS_DOMAIN_ID and ROS_LOCALHOST_ONLY, and says the same non-specific word for an
interface that is down, one that does not exist and a configuration it cannot read.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import msgspec

from linkrover.errors import ConfigError

HIGHEST_DOMAIN = 232
"""Above it the UDP ports of RTPS (7400 + 250 * domain + ...) pass 65535."""
PARTICIPANTS = 32
"""Participants of one host that are looked for where there is no multicast."""
_SEEKING = "<SPDPInterval>3s</SPDPInterval><InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
"""By default Cyclone DDS forgets a unicast peer that was silent for 30 s, and calls by multicast more rarely; a robot
that was out of reach for longer shall be found again in seconds."""
_SIOCGIFFLAGS, _IFF_UP, _IFNAMSIZ = 0x8913, 0x1, 16


class Network(msgspec.Struct, frozen=True):
    """A domain and Cyclone DDS's configuration for it. interfaces: those the configuration names."""

    domain: int
    config: str = ""
    interfaces: tuple[str, ...] = ()

    def problem(self) -> str | None:
        """Why nothing can be joined now, None: nothing speaks against it."""
        up = [name for _, name in socket.if_nameindex() if _is_up(name)]
        if not up:
            return "no network interface is up"
        for name in self.interfaces:
            if _is_up(name) is None:
                return f"no interface {name} here (there are: {', '.join(n for _, n in socket.if_nameindex())})"
            if name not in up:
                return f"interface {name} is down (ip link set {name} up)"
        return None


def read_network(
    domain: int | None = None, peers: Sequence[str] = (), environment: Mapping[str, str] = os.environ
) -> Network:
    """As ROS 2's own Cyclone DDS middleware would be set up; CYCLONEDDS_URI comes last and so has the last word.

    peers: hosts to speak to by unicast, with multicast off (or ROS_STATIC_PEERS).

    Raises:
        ConfigError: a variable that cannot be used; names it.
    """
    if domain is None:
        domain = _domain(environment.get("ROS_DOMAIN_ID", ""))
    elif not 0 <= domain <= HIGHEST_DOMAIN:
        raise ConfigError(f"--domain {domain}: must be 0 to {HIGHEST_DOMAIN}")
    listed = [*peers, *(p for p in environment.get("ROS_STATIC_PEERS", "").split(";") if p)]
    uri = environment.get("CYCLONEDDS_URI", "").strip()
    trees = _parse(uri)
    local = environment.get("ROS_LOCALHOST_ONLY", "0").strip() == "1"
    local = local or environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper() == "LOCALHOST"
    parts = []
    if local:
        parts.append(_xml(("127.0.0.1",), "<Interfaces><NetworkInterface name='lo'/></Interfaces>"))
    elif listed:
        parts.append(_xml(tuple(listed), ""))
    else:
        parts.append(f"<Discovery>{_SEEKING}</Discovery>")
    if uri:
        parts.append(uri)
    names = [e.get("name", "") for tree in trees for e in tree.iter() if _tag(e) == "networkinterface"]
    named = tuple(dict.fromkeys(name for name in names if name)) or (("lo",) if local else ())
    config = ",".join(parts)
    if not config.isascii():
        raise ConfigError("CYCLONEDDS_URI: Cyclone DDS takes ASCII only")
    return Network(domain, config, named)


def _domain(text: str) -> int:
    text = text.strip()
    if not text:
        return 0
    if not text.isdecimal() or int(text) > HIGHEST_DOMAIN:
        raise ConfigError(f"ROS_DOMAIN_ID = '{text}': must be 0 to {HIGHEST_DOMAIN}")
    return int(text)


def _xml(peers: tuple[str, ...], general: str) -> str:
    addresses = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
    return (
        f"<General>{general}<AllowMulticast>false</AllowMulticast></General><Discovery>"
        f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>"
        f"<Peers>{addresses}</Peers>{_SEEKING}</Discovery>"
    )


def _parse(uri: str) -> list[ElementTree.Element]:
    """The parts of CYCLONEDDS_URI: XML fragments and files, separated by commas."""
    trees = []
    for part in re.split(r",\s*(?=<|file:|/)", uri) if uri else ():
        text, place = part, "CYCLONEDDS_URI"
        if not part.startswith("<"):
            path = Path(part.removeprefix("file://").removeprefix("file:"))
            place = f"CYCLONEDDS_URI, {path}"
            try:
                text = path.read_text(encoding="utf-8")
            except (OSError, ValueError) as error:
                raise ConfigError(f"{place}: cannot be read: {error}") from None
        body = re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.DOTALL)
        try:
            trees.append(ElementTree.fromstring(f"<all>{body}</all>"))  # noqa: S314  the user's own configuration
        except ElementTree.ParseError as error:
            raise ConfigError(f"{place}: not well-formed XML: {error}") from None
    return trees


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2].lower()


def _is_up(name: str) -> bool | None:
    """Whether the interface is up; None: there is none of this name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        try:
            found = fcntl.ioctl(asker, _SIOCGIFFLAGS, struct.pack("16sH22x", name.encode()[: _IFNAMSIZ - 1], 0))
        except OSError as error:
            if error.errno in (errno.ENODEV, errno.EADDRNOTAVAIL):
                return None
            raise
    return bool(struct.unpack_from("H", found, _IFNAMSIZ)[0] & _IFF_UP)

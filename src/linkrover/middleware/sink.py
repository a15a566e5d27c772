"""Every record of an agent onto the graph: which topic, under which prefix, and the combined topic of 2021."""

from __future__ import annotations

from typing import Any

import msgspec

from linkrover.errors import ConfigError
from linkrover.messages import legal_name
from linkrover.messages.legacy import to_2021
from linkrover.messages.mapping import header, to_message
from linkrover.messages.standard import to_standard
from linkrover.messages.topics import topics_of
from linkrover.records import (
    LinkUtilization,
    Manifest,
    NetworkDelay,
    NetworkErrors,
    Pose,
    Record,
    VelocityCommand,
    WirelessLink,
    now,
)

from .protocol import Middleware

COMBINED = "network_analysis/NetworkAnalysis"
_PARTS: dict[type[Record], str] = {
    NetworkDelay: "delay",
    NetworkErrors: "errors",
    WirelessLink: "quality",
    LinkUtilization: "utilization",
}


class Layout(msgspec.Struct, frozen=True):
    """Where topics lie, relative to the node's namespace.

    prefix: of an interface's topics, with {end} and {iface}; without {iface} all topics share it, as the 2021
    package had it ("" gives network_analysis/link_utilization). aliases: names for interfaces ({"wlan0": "iface1"}).
    """

    prefix: str = "{end}/{iface}"
    aliases: dict[str, str] = {}

    def check(self, interfaces: tuple[str, ...]) -> Layout:
        """Itself, if the interfaces do not end up on the same topics.

        Raises:
            ConfigError: they do, or the prefix cannot be filled in.
        """
        try:
            made = [self.interface_prefix("robot", name) for name in interfaces]
        except (KeyError, IndexError, ValueError) as error:
            raise ConfigError(f"prefix '{self.prefix}': only {{end}} and {{iface}} are filled in ({error!r})") from None
        if len(set(made)) != len(made):
            raise ConfigError(f"{', '.join(interfaces)} would share their topics: put {{iface}} into the prefix")
        return self

    def interface_prefix(self, end: str, iface: str) -> str:
        """Of this interface's topics."""
        alias = self.aliases.get(iface, iface)
        return _joined(self.prefix.format(end=end, iface=legal_name(alias)))

    def end_prefix(self, end: str) -> str:
        """Of the topics of the whole end."""
        shared = self.prefix.replace("/{iface}", "").replace("{iface}/", "").replace("{iface}", "")
        return _joined(shared.format(end=end))

    def topic(self, canonical: str, end: str, iface: str) -> str:
        """The topic for a canonical one (`/robot/wlan0/linkrover/wireless_link`)."""
        place = f"/{end}/{legal_name(iface)}/" if iface else None
        if place is not None and canonical.startswith(place):
            return self.interface_prefix(end, iface) + canonical.removeprefix(place)
        own = f"/{end}/"
        return self.end_prefix(end) + canonical.removeprefix(own) if canonical.startswith(own) else canonical


def _joined(prefix: str) -> str:
    stripped = prefix.rstrip("/")
    return f"{stripped}/" if stripped else ("/" if prefix.startswith("/") else "")


class RecordPublisher:
    """A sink that publishes each record as its full message and as its 2021 and standard ones.

    take() queues what is needed to make the message; it is made where it is published, and only when somebody
    listens. Poses and velocity commands came from the graph, so that only their full form is published.
    """

    def __init__(self, middleware: Middleware, end: str, layout: Layout) -> None:
        self._middleware = middleware
        self._end = end
        self._layout = layout
        self._topics: dict[tuple[type[Record], str], tuple[tuple[str, str], ...]] = {}
        self._latest: dict[tuple[type[Record], str], Record] = {}

    def take(self, record: Record) -> None:
        """One record; never blocks."""
        kind = type(record)
        iface: str = getattr(record, "iface", "")
        places = self._topics.get((kind, iface))
        if places is None:
            found = topics_of(kind, self._end, iface)
            places = tuple((self._layout.topic(name, self._end, iface), type_name) for name, type_name in found)
            self._topics[(kind, iface)] = places
        latched = kind is Manifest
        self._middleware.publish(*places[0], lambda: to_message(record, self._end), latched=latched)
        if len(places) > 1 and _is_published_2021(record):
            self._middleware.publish(*places[1], lambda: _compatible(record))
        if kind in _PARTS and _is_published_2021(record):
            self._latest[(kind, iface)] = record

    def publish_combined(self, not_before_mono_ns: int) -> None:
        """The combined message of 2021: the newest record of each kind and interface since the given time."""
        parts: dict[str, list[Any]] = {name: [] for name in _PARTS.values()}
        for (kind, _), record in sorted(self._latest.items(), key=lambda item: item[0][1]):
            if record.mono_ns >= not_before_mono_ns:
                parts[_PARTS[kind]].append(record)
        if any(parts.values()):
            topic = f"{self._layout.end_prefix(self._end)}network_analysis/network_analysis"
            stamp_ns = now().wall_ns

            def make() -> dict[str, Any]:
                lists = {name: [_compatible(one) for one in records] for name, records in parts.items()}
                return {"header": header(stamp_ns, self._end), **lists}

            self._middleware.publish(topic, COMBINED, make)

    def close(self) -> None:
        """The middleware is closed by whoever opened it."""


def _compatible(record: Record) -> dict[str, Any]:
    found = to_2021(record) or to_standard(record)
    assert found is not None
    return found[1]


def _is_published_2021(record: Record) -> bool:
    if isinstance(record, NetworkDelay):
        # that topic has always carried the application's round trip, one message a ping
        return record.method != "stamp" and not record.late
    return not isinstance(record, (Pose, VelocityCommand))

"""Raw messages -> records, whatever the type they came in."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from typing import Any

import msgspec

from linkrover.errors import LinkRoverError, ParseError
from linkrover.messages import Codec, from_message, texts
from linkrover.messages.legacy import from_2021
from linkrover.messages.mapping import stamp_ns
from linkrover.messages.schema import Definitions, parse_definitions
from linkrover.messages.standard import from_odometry, from_twist
from linkrover.records import Continuity, LinkUtilization, NetworkDelay, Pose, Record, Unknown, WirelessLink

from .blocks import Topic
from .patterns import Meaning

# The 2021 nodes stamp every delay with the time the node began; a stamp this far from the arrival is not of the sample.
STALE_STAMP_NS = 5_000_000_000
# they publish -1 when an answer has not come for so long
DEADLINE_2021_NS = 2_000_000_000
# a counter that grew by more than this in one interval was another counter (100 Gbit/s for ten seconds)
COUNTER_STEP = 125_000_000_000


def definitions_of(topic: Topic) -> Definitions:
    """The type's definition as embedded in the file, or ours where the file has none. Raises LinkRoverError."""
    if topic.definition:
        return parse_definitions(topic.definition, topic.type)
    if topic.ros1:
        raise ParseError(topic.name, "definition", f"the definition of {topic.type}", "none")
    return texts.definitions(topic.type)


def checked_definitions(topic: Topic, *, native: bool) -> Definitions:
    """As `definitions_of`, once the fields a record is made of are there with their types.

    A type of ours may lack some, since older recordings do. Raises LinkRoverError.
    """
    found = definitions_of(topic)
    here, ours = dict(_flat(topic.type, found)), dict(_flat(topic.type, texts.definitions(topic.type)))
    for path, kind in ours.items():
        stamp = path.startswith("header.stamp.")  # signed in ROS 2, not in ROS 1
        needed = not native or path.startswith("header.") or path in ("mono_ns", "unknown")
        if (path not in here and needed) or (path in here and here[path] != kind and not stamp):
            raise ParseError(topic.name, f"definition of {topic.type}", f"{path} as {kind[0]}")
    return found


def _flat(name: str, definitions: Definitions, prefix: str = "") -> Iterator[tuple[str, tuple[str, int | None]]]:
    for field in definitions[name]:
        if "/" in field.type and field.count is None:
            yield from _flat(field.type, definitions, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, (field.type, field.count)


class Interpreter:
    """Turns the messages of one topic into records. Keeps the last one where a rate or a time depends on it."""

    def __init__(self, topic: Topic, meaning: Meaning) -> None:
        """Raises LinkRoverError if the topic's definition cannot be used."""
        if topic.encoding not in ("cdr", "ros1"):
            raise ParseError(topic.name, "encoding", "cdr or ros1", topic.encoding)
        self.topic = topic
        self.meaning = meaning
        self._codec = Codec(topic.type, checked_definitions(topic, native=meaning.native), ros1=topic.ros1)
        self._last: dict[str, LinkUtilization] = {}
        self._last_stamp: int | None = None

    def records(self, data: bytes | memoryview, log_ns: int) -> tuple[Record, ...]:
        """The records in one message. Raises ParseError."""
        try:
            message = self._codec.decode(data)
        except (UnicodeError, OverflowError, struct.error) as error:
            raise ParseError(self.topic.name, "message", "a message of its type", str(error)) from None
        if self.meaning.native:
            return (from_message(self.meaning.kind, message),)
        if self.meaning.kind is Pose:
            return (from_odometry(message),)
        if self.topic.type.startswith("geometry_msgs/"):
            return (from_twist(message, log_ns),)
        found = from_2021(self.topic.type, message, self._received(message, log_ns))
        return tuple(self._derived(record) for record in found)

    def _received(self, message: Any, log_ns: int) -> int | None:
        """When a delay was asked for, where its stamp does not say: its arrival less the delay (or the deadline)."""
        if self.topic.type != "network_analysis/NetworkDelay":
            return None
        stamp = stamp_ns(message)
        stale = stamp == self._last_stamp or abs(log_ns - stamp) > STALE_STAMP_NS
        self._last_stamp = stamp
        if not stale:
            return None
        delay = float(message["delay"])
        answered = math.isfinite(delay) and delay >= 0
        return log_ns - (round(delay * 1e6) if answered else DEADLINE_2021_NS)

    def _derived(self, record: Record) -> Record:
        iface = self.meaning.iface
        if iface and isinstance(record, (WirelessLink, NetworkDelay, LinkUtilization)) and not record.iface:
            record = msgspec.structs.replace(record, iface=iface)
        if isinstance(record, LinkUtilization):
            last = self._last.get(record.iface)
            self._last[record.iface] = record
            return rates_from_counters(record, last)
        return record


RATES = (
    ("rx_bytes", "rx_rate_bps", 8),
    ("tx_bytes", "tx_rate_bps", 8),
    ("tcp_tx_segments", "tcp_tx_segments_per_s", 1),
    ("tcp_rx_segments", "tcp_rx_segments_per_s", 1),
    ("udp_tx_datagrams", "udp_tx_datagrams_per_s", 1),
    ("udp_rx_datagrams", "udp_rx_datagrams_per_s", 1),
)


def rates_from_counters(record: LinkUtilization, last: LinkUtilization | None) -> LinkUtilization:
    """The record with its rates over the time since `last`, from the counters.

    What the 2021 nodes publish as rates is an increment per published interval of unstated length.
    """
    changes: dict[str, Any] = {rate: None for _, rate, _ in RATES}
    elapsed = 0 if last is None else record.wall_ns - last.wall_ns
    if last is None or elapsed <= 0:
        changes["continuity"] = Continuity.FIRST
    else:
        steps = {
            counter: (new - old)
            for counter, _, _ in RATES
            if (new := getattr(record, counter)) is not None and (old := getattr(last, counter)) is not None
        }
        reset = any(not 0 <= step < COUNTER_STEP for step in steps.values())
        changes["continuity"] = Continuity.RESET if reset else Continuity.STEADY
        changes["interval_ns"] = elapsed
        if not reset:
            for counter, rate, factor in RATES:
                changes[rate] = None if counter not in steps else steps[counter] * factor * 1e9 / elapsed
    changes["unknown"] = {rate: Unknown.NO_BASE for _, rate, _ in RATES if changes[rate] is None}
    return msgspec.structs.replace(record, **changes)


def interpreter(topic: Topic, meaning: Meaning) -> Interpreter | LinkRoverError:
    """An interpreter, or why there is none."""
    try:
        return Interpreter(topic, meaning)
    except LinkRoverError as error:
        return error

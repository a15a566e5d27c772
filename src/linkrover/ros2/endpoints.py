"""Writers and readers of ROS 2 topics on one DDS participant, by the qualities of service ROS 2 uses.

XCDR1 only (`use_cdrv0_representation`): with XCDR2 no ROS 2 node ever matches. autodispose off, as ROS has it.

No listeners: cyclonedds' reads and writes hold Python's lock while they take Cyclone DDS's, a listener would do it the
other way round. Waitsets wait, and status is asked for, without that lock.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from cyclonedds.core import (
    DDSException,
    DDSStatus,
    GuardCondition,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from linkrover.errors import ParseError
from linkrover.messages import Message

from .types import complete, sample_class
from .unlocked import UnlockedWriter

DEPTH = 10
"""ROS 2's default history."""
PING_DEPTH = 256
BLOCKED_NS = 100_000_000
"""Longest time a write waits for readers that do not keep up; on threads of ours, never the sampling one's."""
TAKEN_AT_ONCE = 64
_FOREVER_NS = 2**63 - 1

log = logging.getLogger("linkrover.ros2")


def qos(*, reliable: bool = True, latched: bool = False, depth: int = DEPTH) -> Qos:
    """Of writers and readers alike: what ROS 2's profiles come to."""
    return Qos(
        Policy.Reliability.Reliable(max_blocking_time=BLOCKED_NS) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(1 if latched else depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.WriterDataLifecycle(autodispose=False),
    )


class Writer:
    """Publishes one topic."""

    def __init__(
        self,
        participant: DomainParticipant,
        topic: str,
        type_name: str,
        *,
        latched: bool = False,
        depth: int = DEPTH,
    ) -> None:
        self.type_name = type_name
        self._class = sample_class(type_name)
        self._topic = Topic(participant, topic, self._class)
        self.entity = UnlockedWriter(participant, self._topic, qos=qos(latched=latched, depth=depth))
        self.entity.set_status_mask(DDSStatus.PublicationMatched)

    @property
    def readers(self) -> int:
        """How many subscriptions match now; may wait for a write on another thread."""
        return int(self.entity.get_publication_matched_status().current_count)

    def write(self, fields: Mapping[str, Any]) -> None:
        """Write a message; fields left out are zero. May wait for BLOCKED_NS.

        Raises:
            LinkRoverError: a field the type does not have.
            struct.error: a number that does not fit its field.
            DDSException: readers that should get it did not keep up.
        """
        self.entity.write(self._class(complete(self.type_name, fields)))

    def matched_participants(self) -> tuple[Any, ...]:
        """Keys of the participants that subscribe."""
        found = (self.entity.get_matched_subscription_data(h) for h in self.entity.get_matched_subscriptions())
        return tuple(one.participant_key for one in found if one is not None)


class Subscription:
    """Hands messages of one topic over on a thread of its own; of several types, whichever is published.

    take(type_name, message, received_mono_ns). writers, and partners (the readers of a writer that belongs to it), are
    kept up to date by the same thread, so that asking never waits.
    """

    def __init__(
        self,
        participant: DomainParticipant,
        topic: str,
        type_names: tuple[str, ...],
        take: Callable[[str, Message, int], None],
        *,
        reliable: bool = False,
        depth: int = DEPTH,
        partner: Writer | None = None,
    ) -> None:
        self.topic = topic
        self.type_names = type_names
        self._take = take
        self._told: set[str] = set()
        self._partner = partner
        self.writers = 0
        self.partners = 0
        self._done = GuardCondition(participant)
        self._waitset = WaitSet(participant)
        self._waitset.attach(self._done)
        self._readers: list[tuple[str, Any]] = []
        self._conditions: list[ReadCondition] = []
        self._closed = False
        for name in type_names:
            reader: Any = DataReader(
                participant, Topic(participant, topic, sample_class(name)), qos=qos(reliable=reliable, depth=depth)
            )
            reader.set_status_mask(DDSStatus.SubscriptionMatched)
            self._waitset.attach(reader)
            # NotRead only: a condition on all samples would stay true for what is being taken
            condition = ReadCondition(reader, ViewState.Any | SampleState.NotRead | InstanceState.Any)
            self._waitset.attach(condition)
            self._readers.append((name, reader))
            self._conditions.append(condition)
        if partner is not None:
            self._waitset.attach(partner.entity)
        self._thread = threading.Thread(target=self._run, name=f"ros2 {topic}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """No further messages."""
        if not self._closed:
            self._closed = True
            self._done.set(True)
            if threading.current_thread() is not self._thread:
                self._thread.join(5.0)

    def _run(self) -> None:
        while not self._closed:
            try:
                self._waitset.wait(_FOREVER_NS)
                received_ns = time.monotonic_ns()
                for name, reader in self._readers:
                    for sample in reader.take(TAKEN_AT_ONCE):
                        self._one(name, sample, received_ns)
                self._count()
            except DDSException as error:  # noqa: PERF203
                if not self._closed:
                    log.error("%s: no longer heard: %s", self.topic, error)
                return

    def _count(self) -> None:
        # asking also takes the notice back that woke the thread
        self.writers = sum(int(r.get_subscription_matched_status().current_count) for _, r in self._readers)
        if self._partner is not None:
            self.partners = self._partner.readers

    def _one(self, name: str, sample: Any, received_ns: int) -> None:
        if isinstance(sample, InvalidSample) or self._closed:
            return  # says only that a writer went
        if isinstance(sample.message, ParseError):
            self._tell(f"{self.topic} carries a {name} that cannot be read ({sample.message}): not recorded")
            return
        try:
            self._take(name, sample.message, received_ns)
        except Exception as error:  # one message's fault must not end the subscription
            if str(error) not in self._told:
                self._told.add(str(error))
                log.exception("%s", self.topic)

    def _tell(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            log.error("%s", text)

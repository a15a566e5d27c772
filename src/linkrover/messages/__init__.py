"""The message texts, and records <-> messages. Sentinels exist only here."""

from collections.abc import Iterator

from linkrover.records import Record

from .legacy import to_2021
from .mapping import assign, from_message, record_type, record_types, to_message, type_name
from .standard import to_standard
from .topics import legal_name, topics
from .wire import Codec, Message

__all__ = [
    "Codec",
    "Message",
    "assign",
    "from_message",
    "legal_name",
    "messages_of",
    "record_type",
    "record_types",
    "to_message",
    "topics",
    "type_name",
]


def messages_of(record: Record, end: str, *, compatible: bool = True) -> Iterator[tuple[str, str, Message]]:
    """(topic, message type, message) of everything a record is published as: the full one first.

    compatible: also as the 2021 and standard types.
    """
    places = topics(record, end)
    yield (*places[0], to_message(record, end))
    if not compatible:
        return
    for topic, message_type in places[1:]:
        found = to_2021(record) or to_standard(record)
        assert found is not None
        assert found[0] == message_type
        yield topic, message_type, found[1]

"""A middleware that keeps what was published: for tests of what is said, not of how it travels."""

from __future__ import annotations

from typing import Any

from linkrover.middleware import Fields


class Recording:
    name = "recording"
    joined = True
    lost_messages = 0

    def __init__(self) -> None:
        self.messages: list[tuple[str, str, dict[str, Any], bool]] = []

    def publish(self, topic: str, type_name: str, fields: Fields, *, latched: bool = False) -> bool:
        self.messages.append((topic, type_name, dict(fields() if callable(fields) else fields), latched))
        return True

    def topics(self) -> list[str]:
        return [m[0] for m in self.messages]

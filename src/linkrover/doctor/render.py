"""Findings as text and as JSON."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable

import msgspec

from .finding import Finding, Status

_COLOURS = {Status.OK: "32", Status.WARN: "33", Status.FAIL: "31;1", Status.UNKNOWN: "36"}
_STATUS_WIDTH, _NAME_WIDTH = 8, 22


def as_lines(finding: Finding, *, width: int = 100, colour: bool = False) -> list[str]:
    """One finding: verdict, name and value; where something is to be done, why and how."""
    status = finding.status.value.ljust(_STATUS_WIDTH)
    if colour:
        status = f"\x1b[{_COLOURS[finding.status]}m{status}\x1b[0m"
    indent = " " * (_STATUS_WIDTH + _NAME_WIDTH)
    room = max(30, width - len(indent))
    first, *rest = textwrap.wrap(_plain(finding.value), room, break_long_words=False) or [""]
    lines = [f"{status}{finding.check:<{_NAME_WIDTH}}{first}", *(indent + line for line in rest)]
    if finding.status in (Status.WARN, Status.FAIL) and finding.why:
        lines += [indent + line for line in textwrap.wrap(finding.why, room)]
    if finding.mend is not None:
        lines.append(f"{indent}-> {finding.mend}")  # never wrapped: it is to be copied
    return lines


def closing(findings: Iterable[Finding]) -> str:
    """How many of each verdict."""
    counts = Counter(f.status for f in findings)
    return ", ".join(f"{counts[status]} {status.value}" for status in Status)


def as_json(findings: Iterable[Finding]) -> str:
    """All findings and their counts."""
    found = list(findings)
    counts = {status.value: sum(f.status is status for f in found) for status in Status}
    document = {"counts": counts, "findings": [msgspec.to_builtins(f) for f in found]}
    return msgspec.json.format(msgspec.json.encode(document), indent=2).decode()


def _plain(text: str) -> str:
    """Without control characters: names come from the air."""
    return "".join(c if c.isprintable() else "?" for c in text)

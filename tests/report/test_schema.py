from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec

from linkrover.analysis import RunSummary
from linkrover.analysis.summary import SCHEMA_VERSION

PAGE = (Path(__file__).parents[2] / "docs" / "report-schema.md").read_text()


def test_every_key_of_the_report_is_documented() -> None:
    schema: dict[str, Any] = msgspec.json.schema(RunSummary)
    words = set(re.findall(r"[a-z0-9_]+", PAGE))
    for name, definition in schema["$defs"].items():
        if name == "Recovery":
            continue
        missing = set(definition.get("properties", {})) - words
        assert not missing, f"{name}: {missing}"


def test_the_version_of_the_page_is_that_of_the_program() -> None:
    assert f"schema version {SCHEMA_VERSION}" in PAGE

"""Where the published 2021 measurements are, for tests that read them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[1].parent / "shared" / "datasets"
FILES = (
    "router_2G_trial2.csv",
    "internal_client_2G_trial2.csv",
    "internal_server_5G_trial2short.csv",
    "external_robot_5G.csv",
)


def dataset(name: str) -> Path:
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"the published 2021 measurements are not at ../shared/datasets ({name})")
    return path


@cache
def expected() -> dict[str, Any]:
    return json.loads(dataset("expected.json").read_text())

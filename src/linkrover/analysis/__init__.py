"""From recordings to figures of one run, comparisons and recommendations. Heavy packages load on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .load import load_run
    from .run import End, Run
    from .summary import METHODS, RunSummary, summarise

_WHERE = {
    "load_run": "load",
    "End": "run",
    "Run": "run",
    "METHODS": "summary",
    "RunSummary": "summary",
    "summarise": "summary",
}

__all__ = ["METHODS", "End", "Run", "RunSummary", "load_run", "summarise"]


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(f"linkrover.analysis.{_WHERE[name]}"), name)
    raise AttributeError(name)

"""A bar on the terminal for what takes longer than two seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

AFTER_S = 2.0


class Bar:
    """Shows a share of work done, from two seconds on and only where standard error is a terminal."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._began = time.monotonic()
        self._bar: Any = None

    def __call__(self, share: float, what: str | None = None) -> None:
        """So much (0..1) is done; `what` names the present step."""
        self._what = what or self._what
        if self._bar is None:
            if time.monotonic() - self._began < AFTER_S or not sys.stderr.isatty():
                return
            self._start()
        self._bar.update(0, completed=share, description=self._what)

    def _start(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._bar.start()
        self._bar.add_task(self._what, total=1.0)

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()


@contextmanager
def bar(what: str) -> Iterator[Bar]:
    """A bar that goes away at the end."""
    shown = Bar(what)
    try:
        yield shown
    finally:
        shown.close()

"""An agent as a real process, whose JSON lines can be waited for."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from tests.namespace import Namespace

PATIENCE_S = 30.0


class RunningAgent:
    """`linkrover agent --json ARGUMENTS`, in a namespace if given."""

    def __init__(self, arguments: list[str], space: Namespace | None = None) -> None:
        command = ["-m", "linkrover", "agent", "--json", *arguments]
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        if space is None:
            self.process = subprocess.Popen([sys.executable, *command], text=True, **pipes)
        else:
            self.process = space.start(command, **pipes)
        self.records: list[dict[str, Any]] = []
        self.errors = ""
        self._arrived = threading.Condition()
        self._threads = [threading.Thread(target=self._read), threading.Thread(target=self._read_errors)]
        for thread in self._threads:
            thread.start()

    def of(self, kind: str, /, **fields: Any) -> list[dict[str, Any]]:
        """The records of a kind so far whose fields are these."""
        return [r for r in list(self.records) if r["type"] == kind and all(r[k] == v for k, v in fields.items())]

    def wait_for(self, kind: str, count: int = 1, /, **fields: Any) -> list[dict[str, Any]]:
        """Wait until there are `count` such records."""
        return self.wait_until(lambda: self.of(kind, **fields), lambda found: len(found) >= count, f"{kind} {fields}")

    def wait_until(self, look: Callable[[], Any], good: Callable[[Any], bool], what: str) -> Any:
        """Wait until what is looked at is good."""
        deadline = time.monotonic() + PATIENCE_S
        with self._arrived:
            while not good(look()):
                left = deadline - time.monotonic()
                if left <= 0 or self.process.poll() is not None:
                    raise AssertionError(f"no {what} (process: {self.process.poll()}); errors: {self.errors}")
                self._arrived.wait(min(left, 0.2))
        return look()

    def end(self, signal_number: int | None = None) -> int:
        """Send a signal, if given, and wait for the end; the exit status."""
        if signal_number is not None and self.process.poll() is None:
            self.process.send_signal(signal_number)
        status = self.process.wait(PATIENCE_S)
        for thread in self._threads:
            thread.join(PATIENCE_S)
        return status

    def __enter__(self) -> RunningAgent:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.end()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            record = json.loads(line)
            with self._arrived:
                self.records.append(record)
                self._arrived.notify_all()
        self.process.stdout.close()

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.errors += line
        self.process.stderr.close()

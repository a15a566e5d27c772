"""What a check says, and running checks so that a failing one is reported as such."""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Iterator

import msgspec

from linkrover.errors import LinkRoverError


class Status(enum.Enum):
    """The verdict of a check."""

    OK = "OK"
    WARN = "WARN"
    FAIL = "FAIL"
    UNKNOWN = "UNKNOWN"  # it could not be found out; `value` says why


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the doctor. why: what it means for a robot. mend: the exact command, or what to do.

    failed: the check itself broke; `value` holds its error.
    """

    check: str
    status: Status
    value: str
    why: str = ""
    mend: str | None = None
    failed: bool = False


class Check(msgspec.Struct, frozen=True):
    """A named check: a function without arguments that gives one finding or several."""

    name: str
    run: Callable[[], Finding | Iterable[Finding]]


def ok(check: str, value: str, why: str = "") -> Finding:
    """All is well."""
    return Finding(check=check, status=Status.OK, value=value, why=why)


def unknown(check: str, value: str, why: str = "", mend: str | None = None) -> Finding:
    """It could not be found out."""
    return Finding(check=check, status=Status.UNKNOWN, value=value, why=why, mend=mend)


def judged(check: str, status: Status, value: str, why: str, mend: str | None) -> Finding:
    """A verdict; what is well needs no mending."""
    return Finding(check=check, status=status, value=value, why=why, mend=None if status is Status.OK else mend)


def run_checks(checks: Iterable[Check]) -> Iterator[Finding]:
    """Run every check. One that raises becomes an UNKNOWN finding that says so; the others go on."""
    for check in checks:
        try:
            found = check.run()
            findings = [found] if isinstance(found, Finding) else list(found)
        except LinkRoverError as error:
            findings = [unknown(check.name, str(error))]
        except Exception as error:  # noqa: BLE001  # whatever breaks in one check must be shown, and not hide the rest
            value = f"this check itself failed: {type(error).__name__}: {error}"
            findings = [
                Finding(
                    check=check.name, status=Status.UNKNOWN, value=value, failed=True,
                    mend="please report this line, with the output of `linkrover doctor --json`",
                )
            ]  # fmt: skip
        yield from findings

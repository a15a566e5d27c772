"""What LinkRover raises: one family, so that a caller can catch it whole."""

from __future__ import annotations


class LinkRoverError(Exception):
    """Something a user can act on; the message says what to do next."""


class ParseError(LinkRoverError):
    """Input that is not what it should be: names the file, the place in it and what was expected."""

    def __init__(self, file: str, place: str, expected: str, got: str = "") -> None:
        self.file = file
        self.place = place
        self.expected = expected
        self.got = got
        text = f"{file}, {place}: expected {expected}"
        super().__init__(f"{text}, got {got}" if got else text)


class ConfigError(LinkRoverError):
    """A configuration or command-line value that cannot be used; names the key and the allowed values."""


class MissingExtraError(LinkRoverError):
    """A part of LinkRover whose optional packages are not installed."""

    def __init__(self, extra: str, missing: str) -> None:
        super().__init__(
            f"this needs the '{extra}' extra ({missing} is not installed): pip install 'linkrover[{extra}]'"
        )


EXTRA_OF_MODULE = {
    "arch": "report",
    "matplotlib": "report",
    "numpy": "report",
    "plotly": "report",
    "polars": "report",
    "prometheus_client": "live",
    "rosbags": "report",
    "scipy": "report",
    "sklearn": "report",
}
"""Which extra brings a module that the base install lacks."""


def missing_extra(error: ModuleNotFoundError) -> MissingExtraError | None:
    """The same in a user's words; None if the module belongs to no extra (then it is a fault of ours)."""
    module = (error.name or "").partition(".")[0]
    return MissingExtraError(EXTRA_OF_MODULE[module], module) if module in EXTRA_OF_MODULE else None

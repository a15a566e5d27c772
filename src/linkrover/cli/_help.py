"""Help that fits the terminal: a docstring is wrapped for the source, its paragraphs for whoever reads them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

WRAPPED_AT = 70
"""Source lines of at least this length were wrapped: the next one goes on with their sentence."""


def unwrapped(text: str) -> str:
    """Each paragraph on one line; indented lines, lists and short lines stay as they are."""
    lines: list[str] = []
    former = ""
    for line in text.split("\n"):
        goes_on = len(former) >= WRAPPED_AT and line[:1].strip() and not former[0].isspace() and line[0] not in "-*"
        if goes_on:
            lines[-1] += " " + line
        else:
            lines.append(line)
        former = line
    return "\n".join(lines)


def _unwrap(inline: Any) -> None:
    from rich.text import Text

    if isinstance(text := getattr(inline, "primary_renderable", None), Text):
        inline.primary_renderable = Text(unwrapped(text.plain), end=text.end)


class HelpFormatter:
    """cyclopts' own look, with paragraphs that fill the line."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print one panel of commands or parameters."""
        from cyclopts.help.formatters import DefaultFormatter

        for entry in panel.entries:
            _unwrap(entry.description)
        DefaultFormatter()(console, options, panel)

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:
        """Print the line of usage."""
        from cyclopts.help.formatters import DefaultFormatter

        DefaultFormatter().render_usage(console, options, usage)

    def render_description(self, console: Console, options: ConsoleOptions, description: Any) -> None:  # noqa: ARG002
        """Print what the verb is for."""
        if description:
            _unwrap(description)
            console.print(description)

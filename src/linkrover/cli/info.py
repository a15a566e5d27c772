"""`linkrover info`: what is in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from linkrover.bag import Recording, TopicPattern


def info(
    *recordings: Path,
    json: Annotated[bool, Parameter(name="--json", negative=())] = False,
    recover: Annotated[bool, Parameter(negative=())] = False,
    topics: Path | None = None,
) -> int:
    """What is in a recording: who recorded it, when, how long, which topics, and what is damaged or missing.

    RECORDING is a run (a folder with robot/ and station/), a recording folder of LinkRover or rosbag2, an .mcap file,
    a journal of a recorder that was killed or still runs, or a ROS 1 .bag. Nothing is changed unless --recover is
    given. Exit status 0 also where something is damaged: the damage is listed.

    Examples:
      linkrover info runs/monday
      linkrover info runs/monday/robot --json | jq .[0].topics
      linkrover info runs/monday/robot --recover

    Parameters
    ----------
    recordings
        What to look at; several may be given.
    json
        Print one JSON array with an object per recording.
    recover
        Make a finished recording of a journal first (its process was killed).
    topics
        TOML file that says which topics of others hold what, as [[topic]] with topic (a regular expression), type and
        end; see docs/recording.md.
    """
    import sys

    import msgspec
    from rich.console import Console

    from linkrover.bag import DEFAULT_PATTERNS, load_patterns
    from linkrover.errors import ConfigError, LinkRoverError

    if not recordings:
        raise ConfigError("give at least one recording: linkrover info RECORDING...")
    patterns = load_patterns(topics) if topics is not None else DEFAULT_PATTERNS
    # a file or a pipe has no width to fit into
    console = Console() if sys.stdout.isatty() else Console(width=160)
    found: list[dict[str, Any]] = []
    failed = False
    for given in recordings:
        try:
            opened = _open(given, patterns, recover=recover)
        except (LinkRoverError, OSError) as error:
            failed = True
            named = str(given) in str(error)
            print(f"linkrover: {error}" if named else f"linkrover: {given}: {error}", file=sys.stderr)
            continue
        for recording in opened:
            if json:
                found.append(_plain(recording))
            else:
                _show(console, recording)
    if json:
        print(msgspec.json.format(msgspec.json.encode(found), indent=2).decode())
    return 1 if failed else 0


def _open(given: Path, patterns: Sequence[TopicPattern], *, recover: bool) -> list[Recording]:
    import sys

    from linkrover.bag import find_recordings, read_recording
    from linkrover.bag import recover as recover_journal

    from ._progress import bar

    opened = []
    for path in find_recordings(given):
        with bar(f"reading {path.name}") as progress:
            place = path
            if recover and _has_journal(path):
                done = recover_journal(path, progress=progress)
                print(f"recovered {done.path}: {done.messages} messages", file=sys.stderr)
                place = done.path.parent
            opened.append(read_recording(place, patterns=patterns, progress=progress))
    return opened


def _has_journal(path: Path) -> bool:
    return path.name.endswith(".mcap.journal") or (path.is_dir() and any(path.glob("*.mcap.journal")))


def _plain(recording: Recording) -> dict[str, Any]:
    import msgspec

    span = recording.span
    return {
        "path": str(recording.path),
        "format": recording.format,
        "end": recording.end,
        "start_ns": span[0] if span else None,
        "end_ns": span[1] if span else None,
        "duration_s": (span[1] - span[0]) / 1e9 if span else None,
        "messages": recording.messages,
        "bytes": _size(recording),
        "manifest": msgspec.to_builtins(recording.manifest),
        "topics": [msgspec.to_builtins(topic) for topic in recording.topics],
        "problems": list(recording.problems),
    }


def _size(recording: Recording) -> int:
    return sum(file.stat().st_size for file in recording.files)


def _show(console: Console, recording: Recording) -> None:
    from rich.markup import escape
    from rich.table import Table

    lines = [("recording", f"{recording.path} ({recording.format}, {_bytes(_size(recording))})")]
    lines.append(("end", recording.end))
    lines += _when(recording) + _who(recording)
    console.print()
    for name, value in lines:
        console.print(f"[bold]{name:<10}[/bold] {escape(value)}", highlight=False, soft_wrap=True)
    foreign = recording.manifest is None
    table = Table("topic", "type", box=None, pad_edge=False)
    table.add_column("messages", justify="right", no_wrap=True)
    table.add_column("per s", justify="right", no_wrap=True)
    if foreign:
        table.add_column("read as")
    for topic in sorted(recording.topics, key=lambda t: t.name):
        seconds = (topic.last_ns - topic.first_ns) / 1e9
        rate = f"{(topic.count - 1) / seconds:.1f}" if topic.count > 1 and seconds > 0 else ""
        row = [escape(topic.name), escape(topic.type), str(topic.count), rate]
        table.add_row(*row, *([f"{topic.record} ({topic.end})" if topic.record else "not read"] if foreign else []))
    console.print(table)
    for problem in recording.problems:
        console.print(f"[yellow]![/yellow] {escape(problem)}", highlight=False, soft_wrap=True)
    if recording.format == "mcap journal":
        console.print("  linkrover info --recover makes a finished recording of it", highlight=False)


def _when(recording: Recording) -> list[tuple[str, str]]:
    import datetime

    span = recording.span
    if span is None:
        return [("messages", "none")]
    start = datetime.datetime.fromtimestamp(span[0] // 1_000_000_000, tz=datetime.timezone.utc)
    return [
        ("start", f"{start:%Y-%m-%d %H:%M:%S} UTC"),
        ("duration", f"{(span[1] - span[0]) / 1e9:.1f} s, {recording.messages} messages"),
    ]


def _who(recording: Recording) -> list[tuple[str, str]]:
    manifest = recording.manifest
    if manifest is None:
        return [("manifest", "none (not recorded by LinkRover)")]
    lines = [("host", f"{manifest.host}, kernel {manifest.kernel}, {manifest.machine}")]
    lines.append(("by", f"LinkRover {manifest.linkrover_version}, Python {manifest.python}"))
    for interface in manifest.interfaces:
        parts = [interface.name, interface.driver, interface.firmware, interface.mode]
        if interface.frequency_mhz is not None:
            parts.append(f"{interface.frequency_mhz} MHz")
        if interface.power_save is not None:
            parts.append(f"power save {'on' if interface.power_save else 'off'}")
        lines.append(("interface", ", ".join(part for part in parts if part)))
    case = [("case", manifest.case), ("trial", manifest.trial), ("run", manifest.run)]
    lines += [(name, str(value)) for name, value in case if value is not None]
    kind = [word for word, is_so in (("simulated", manifest.simulated), ("emulated", manifest.emulated)) if is_so]
    if manifest.imported_from:
        kind.append(f"imported from {manifest.imported_from}")
    return lines + ([("origin", ", ".join(kind))] if kind else [])


def _bytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"

"""A ROS 1 bag of the 2021 package as a run folder of ordinary recordings."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec

from linkrover import __version__
from linkrover.bag import DEFAULT_PATTERNS, Recorder, load_patterns, read_recording
from linkrover.errors import LinkRoverError
from linkrover.records import Interface, Manifest, Record, Role

from .naming import Setup, guess_setup
from .trial import NOT_RECORDED, run_name


class ImportedBag(msgspec.Struct, frozen=True):
    """What became of a bag."""

    folder: Path
    setup: Setup
    counts: dict[str, int]
    problems: tuple[str, ...]


def import_bag(
    path: Path,
    out: Path,
    case: str | None = None,
    trial: int | None = None,
    name: str | None = None,
    topics: Path | None = None,
) -> ImportedBag:
    """Write `out/<name>/robot` and `.../station` from a bag that holds the messages of both ends.

    topics: TOML table of topic patterns (see docs/recording.md). Raises LinkRoverError if the bag holds nothing of
    either end, if the folder exists, or if it cannot be written.
    """
    patterns = load_patterns(topics) if topics is not None else DEFAULT_PATTERNS
    recording = read_recording(path, patterns=patterns)
    ends: dict[str, list[Record]] = {}
    for end, record in recording.entries():
        ends.setdefault(end, []).append(record)
    roles = [role for role in Role if role.value in ends]
    if not roles:
        raise LinkRoverError(
            f"{path}: no topic of it is known as one of the robot's or the station's; say which is what with --topics "
            f"('linkrover info {path}' lists them)"
        )
    setup = guess_setup(path, case, trial)
    folder = out / (name or run_name(path))
    if folder.exists():
        raise LinkRoverError(f"{folder} exists already; remove it, or give another --out or --name")
    try:
        for role in roles:
            manifest = _manifest(ends[role.value], role, path, folder.name, setup, recording.problems)
            with Recorder(folder / role.value, manifest) as recorder:
                for record in ends[role.value]:
                    recorder.take(record)
            if recorder.problem or recorder.records_lost:
                raise LinkRoverError(f"cannot write {folder}: {recorder.problem or 'records were lost'}")  # noqa: TRY301
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return ImportedBag(folder, setup, {e: len(r) for e, r in ends.items()}, recording.problems)


def _manifest(
    records: list[Record], role: Role, path: Path, run: str, setup: Setup, problems: tuple[str, ...]
) -> Manifest:
    first = min(record.wall_ns for record in records)
    names = sorted({iface for r in records if (iface := getattr(r, "iface", ""))})
    return Manifest(
        wall_ns=first,
        mono_ns=first,
        linkrover_version=__version__,
        role=role,
        host=NOT_RECORDED,
        kernel=NOT_RECORDED,
        machine=NOT_RECORDED,
        python=NOT_RECORDED,
        interfaces=tuple(Interface(name=name) for name in names),
        middleware="ros1",
        case=setup.case,
        trial=setup.trial,
        run=run,
        imported_from=path.name,
        repairs=problems,
        notes={"publisher": "2021", **setup.factors()},
    )

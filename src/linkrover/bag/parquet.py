"""Recordings -> a partitioned Parquet dataset: `DIR/<record>/fleet=F/robot=R/run=N/<end>-0000.parquet`.

One recording is one `Job`, and `convert_recording(job)` is a pure function of it that can be pickled: a pool of
processes here, or an existing engine (Dask, Ray) over many machines, spreads jobs alike.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import msgspec

from linkrover.errors import LinkRoverError
from linkrover.messages.topics import snake
from linkrover.records import Manifest, Record

from .patterns import DEFAULT_PATTERNS, TopicPattern
from .reading import find_recordings, read_manifest


class Job(msgspec.Struct, frozen=True):
    """One recording to convert, and where it belongs."""

    recording: Path
    out: Path
    fleet: str
    robot: str
    run: str
    patterns: tuple[TopicPattern, ...] = DEFAULT_PATTERNS
    replace: bool = False

    @property
    def partition(self) -> Path:
        """The partition's path below a record's folder. Characters a file name cannot hold are %-escaped."""
        return Path(*(f"{key}={quote(value, safe=' +@,')}" for key, value in self._keys()))

    def _keys(self) -> tuple[tuple[str, str], ...]:
        return (("fleet", self.fleet), ("robot", self.robot), ("run", self.run))


class Converted(msgspec.Struct, frozen=True):
    """What became of a job: rows by record type, files written, and what the recording lacked."""

    recording: Path
    rows: dict[str, int]
    files: tuple[Path, ...]
    problems: tuple[str, ...]


def plan(
    runs: Sequence[Path],
    out: Path,
    *,
    fleet: str = "default",
    robot: str | None = None,
    patterns: Sequence[TopicPattern] = DEFAULT_PATTERNS,
    replace: bool = False,
) -> list[Job]:
    """The jobs of these runs. robot: the robot's host as its manifest has it, if not given; run: the manifest's name
    of the run, or the folder's.

    Raises LinkRoverError if two different runs would come into one partition, or a run holds no recording.
    """
    jobs: list[Job] = []
    places: dict[Path, Path] = {}
    for run in runs:
        found = find_recordings(run)
        manifests = [read_manifest(path) for path in found]
        name = next((m.run for m in manifests if m is not None and m.run), None) or _stem(run)
        who = robot or _robot(manifests)
        for recording in found:
            job = Job(recording, out, fleet, who, name, tuple(patterns), replace)
            other = places.setdefault(job.partition, run)
            if other != run:
                raise LinkRoverError(
                    f"{run} and {other} would both be fleet={fleet}, robot={who}, run={name}: convert them with "
                    "different --fleet or --robot, or rename a folder"
                )
            jobs.append(job)
    return jobs


def _robot(manifests: Sequence[Manifest | None]) -> str:
    known = [m for m in manifests if m is not None]
    robots = [m.host for m in known if m.role.value == "robot"]
    return (robots or [m.host for m in known] or ["unknown"])[0] or "unknown"


def _stem(run: Path) -> str:
    resolved = run.resolve()
    name = resolved.name if resolved.is_dir() else re.sub(r"\.(mcap|bag)(\.journal|\.active)?$", "", resolved.name)
    return name or "run"


def convert_recording(job: Job) -> Converted:
    """Write one recording's records. Memory stays bounded: every batch of the recording is a file.

    Raises LinkRoverError where the partition holds this recording already (and not job.replace) or cannot be written.
    """
    from .frames import iter_frames

    problems: list[str] = []
    rows: dict[str, int] = {}
    files: list[Path] = []
    stem = quote(_stem(job.recording), safe="")
    _make_room(job, stem)
    try:
        for number, frames in enumerate(iter_frames(job.recording, patterns=job.patterns, problems=problems)):
            for kind, frame in frames.items():
                target = job.out / folder(kind) / job.partition / f"{stem}-{number:04}.parquet"
                target.parent.mkdir(parents=True, exist_ok=True)
                part = target.with_suffix(".part")
                try:
                    frame.write_parquet(part, compression="zstd")
                    part.rename(target)
                finally:
                    part.unlink(missing_ok=True)
                files.append(target)
                rows[kind.__name__] = rows.get(kind.__name__, 0) + len(frame)
    except OSError as error:
        raise LinkRoverError(f"{job.recording}: cannot write below {job.out}: {error.strerror or error}") from error
    return Converted(job.recording, rows, tuple(files), tuple(dict.fromkeys(problems)))


def folder(kind: type[Record]) -> str:
    """The dataset's folder of a record type, such as "wireless_link"."""
    return snake(kind.__name__)


def _make_room(job: Job, stem: str) -> None:
    present = sorted(job.out.glob(f"*/{_literal(job.partition)}/{_literal(Path(stem))}-*.parquet"))
    if present and not job.replace:
        raise LinkRoverError(
            f"{job.recording} is in the dataset already ({present[0].parent}): give --replace to renew it"
        )
    for file in present:
        file.unlink()


def _literal(path: Path) -> str:
    return re.sub(r"([\[\]*?])", r"[\1]", str(path))

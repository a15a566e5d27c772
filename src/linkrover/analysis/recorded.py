"""Recordings on a disk to the tables of each end."""

from __future__ import annotations

from pathlib import Path

from linkrover.errors import LinkRoverError

from .columns import RawEnd, from_records

KINDS = ("robot", "station", "truth")


def read_raw(path: Path) -> tuple[dict[str, RawEnd], list[str]]:
    """The tables of every end found at `path`, and what was damaged or could not be read.

    Raises LinkRoverError if nothing at all can be read.
    """
    from linkrover.bag.reading import find_recordings, read_recording
    from linkrover.records import Record

    raws: dict[str, RawEnd] = {}
    problems: list[str] = []
    errors: list[LinkRoverError] = []
    for place in find_recordings(path):
        try:
            recording = read_recording(place)
            by_end: dict[str, list[Record]] = {}
            for end, record in recording.entries():
                by_end.setdefault(end, []).append(record)
        except LinkRoverError as error:
            errors.append(error)
            problems.append(f"{place.name}: cannot be read: {error}")
            continue
        if recording.end == "truth":
            by_end = {"truth": by_end.get("truth", [])}
        for end, records in by_end.items():
            if end not in KINDS:
                problems.append(f"{place.name}: topics of '{end}' are of neither end and left out")
                continue
            found = from_records(records)
            if recording.manifest is not None and (end == recording.end or found.manifest is None):
                found.manifest = found.manifest or recording.manifest
            found.published_2021 = recording.manifest is None
            if end in raws:
                problems.append(f"{place.name}: a second recording of the {end}; the first one is used")
            else:
                raws[end] = found
        problems += [f"{place.name}: {problem}" for problem in recording.problems]
    if not any(end in raws for end in ("robot", "station")):
        if errors:
            raise errors[0]
        raise LinkRoverError(f"{path}: no samples of a robot or a station in it; 'linkrover info {path}' shows what is")
    return raws, problems

"""`linkrover import`: the published 2021 CSV files as ordinary recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def import_(
    *files: Path,
    out: Path,
    case: str | None = None,
    trial: int | None = None,
    name: str | None = None,
    topics: Path | None = None,
    json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Turn CSV files and ROS 1 bags of the 2021 measurements into ordinary recordings.

    Each file becomes a run folder OUT/<file name> with a recording of the robot and one of the station, which every
    other verb takes. The real samples are recovered from the repeated rows, and everything that had to be mended is
    listed and kept in the recording's manifest. The case and the trial are guessed from the file name.

    Example: linkrover import external_robot_5G.csv --out runs && linkrover report runs/external_robot_5G

    Parameters
    ----------
    files
        CSV files of that family, or ROS 1 bags of the 2021 package; any other file is refused with what was expected.
    out
        Folder in which the run folders are made; nothing in it is overwritten.
    case
        Case of the set-up (1 to 10 of the paper's Table I, or any name), instead of the guessed one.
    trial
        Number of the trial, instead of the guessed one.
    name
        Name of the run folder, for a single file.
    topics
        For bags: TOML table that says which topic is what, where names differ from the 2021 package's.
    json
        Print one JSON object a file instead of sentences.
    """
    import sys

    import msgspec

    from linkrover.errors import ConfigError, LinkRoverError
    from linkrover.importer.trial import load_trial
    from linkrover.importer.write import write_run

    if not files:
        print("linkrover: give at least one file: linkrover import FILE.csv... --out DIR", file=sys.stderr)
        return 2
    if name is not None and (len(files) > 1 or Path(name).name != name or name in ("", ".", "..")):
        raise ConfigError("--name needs a plain folder name and a single file")
    failed = 0
    for file in files:
        if file.suffix.lower() == ".bag":
            failed += not _bag(file, out, case, trial, name, topics, as_json=json)
            continue
        try:
            trial_read = load_trial(file, case, trial, name)
            folder = write_run(trial_read, out)
        except LinkRoverError as error:
            failed += 1
            if json:
                print(msgspec.json.encode({"file": str(file), "error": str(error)}).decode())
            print(f"linkrover: {error}", file=sys.stderr)
            continue
        if json:
            done = {
                "file": str(file),
                "run": str(folder),
                "case": trial_read.setup.case,
                "trial": trial_read.setup.trial,
                "rows": len(trial_read.sheet.wall_ns),
                "repairs": trial_read.repairs,
            }
            print(msgspec.json.encode(done).decode())
            continue
        place = f"case {trial_read.setup.case or 'not known'}, trial {trial_read.setup.trial or 'not known'}"
        print(f"{folder}: {place}, {len(trial_read.sheet.wall_ns)} rows")
        for repair in trial_read.repairs:
            print(f"  mended: {repair}")
    return 1 if failed else 0


def _bag(
    file: Path, out: Path, case: str | None, trial: int | None, name: str | None, topics: Path | None, *, as_json: bool
) -> bool:
    """Import one bag; False and a line on stderr where that cannot be."""
    import sys

    import msgspec

    from linkrover.errors import LinkRoverError
    from linkrover.importer.bag import import_bag

    try:
        done = import_bag(file, out, case, trial, name, topics)
    except LinkRoverError as error:
        if as_json:
            print(msgspec.json.encode({"file": str(file), "error": str(error)}).decode())
        print(f"linkrover: {error}", file=sys.stderr)
        return False
    if as_json:
        found = {"file": str(file), "run": str(done.folder), "case": done.setup.case, "trial": done.setup.trial}
        print(msgspec.json.encode({**found, "records": done.counts, "repairs": done.problems}).decode())
        return True
    counts = ", ".join(f"{count} records of the {end}" for end, count in done.counts.items())
    print(f"{done.folder}: case {done.setup.case or 'not known'}, {counts}")
    for problem in done.problems:
        print(f"  problem: {problem}")
    return True

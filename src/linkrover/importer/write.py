"""An imported trial on disk: a run folder with one ordinary recording per end."""

from __future__ import annotations

import shutil
from pathlib import Path

from linkrover.bag import Recorder
from linkrover.errors import LinkRoverError

from .trial import Trial


def write_run(trial: Trial, out: Path) -> Path:
    """Write `out/<name>/robot` and `out/<name>/station`; returns the run's folder, never overwrites one.

    Raises LinkRoverError if the folder exists or cannot be written. An interrupted import leaves no half run.
    """
    folder = out / trial.name
    if folder.exists():
        raise LinkRoverError(f"{folder} exists already; remove it, or give another --out or --name")
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise LinkRoverError(f"cannot create {folder}: {error.strerror or error}") from error
    try:
        for role in trial.ends:
            with Recorder(folder / role.value, trial.manifest(role)) as recorder:
                for record in trial.records(role):
                    recorder.take(record)
            _check(recorder, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def _check(recorder: Recorder, folder: Path) -> None:
    if recorder.problem or recorder.records_lost:
        raise LinkRoverError(f"cannot write {folder}: {recorder.problem or 'records were lost'}")

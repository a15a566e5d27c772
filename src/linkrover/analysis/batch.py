"""Many runs at once: what on a disk is a run, and loading with progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from linkrover.errors import LinkRoverError

from .load import ENDS, load_run
from .run import Run

RECORDINGS = (".mcap", ".bag", ".csv", ".db3")


def is_run(path: Path) -> bool:
    """Whether a folder is one run: it holds an end, or is itself a recording."""
    if any((path / role).is_dir() for role in ENDS):
        return True
    return (path / "metadata.yaml").is_file() or any(path.glob("*.mcap")) or any(path.glob("*.mcap.journal"))


def find_runs(paths: Iterable[Path]) -> list[Path]:
    """The runs among the given paths; a folder of runs stands for those in it, also below (cases, trials).

    A path that is nothing of the kind is kept, so that loading can say what is wrong with it.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir() or is_run(path):
            found.append(path)
            continue
        inside = sorted(p for p in path.rglob("*") if p.is_dir() and is_run(p))
        runs = [p for p in inside if not any(q in p.parents for q in inside)]
        bags = sorted(p for p in path.iterdir() if p.suffix in (".csv", ".bag") and p.is_file())
        found += [*runs, *bags] or [path]
    return list(dict.fromkeys(found))


def load_all(
    paths: Sequence[Path], topics: Path | None = None, progress: Callable[[str], None] | None = None
) -> tuple[list[Run], list[tuple[Path, LinkRoverError]]]:
    """Load every run; those that cannot be read come back with their error. `progress` is told what is read."""
    runs: list[Run] = []
    failed: list[tuple[Path, LinkRoverError]] = []
    for i, path in enumerate(paths):
        if progress is not None:
            progress(f"reading {path} ({i + 1} of {len(paths)})")
        try:
            runs.append(load_run(path, topics=topics))
        except LinkRoverError as error:
            failed.append((path, error))
    return runs, failed

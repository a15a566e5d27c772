"""`linkrover convert`: recordings to a partitioned Parquet dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from linkrover.bag.parquet import Converted, Job
    from linkrover.errors import LinkRoverError


def convert(
    *runs: Path,
    to: Annotated[tuple[Literal["parquet"], Path], Parameter(negative=())],
    fleet: str = "default",
    robot: str | None = None,
    jobs: int | None = None,
    replace: Annotated[bool, Parameter(negative=())] = False,
    topics: Path | None = None,
    json: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Convert recordings to a Parquet dataset that Polars, DuckDB or Spark query lazily.

    The dataset has one folder per kind of record, partitioned by fleet, robot and run:
    DIR/wireless_link/fleet=F/robot=R/run=N/robot-0000.parquet. Columns are the record's fields (docs/recording.md)
    and "end"; unknown is null.

    Examples:
      linkrover convert runs/* --to parquet dataset
      python -c 'import polars as pl; print(pl.scan_parquet("dataset/wireless_link").group_by("run")
      .agg(pl.mean("rssi_dbm")).collect())'

    Parameters
    ----------
    runs
        Runs, recordings, ROS 1 bags, or folders of runs.
    to
        The form (parquet) and the folder of the dataset, which may hold other runs already.
    fleet
        Name of the fleet these runs belong to.
    robot
        Name of the robot; by default the host name in the robot's manifest.
    jobs
        Recordings converted at the same time; by default one per processor.
    replace
        Renew what the dataset already holds of these recordings; without it that is an error.
    topics
        TOML file that says which topics of others hold what; see docs/recording.md.
    json
        Print one JSON object per recording.
    """
    import sys

    import msgspec

    from linkrover.analysis.batch import find_runs
    from linkrover.bag import DEFAULT_PATTERNS, load_patterns
    from linkrover.bag.parquet import plan
    from linkrover.errors import ConfigError, LinkRoverError, MissingExtraError

    from ._progress import bar

    if not runs:
        raise ConfigError("give at least one run: linkrover convert RUN... --to parquet DIR")
    try:
        import polars  # noqa: F401
    except ImportError:
        raise MissingExtraError("report", "polars") from None
    patterns = load_patterns(topics) if topics is not None else DEFAULT_PATTERNS
    work = plan(find_runs(runs), to[1], fleet=fleet, robot=robot, patterns=patterns, replace=replace)
    failed = False
    with bar("converting") as progress:
        for number, (job, done) in enumerate(_spread(work, jobs), 1):
            progress(number / len(work), f"{number} of {len(work)} recordings")
            if isinstance(done, LinkRoverError):
                failed = True
                print(f"linkrover: {done}", file=sys.stderr)
            elif json:
                print(msgspec.json.encode(done, enc_hook=str).decode())
            else:
                print(f"{job.recording}: {sum(done.rows.values())} rows to {job.out / '*' / job.partition}")
                for problem in done.problems:
                    print(f"  ! {problem}")
    return 1 if failed else 0


def _spread(work: Sequence[Job], jobs: int | None) -> Iterator[tuple[Job, Converted | LinkRoverError]]:
    """Every job with its result, as they come."""
    import os

    number = min(jobs or os.cpu_count() or 1, len(work))
    if number <= 1:
        for job in work:
            yield job, _one(job)
        return
    import multiprocessing
    import signal
    from concurrent.futures import ProcessPoolExecutor, as_completed

    # spawn: a forked child of a process with polars' threads may hang. Ctrl-C is for this process: it cancels what has
    # not begun and lets the others finish their file
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(number, spawn, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        waiting = {pool.submit(_one, job): job for job in work}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _one(job: Job) -> Converted | LinkRoverError:
    from linkrover.bag.parquet import convert_recording
    from linkrover.errors import LinkRoverError

    try:
        return convert_recording(job)
    except LinkRoverError as error:
        return LinkRoverError(str(error))

"""`linkrover report`: figures of runs as terminal tables, HTML, Markdown, LaTeX, CSV or JSON."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from rich.status import Status

    from linkrover.analysis.run import Run
    from linkrover.analysis.summary import RunSummary
    from linkrover.report.floor import Wall

Format = Literal["html", "md", "latex", "csv", "json"]
SUFFIXES: dict[str, Format] = {".html": "html", ".md": "md", ".tex": "latex", ".csv": "csv", ".json": "json"}


def report(
    *runs: Path,
    method: Literal["linkrover", "pandey2022"] = "linkrover",
    format: Format | None = None,  # noqa: A002 - the option's name
    out: Path | None = None,
    outage_threshold: float = 1.0,
    topics: Path | None = None,
    need: Annotated[tuple[str, ...], Parameter(negative=())] = (),
    figures: Path | None = None,
    figure_format: Annotated[tuple[Literal["png", "svg", "pdf"], ...], Parameter(negative=())] = ("png",),
    floor_plan: Path | None = None,
) -> int:
    """Report one or several runs: tables, words, figures.

    A RUN is a folder with robot/ and station/, a single recording, a ROS 1 bag, a CSV file of the 2021 data, or a
    folder of runs. Several runs are compared by case and trial. Without --format the report goes to the terminal.

    Examples:
      linkrover report runs/monday
      linkrover report runs/* --format html --out report.html
      linkrover report external_robot_5G.csv --method pandey2022 --format md

    Parameters
    ----------
    runs
        What to report.
    method
        linkrover: time-weighted over the samples really taken, outages counted. pandey2022: the paper's own formulas,
        row by row, for comparison with its printed tables.
    format
        html (one file without network access), md, latex (tables, needs booktabs), csv (one row a figure) or json
        (schema in docs/report-schema.md).
    out
        File to write; its ending also says the format (.tex is latex). For csv also a folder, which gets every table
        as its own file. Default: standard output, for html the file linkrover-report.html.
    outage_threshold
        Seconds without an answered probe from which on it is an outage.
    topics
        TOML table that says which topic of other people's bags is what ([[topic]] with topic, type, end).
    need
        A need to check every set-up against, for example --need "camera: throughput >= 30" or
        --need "commands: delay.p99 <= 100, loss <= 1". May be given several times.
    figures
        Folder to draw every figure into as a file of its own, besides the report.
    figure_format
        png, svg or pdf; may be given several times.
    floor_plan
        TOML file with [[walls]] (x1_m, y1_m, x2_m, y2_m in the odometry's frame) to draw under the maps.
    """
    import sys

    from linkrover.analysis.batch import find_runs, load_all
    from linkrover.errors import ConfigError

    if not runs:
        print("linkrover: give at least one RUN: linkrover report RUN...", file=sys.stderr)
        return 2
    if not 0 < outage_threshold < float("inf"):
        raise ConfigError(f"--outage-threshold {outage_threshold:g}: must be more than 0 s")
    if out is not None and format is None:
        format = SUFFIXES.get(out.suffix.lower())  # noqa: A001 - the option's name
        if format is None:
            raise ConfigError(
                f"--out {out}: say --format html, md, latex, csv or json, or end its name in .html, .md ..."
            )
    from linkrover.analysis.summary import summarise

    walls: list[Wall] = []
    if floor_plan is not None:
        from linkrover.radio.walls import load_floor_plan

        walls = [(w.x1_m, w.y1_m, w.x2_m, w.y2_m) for w in load_floor_plan(floor_plan).walls]
    with _status() as status:

        def say(text: str) -> None:
            if status is not None:
                status.update(text)

        loaded, failed = load_all(find_runs(runs), topics, say)
        summaries = []
        for run in loaded:
            say(f"summing up {run.name}")
            summaries.append(summarise(run, method, outage_threshold_s=outage_threshold))
        drawn: list[Path] = []
        if figures is not None and loaded:
            from linkrover.report.figures import write_figures
            from linkrover.report.views import views_of

            say("drawing the figures")
            views = views_of(loaded, summaries)
            drawn = list(write_figures(views, figures, figure_format))
        if format == "html" and loaded:
            from linkrover.report.views import write_html

            say("drawing the report")
            write_html(loaded, summaries, out or Path("linkrover-report.html"), need, walls)
    for path, error in failed:
        named = str(path) in str(error)
        print(f"linkrover: left out: {error}" if named else f"linkrover: left out: {path}: {error}", file=sys.stderr)
    if not loaded:
        return 1
    for path in drawn:
        print(path)
    if format == "html":
        print(out or Path("linkrover-report.html"))
    elif format == "json":
        import msgspec

        _put(msgspec.json.format(msgspec.json.encode(summaries), indent=2).decode() + "\n", out)
    elif format == "csv":
        _csv(loaded, summaries, out, need)
    else:
        from linkrover.report.document import as_latex, as_markdown, build_document, print_document

        document = build_document(summaries, loaded, need)
        if format == "md":
            _put(as_markdown(document), out)
        elif format == "latex":
            _put(as_latex(document), out)
        else:
            print_document(document)
    return 1 if failed else 0


def _status() -> AbstractContextManager[Status | None]:
    """A line on the terminal that says what is going on; nothing where there is none."""
    import sys

    if not sys.stderr.isatty():
        return nullcontext()
    from rich.console import Console

    return Console(stderr=True).status("looking for runs")


def _put(text: str, out: Path | None) -> None:
    from linkrover.errors import LinkRoverError

    if out is None:
        print(text, end="")
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise LinkRoverError(f"cannot write {out}: {error.strerror or error}") from error
    print(out)


def _csv(loaded: list[Run], summaries: list[RunSummary], out: Path | None, need: tuple[str, ...]) -> None:
    from linkrover.report.tidy import tidy_csv

    if out is None or out.suffix:
        _put(tidy_csv(summaries), out)
        return
    from linkrover.report.document import build_document
    from linkrover.report.table import comma_separated

    _put(tidy_csv(summaries), out / "figures.csv")
    taken: set[str] = set()
    for table in build_document(summaries, loaded, need).tables:
        plain = name = "".join(c if c.isalnum() or c in "-_." else "_" for c in table.name)
        while name in taken:  # trials of several cases may bear the same run name
            name = f"{plain}-{len(taken)}"
        taken.add(name)
        _put(comma_separated(table), out / f"{name}.csv")

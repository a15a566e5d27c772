"""What a report says, in order: words, tables, what is missing. Every format shows the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from linkrover.analysis.run import Run
from linkrover.analysis.summary import RunSummary

from .details import detail_sections
from .place_words import place_words
from .run_words import limits, overview, summary_words
from .section import Section
from .table import Column, Table, latex, markdown, terminal
from .tables import label, run_table, table_three, table_two


@dataclass(slots=True)
class Document:
    """A whole report."""

    title: str
    sections: list[Section] = field(default_factory=list)

    @property
    def tables(self) -> list[Table]:
        """Every table, in order."""
        return [table for section in self.sections for table in section.tables]


def build_document(summaries: Sequence[RunSummary], runs: Sequence[Run] = (), needs: Sequence[str] = ()) -> Document:
    """The report of one or several runs."""
    title = f"Run {summaries[0].run}" if len(summaries) == 1 else f"{len(summaries)} runs"
    document = Document(f"LinkRover report: {title}")
    document.sections.append(Section("In short", overview(summaries)))
    document.sections.extend(comparison_sections(summaries, runs, needs))
    for i, summary in enumerate(summaries):
        section = Section(label(summary), summary_words(summary), [run_table(summary)])
        if summary.outages:
            section.tables.append(outage_table(summary))
        if summary.method == "linkrover" and i < len(runs):
            section.words += place_words(runs[i])
        if summary.recoveries:
            section.tables.append(recovery_table(summary))
        document.sections.append(section)
        for part in detail_sections(summary):
            part.heading = part.heading if len(summaries) == 1 else f"{label(summary)}: {part.heading.lower()}"
            document.sections.append(part)
    document.sections.append(Section("Method and limits", limits(summaries)))
    return document


def comparison_sections(
    summaries: Sequence[RunSummary], runs: Sequence[Run] = (), needs: Sequence[str] = ()
) -> list[Section]:
    """Set-ups side by side, and what may be said about their differences."""
    from linkrover.analysis.effects import factor_effects, holm
    from linkrover.analysis.matching import still_effects
    from linkrover.analysis.needs import parse_needs, recommend

    from .comparison import case_key, case_table, effect_table, effect_words
    from .recommendation import need_table, need_words

    ordered = sorted(summaries, key=lambda s: (*case_key(s.case or ""), s.trial or 0))
    side = Section("Set-ups side by side", [], [table_two(ordered), table_three(ordered)])
    sections = [side] if len(summaries) > 1 or summaries[0].method == "pandey2022" else []
    if len(summaries) > 1 and all(s.method == "linkrover" for s in summaries):
        if (cases := case_table(ordered)) is not None:
            side.tables.append(cases)
        effects = holm([*factor_effects(summaries), *still_effects(runs)])
        table = effect_table(effects)
        sections.append(Section("What the set-ups change", effect_words(effects), [table] if table else []))
    if needs:
        fits = recommend(summaries, parse_needs(needs), runs)
        sections.append(Section("Which set-up for which traffic", need_words(fits), [need_table(fits)]))
    return sections


def outage_table(summary: RunSummary) -> Table:
    """When and where the link was out."""
    columns = (
        Column("from (s)", 2),
        Column("to (s)", 2),
        Column("length (s)", 2),
        Column("x (m)", 2),
        Column("y (m)", 2),
        Column("from the start (m)", 1),
        Column("last RSSI (dBm)", 0),
    )
    table = Table(f"Outages longer than {summary.outage_threshold_s} s", columns, name=f"outages-{summary.run}")
    for o in summary.outages:
        table.rows.append([o.start_s, o.end_s, o.duration_s, o.x_m, o.y_m, o.distance_m, o.rssi_dbm])
    if not summary.outages[-1].ended:
        table.notes.append("The last one was still on when the recording ended.")
    return table


def recovery_table(summary: RunSummary) -> Table:
    """After each interruption: the radio's gap, the probe's and the application's, side by side."""
    methods = sorted({method for r in summary.recoveries for method in r.application_back_s})
    columns = (
        Column("at (s)", 1),
        Column("what"),
        Column("seen at"),
        Column("from"),
        Column("to"),
        Column("radio back after (s)", 2),
        Column("first probe (s)", 2),
        *(Column(f"{method} (s)", 2) for method in methods),
        Column("x (m)", 2),
        Column("y (m)", 2),
    )
    table = Table("What came back when", columns, name=f"recoveries-{summary.run}")
    for r in summary.recoveries:
        back = [r.application_back_s.get(method) for method in methods]
        place = [r.x_m, r.y_m]
        row: list[str | float | int | None] = [r.begin_s, r.cause, r.end, r.previous_bssid, r.bssid]
        table.rows.append([*row, r.radio_back_s, r.probe_back_s, *back, *place])
    return table


def as_markdown(document: Document) -> str:
    """One Markdown document."""
    parts = [f"# {document.title}\n"]
    for section in document.sections:
        parts.append(f"## {section.heading}\n")
        if section.words:
            parts.append("\n".join(f"- {sentence}" for sentence in section.words) + "\n")
        parts.extend(markdown(table) for table in section.tables)
    return "\n".join(parts)


def as_latex(document: Document) -> str:
    """The tables as LaTeX, to be included; needs the booktabs package."""
    return "% needs \\usepackage{booktabs}\n" + "\n".join(latex(table) for table in document.tables)


def print_document(document: Document) -> None:
    """The report on the terminal."""
    from rich.console import Console
    from rich.markup import escape

    console = Console()
    console.print(f"[bold]{escape(document.title)}[/]")
    for section in document.sections:
        console.print(f"\n[bold underline]{escape(section.heading)}[/]")
        for sentence in section.words:
            console.print(f"  {escape(sentence)}", highlight=False)
        for table in section.tables:
            console.print(terminal(table, console.width))

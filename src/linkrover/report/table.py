"""A table once, shown as terminal text, Markdown, LaTeX or CSV."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, field
from typing import Literal

Better = Literal["high", "low"]
UNKNOWN = "–"


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its heading with the unit, how many decimals, and which values are better."""

    heading: str
    decimals: int = 1
    better: Better | None = None
    truncate: bool = False  # the paper printed truncated, not rounded
    short: str = ""  # heading on a terminal, where there is little room
    spare: bool = False  # the first to go where a terminal is too narrow, as spreads are


@dataclass(slots=True)
class Table:
    """Rows of text and numbers; `None` is an unknown value. Notes stand below."""

    title: str
    columns: tuple[Column, ...]
    rows: list[list[str | float | int | None]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    name: str = "table"

    def best(self) -> set[tuple[int, int]]:
        """The best cell of every column that has a better side; ties all count, a single row has no best."""
        found: set[tuple[int, int]] = set()
        for j, column in enumerate(self.columns):
            if column.better is None:
                continue
            known = [(row[j], i) for i, row in enumerate(self.rows) if isinstance(row[j], (int, float))]
            values = [v for v, _ in known if isinstance(v, (int, float)) and math.isfinite(v)]
            if len(values) < 2:
                continue
            top = max(values) if column.better == "high" else min(values)
            found |= {(i, j) for v, i in known if v == top}
        return found

    def text(self, i: int, j: int) -> str:
        """One cell as it is shown."""
        return show(self.rows[i][j], self.columns[j])


def without_unknown(table: Table) -> Table:
    """The same without the columns in which nothing is known, named in a note."""
    empty = [j for j in range(len(table.columns)) if all(row[j] is None for row in table.rows)]
    if not empty or not table.rows:
        return table
    kept = [j for j in range(len(table.columns)) if j not in empty]
    names = ", ".join(table.columns[j].heading for j in empty)
    return Table(
        table.title,
        tuple(table.columns[j] for j in kept),
        [[row[j] for j in kept] for row in table.rows],
        [*table.notes, f"Not known for any row: {names}."],
        table.name,
    )


def show(value: str | float | int | None, column: Column) -> str:
    """A value with its column's decimals; rounded, or truncated where the paper did so."""
    if value is None:
        return UNKNOWN
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return UNKNOWN
    if column.truncate:
        return f"{truncated(value, column.decimals):.{column.decimals}f}"
    return f"{value:.{column.decimals}f}"


def truncated(value: float, decimals: int = 1) -> float:
    """Cut after so many decimals, towards zero."""
    scale = 10**decimals
    return float(math.trunc(round(value * scale, 6)) / scale)


def markdown(table: Table) -> str:
    """GitHub-flavoured Markdown, best values in bold."""
    best = table.best()
    lines = [f"### {table.title}", ""] if table.title else []
    lines.append("| " + " | ".join(_md(c.heading) for c in table.columns) + " |")
    numeric = [any(isinstance(row[j], (int, float)) for row in table.rows) for j in range(len(table.columns))]
    lines.append("|" + "|".join("---:" if n else "---" for n in numeric) + "|")
    for i in range(len(table.rows)):
        cells = [_md(table.text(i, j)) for j in range(len(table.columns))]
        lines.append("| " + " | ".join(f"**{c}**" if (i, j) in best else c for j, c in enumerate(cells)) + " |")
    if table.notes:
        lines += ["", *(f"{_md(note)}  " for note in table.notes)]
    return "\n".join(lines) + "\n"


def latex(table: Table) -> str:
    """A `table` environment with booktabs rules (needs the booktabs package), best values in bold."""
    best = table.best()
    numeric = [any(isinstance(row[j], (int, float)) for row in table.rows) for j in range(len(table.columns))]
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{_tex(table.title)}}}",
        rf"  \label{{tab:{table.name}}}",
        rf"  \begin{{tabular}}{{{''.join('r' if n else 'l' for n in numeric)}}}",
        r"    \toprule",
        "    " + " & ".join(_tex(c.heading) for c in table.columns) + r" \\",
        r"    \midrule",
    ]
    for i in range(len(table.rows)):
        cells = [_tex(table.text(i, j)) for j in range(len(table.columns))]
        marked = [rf"\textbf{{{c}}}" if (i, j) in best else c for j, c in enumerate(cells)]
        lines.append("    " + " & ".join(marked) + r" \\")
    lines += [r"    \bottomrule", r"  \end{tabular}"]
    lines += [rf"  \\[2pt] {{\footnotesize {_tex(note)}}}" for note in table.notes]
    return "\n".join([*lines, r"\end{table}"]) + "\n"


def comma_separated(table: Table) -> str:
    """CSV (RFC 4180) with full precision; an unknown value is an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([column.heading for column in table.columns])
    for row in table.rows:
        writer.writerow(["" if value is None else value for value in row])
    return out.getvalue()


def terminal(table: Table, width: int = 100) -> object:
    """A rich table of at most `width` characters, best values in bold green; where it is too wide, spreads
    and spare columns go, the last ones first.
    """
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table as RichTable

    best = table.best()
    texts = [[table.text(i, j) for j in range(len(table.columns))] for i in range(len(table.rows))]
    heads = [(column.short or column.heading).strip() for column in table.columns]
    numeric = [any(isinstance(row[j], (int, float)) for row in table.rows) for j in range(len(heads))]
    least = [_least_width(heads[j], [row[j] for row in texts], wrap=not numeric[j]) for j in range(len(heads))]
    shown = list(range(len(heads)))
    for j in range(len(heads) - 1, 0, -1):
        if sum(least[k] + 2 for k in shown) + 2 <= width:
            break
        if heads[j] in ("std", "±") or table.columns[j].spare:
            shown.remove(j)
    left_out = list(dict.fromkeys(heads[j] for j in range(len(heads)) if j not in shown))
    narrow = f"The terminal is too narrow for: {', '.join(left_out)}; --format md has them."
    notes = [*table.notes, *([narrow] if left_out else [])]
    out = RichTable(title=escape(table.title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    out.caption = "\n".join(escape(note) for note in notes) or None
    out.caption_justify = "left"
    full = [max(len(heads[j]), *(len(row[j]) for row in texts), 1) for j in range(len(heads))]
    widths = _shared_out({j: least[j] for j in shown}, full, width - 2 - 2 * len(shown))
    for j in shown:
        out.add_column(escape(heads[j]), justify="right" if numeric[j] else "left", width=widths[j], overflow="fold")
    for i, row in enumerate(texts):
        out.add_row(*(f"[bold green]{escape(row[j])}[/]" if (i, j) in best else escape(row[j]) for j in shown))
    return out


def _shared_out(least: dict[int, int], full: list[int], room: int) -> dict[int, int]:
    """Column widths between least and full: what room is left goes where least is missing first."""
    widths = dict(least)
    left = room - sum(widths.values())
    for j in sorted(widths, key=lambda j: full[j] - widths[j]):
        more = max(0, min(full[j] - widths[j], left))
        widths[j] += more
        left -= more
    return widths


def _least_width(heading: str, cells: list[str], *, wrap: bool) -> int:
    """The narrowest a column may be: its longest word, at most 16; numbers are never broken."""
    words = [word for text in ([heading, *cells] if wrap else [heading]) for word in text.split()]
    longest = min(16, max((len(word) for word in words), default=1))
    return longest if wrap else max(longest, *(len(cell) for cell in cells), 1)


def _md(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")


_TEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    UNKNOWN: "--",
    "±": r"$\pm$",
    "×": r"$\times$",
}


def _tex(text: str) -> str:
    return "".join(_TEX.get(c, c) for c in text)

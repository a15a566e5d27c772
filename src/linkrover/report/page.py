"""The HTML page: one file, everything inside it, nothing fetched."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from typing import Any

Figure = dict[str, Any]


@dataclass(frozen=True)
class Table:
    """A table of the page. `best` holds (row, column) of cells set in bold; text columns are set left."""

    name: str
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]] = frozenset()
    text_columns: frozenset[int] = frozenset({0})


@dataclass
class Page:
    """Collects sections and figures, then gives the whole document."""

    title: str
    _body: list[str] = field(default_factory=list)
    _nav: list[tuple[str, str]] = field(default_factory=list)
    _figures: dict[str, Figure] = field(default_factory=dict)
    _open: bool = False

    def section(self, anchor: str, heading: str) -> None:
        """Begin a section; it appears in the page's navigation."""
        self.end()
        self._nav.append((anchor, heading))
        self._body.append(f'<section id="{escape(anchor, quote=True)}"><h2>{escape(heading)}</h2>')
        self._open = True

    def end(self) -> None:
        """End the section that is open."""
        if self._open:
            self._body.append("</section>")
            self._open = False

    def heading(self, text: str) -> None:
        """A heading within the section."""
        self._body.append(f"<h3>{escape(text)}</h3>")

    def words(self, sentences: Iterable[str], *, lead: bool = False) -> None:
        """A paragraph."""
        self._body.append(f"<p{' class=lead' if lead else ''}>{escape(' '.join(sentences))}</p>")

    def bullets(self, sentences: Sequence[str]) -> None:
        """A list of sentences; nothing where it is empty."""
        if sentences:
            self._body.append("<ul class=words>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>")

    def warning(self, sentences: Sequence[str]) -> None:
        """What a reader must know before trusting what follows."""
        if sentences:
            self._body.append("<div class=warn>" + "".join(f"<p>{escape(s)}</p>" for s in sentences) + "</div>")

    def badges(self, texts: Iterable[str]) -> None:
        """Small labels: simulated, emulated, imported, ..."""
        self._body.append("<p>" + " ".join(f"<span class=badge>{escape(t)}</span>" for t in texts) + "</p>")

    def cards(self, figures: Iterable[tuple[str, str]]) -> None:
        """(value with unit, what it is) as large figures."""
        cells = "".join(f"<div class=card><b>{escape(v)}</b><span>{escape(w)}</span></div>" for v, w in figures)
        self._body.append(f"<div class=cards>{cells}</div>")

    def figure(self, name: str, figure: Figure | None, what: str) -> None:
        """An interactive figure; `what` is read out to those who cannot see it. Nothing where figure is None."""
        if figure is None:
            return
        self._figures[name] = figure
        height = int(figure["layout"].get("height", 400))
        self._body.append(
            f'<div class=figure id="{escape(name, quote=True)}" style="min-height:{height}px" role="img" '
            f'aria-label="{escape(what, quote=True)}"></div>'
        )

    def table(self, table: Table) -> None:
        """A table with a button that takes it along as CSV."""
        self._body.append(f"<div class=scroll>{_table_html(table)}</div>")
        self._body.append(f'<button class=csv data-table="{escape(table.name, quote=True)}">table as CSV</button>')

    def fold(self, title: str, table: Table) -> None:
        """A table behind a heading that opens it."""
        self._body.append(f"<details><summary>{escape(title)}</summary><div class=scroll>{_table_html(table)}</div>")
        self._body.append("</details>")

    def html(self, footer: str) -> str:
        """The whole document."""
        self.end()
        from plotly.offline import get_plotlyjs

        assets = resources.files("linkrover.report") / "assets"
        css = (assets / "page.css").read_text(encoding="utf-8")
        script = (assets / "page.js").read_text(encoding="utf-8")
        nav = "".join(f'<a href="#{escape(a, quote=True)}">{escape(h)}</a>' for a, h in self._nav)
        # "</" would end the script element that carries the data
        data = json.dumps(self._figures, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
        return (
            "<!doctype html>\n"
            '<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            '<link rel="icon" href="data:,">'
            f"<title>{escape(self.title)}</title><style>{css}</style></head><body>"
            f"<header><h1>{escape(self.title)}</h1><nav>{nav}</nav></header><main>{''.join(self._body)}</main>"
            f"<footer><p>{escape(footer)}</p></footer>"
            f'<script type="application/json" id="figures">{data}</script>'
            f"<script>{get_plotlyjs()}</script><script>{script}</script></body></html>\n"
        )


def _table_html(table: Table) -> str:
    def cell(row: int, column: int, text: str) -> str:
        names = [n for n, on in (("best", (row, column) in table.best), ("text", column in table.text_columns)) if on]
        return f'<td class="{" ".join(names)}">{escape(text)}</td>' if names else f"<td>{escape(text)}</td>"

    head = "".join(
        f'<th scope="col"{" class=text" if i in table.text_columns else ""}>{escape(h)}</th>'
        for i, h in enumerate(table.head)
    )
    rows = "".join(
        "<tr>" + "".join(cell(r, c, text) for c, text in enumerate(row)) + "</tr>" for r, row in enumerate(table.rows)
    )
    return (
        f'<table id="{escape(table.name, quote=True)}"><caption><span>{escape(table.caption)}</span></caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    )

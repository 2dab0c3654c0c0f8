"""One self-contained page for a result: text, tables and pictures in one file that opens without a network."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id import __version__
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.reporting.provenance import program
from hybrid_id.reporting.style import png
from hybrid_id.reporting.tables import findings_list, records_table

_LOADER = PackageLoader("hybrid_id.reporting", ".")
_TEMPLATES = Environment(loader=_LOADER, autoescape=True, trim_blocks=True, lstrip_blocks=True)
Cell = tuple[str, str]
"""A cell of a table as it is printed, and its CSS classes."""


@dataclass(frozen=True)
class Block:
    """One thing on the page, by ``kind``: text, links, table, code or picture."""

    kind: str
    text: str = ""
    style: str = ""
    heads: tuple[Cell, ...] = ()
    rows: tuple[tuple[Cell, ...], ...] = ()
    source: str = ""


@dataclass
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: list[Block] = field(default_factory=list)
    on_screen: list[RenderableType] = field(default_factory=list)

    def add(self, *things: RenderableType) -> Section:
        """Append what the terminal shows, too; see :meth:`note`."""
        self.on_screen += [Text(thing) if isinstance(thing, str) else thing for thing in things]
        return self.note(*things)

    def note(self, *things: RenderableType) -> Section:
        """Append text, rich tables, and groups of them to the page alone; brackets in words are no markup."""
        for thing in things:
            if isinstance(thing, Group):
                self.note(*thing.renderables)
            elif isinstance(thing, Table):
                self.blocks.append(_table(thing))
            else:
                self.blocks.append(Block("text", str(thing), _style(thing)))
        return self

    def links(self, text: str, places: Mapping[str, str]) -> Section:
        """Append a line that leads to other pages, by what each is called."""
        self.blocks.append(
            Block("links", text, rows=tuple(((name, place),) for name, place in places.items()))
        )
        return self

    def code(self, text: str, caption: str) -> Section:
        """Append a text as it stands in a file, folded under its caption."""
        self.blocks.append(Block("code", caption, source=text))
        return self

    def figure(self, image: np.ndarray, caption: str) -> Section:
        """Append an image, (H, W, 3) uint8, with its caption, which also serves readers who cannot see it."""
        data = base64.b64encode(png(image)).decode("ascii")
        self.blocks.append(Block("picture", caption, source=f"data:image/png;base64,{data}"))
        return self


@dataclass
class Page:
    """A result as one HTML file.

    Attributes:
        title: what it is a result of.
        lead: the outcome in a sentence or two.
        sections: in the order of the page; their titles make its table of contents.
    """

    title: str
    lead: str = ""
    sections: list[Section] = field(default_factory=list)

    def section(self, title: str) -> Section:
        """Append an empty section and return it."""
        self.sections.append(Section(title))
        return self.sections[-1]

    def screen(self) -> Group:
        """What the terminal shows of it: the outcome, and what was added to the sections but for mere notes."""
        parts = (part for section in self.sections for part in section.on_screen)
        return Group(Text(self.lead, style="bold"), *parts)

    def html(self) -> str:
        """The page as text; everything that came from the user is escaped."""
        return _TEMPLATES.get_template("page.html.j2").render(page=self, version=__version__)

    def write(self, path: Path) -> None:
        """Write the page."""
        path.write_text(self.html(), encoding="utf-8")


def _table(table: Table) -> Block:
    numbers = ["number" if column.justify == "right" else "" for column in table.columns]
    heads = tuple((str(c.header), number) for c, number in zip(table.columns, numbers, strict=True))
    rows = tuple(
        tuple(
            (str(cell), f"{number} {_style(cell)}".strip()) for cell, number in zip(row, numbers, strict=True)
        )
        for row in zip(*(column.cells for column in table.columns), strict=True)
    )
    return Block("table", str(table.title or ""), heads=heads, rows=rows)


def _style(thing: object) -> str:
    """Colour words of a rich text as one CSS class."""
    if not isinstance(thing, Text):
        return ""
    words = [str(thing.style), *(str(span.style) for span in thing.spans)]
    return next((colour for colour in ("red", "yellow", "green") for word in words if colour in word), "")


def records_section(page: Page, dataset: Dataset, findings: Sequence[Finding] = ()) -> Section:
    """Append which records there are, and what the check of them remarked where it did; return the section."""
    return page.section("Records").note(
        records_table(dataset), *([findings_list(findings)] if findings else [])
    )


PACKAGES = ("torch", "torchdiffeq", "numpy", "scipy", "pandas")


def how_made(
    page: Page,
    command: str,
    config: str = "",
    settings: Mapping[str, object] | None = None,
    *,
    words: str = "the whole study file, config.yaml",
) -> Page:
    """Append what repeats the run: program, versions, seed, and the whole study file.

    Args:
        page: the page.
        command: name of the command.
        config: text of the study file, defaults included.
        settings: what else decides the result, the seed say.
        words: what the text is, where it is not the study file.
    """
    table = Table("what", "value")
    table.add_row("program", f"{program()}, command {command}")
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    table.add_row("versions", f"Python {platform.python_version()}, {versions}")
    for name, value in (settings or {}).items():
        table.add_row(name, str(value))
    section = page.section("How it was made").note(table)
    if config:
        section.code(config, words)
    return page

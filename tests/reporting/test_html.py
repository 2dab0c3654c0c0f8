"""The page: what the terminal says, complete, escaped, in one file that fetches nothing."""

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from browser import look_at
from rich.console import Group
from rich.table import Table
from rich.text import Text

from hybrid_id.reporting.page import Page, how_made
from hybrid_id.reporting.provenance import program

VOID = {"meta", "img", "br", "link"}


class Balanced(HTMLParser):
    """Fails where a tag is closed that was not the last to be opened."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page() -> Page:
    table = Table()
    table.add_column("parameter")
    table.add_column("value", justify="right")
    table.add_row("J <b>", Text("2e-05", style="red"))
    made = Page("Identification of <arm>", "One set & its page.")
    made.section("Parameters").add(Group(table, Text("at a bound: F_c", style="yellow")), "plain words")
    made.section("Pictures").figure(np.zeros((4, 6, 3), dtype=np.uint8), "nothing to see")
    return how_made(made, "identify", "seed: 0\nname: <b>", {"seed": 0})


def test_page_is_well_formed_and_escaped() -> None:
    text = page().html()
    parser = Balanced()
    parser.feed(text)
    assert parser.open == []
    assert "J &lt;b&gt;" in text
    assert "Identification of &lt;arm&gt;" in text
    assert "One set &amp; its page." in text


def test_words_in_brackets_are_words() -> None:
    words = "joint [/x] takes the goal [rad]."
    made = Page("A run")
    made.section("Left out").add(words, Group(words))
    assert made.html().count(words) == 2


def test_page_fetches_nothing() -> None:
    links = re.findall(r'(?:src|href)="([^"]*)"', page().html())
    assert links
    assert all(link.startswith(("#", "data:")) for link in links)


def test_page_says_how_it_was_made() -> None:
    text = page().html()
    assert f"{program()}, command identify" in text
    assert "<pre>seed: 0\nname: &lt;b&gt;</pre>" in text


def test_page_is_shown_by_a_browser(tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(page().html(), encoding="utf-8")
    look_at(file, tmp_path, figures=1)

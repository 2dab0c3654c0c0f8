"""How a result was made, at the foot of its page."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version

from rich.table import Table

from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.provenance import program

PACKAGES = ("torch", "torchdiffeq", "numpy", "scipy", "pandas")


def how_made(
    page: Page,
    command: str,
    config: str = "",
    facts: Mapping[str, object] | None = None,
    *,
    words: str = "the whole study file, config.yaml",
) -> Page:
    """Append what repeats the run: program, versions, seed, and the whole study file.

    Args:
        page: the page.
        command: name of the command.
        config: text of the study file, defaults included.
        facts: what else decides the result, the seed say.
        words: what the text is, where it is not the study file.
    """
    table = Table("what", "value")
    table.add_row("program", f"{program()}, command {command}")
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    table.add_row("versions", f"Python {platform.python_version()}, {versions}")
    for name, value in (facts or {}).items():
        table.add_row(name, str(value))
    section = page.section("How it was made").add(table)
    if config:
        section.code(config, words)
    return page

"""The command line with the modules of all its commands imported, and what a screen shows, for tests."""

from typing import Any

import typer
from rich.console import Console

from hybrid_id.cli.app import app


def whole() -> Any:
    group: Any = typer.main.get_command(app)
    for name in group.commands:
        group.get_command(None, name)
    return group


def text_of(part: object, width: int = 200) -> str:
    """What a terminal without colours prints."""
    console = Console(width=width, no_color=True, highlight=False)
    with console.capture() as captured:
        console.print(part)
    return captured.get()

"""The command line with the modules of all its commands imported, for tests that walk through them."""

from typing import Any

import typer

from hybrid_id.cli.app import app


def whole() -> Any:
    group: Any = typer.main.get_command(app)
    for name in group.commands:
        group.get_command(None, name)
    return group

"""`schema`: what a settings file may hold, as a JSON schema for editors."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hybrid_id.cli.console import remark, show
from hybrid_id.cli.folder import files_to_write, write_files
from hybrid_id.cli.options import ABOVE, ForceFilesOption

if TYPE_CHECKING:
    from pydantic import BaseModel


def schema(
    kind: Annotated[
        Literal["dataset", "model", "study", "motor"],
        typer.Argument(help="Kind of file: dataset.yaml, model.yaml, a study file, a motor's data sheet."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=f"File to write; the screen by default. {ABOVE}"),
    ] = None,
    force: ForceFilesOption = False,
) -> None:
    """Write the JSON schema of a settings file, for editors: they complete keys, say what they mean and mark faults.

    VS Code (with its YAML extension), Neovim, Helix and others read it where the file's first line names it.
    """
    text = schema_text(kind)
    if out is None:
        show(text)
        return
    files_to_write(out, force=force)
    write_files({out: f"{text}\n"})
    remark(f"first line of a file beside it: {schema_line(out.name)}")


def schema_text(kind: str) -> str:
    """The JSON schema of a kind of file."""
    import json

    from hybrid_id.records.yaml_file import editor_schema

    return json.dumps(editor_schema(model_of(kind)), indent=1, ensure_ascii=False)


def model_of(kind: str) -> "type[BaseModel]":
    """The pydantic model of a kind of file."""
    if kind == "model":
        import hybrid_id.components  # noqa: F401  # registers its kinds
    module, name = MODELS[kind]
    return getattr(import_module(module), name)


def schema_line(path: str) -> str:
    """The comment that turns a schema on in an editor."""
    return f"# yaml-language-server: $schema={path}"


MODELS = {
    "dataset": ("hybrid_id.records.schema", "DatasetFile"),
    "model": ("hybrid_id.systems.model_schema", "ModelFile"),
    "study": ("hybrid_id.config", "StudyConfig"),
    "motor": ("hybrid_id.records.proposal_parts", "MotorSheet"),
}
"""Module and class of each kind of file, imported where it is asked for."""

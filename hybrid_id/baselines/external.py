"""Another program as a baseline: it gets a folder with one case, and a file to write its answer to."""

from __future__ import annotations

import hashlib
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, StrictBool, ValidationError

from hybrid_id.errors import InputError

CASE, ANSWER = "{case}", "{answer}"
LONGEST = 3600.0
"""Time [s] that a program may take for a case."""
Error = Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None
Share = Annotated[float, Field(allow_inf_nan=False)]


class _Effect(BaseModel):
    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    where: str = Field(pattern=r"^[^/\s]+/[a-z_]+$")
    probability: float = Field(ge=0.0, le=1.0)
    selected: StrictBool


class _Gap(BaseModel):
    nominal: Error = None
    refit: Error = None
    with_effect: Error = None
    shrink: Share | None = None
    shrink_interval: tuple[Share, Share] | None = None


class _Location(BaseModel):
    joint: str | None = Field(default=None, pattern=r"^[^/\s]+$")
    side: Literal["motor", "load", None] = None


class _Answer(BaseModel):
    unknown: StrictBool
    unknown_location: _Location | None = None
    effects: list[_Effect]
    gap: _Gap = Field(default_factory=_Gap)
    verdict: Literal["effects", "parameters_only", "no_gap", "outside_catalogue", "inconclusive", None] = None


def words_of(command: str | None) -> list[str]:
    """A command line in words; no shell ever sees it.

    Raises:
        InputError: it does not say where case and answer go.
    """
    if command is None or CASE not in command or ANSWER not in command:
        raise InputError(f"an external program needs --command with {CASE} and {ANSWER} in it")
    try:
        return shlex.split(command)
    except ValueError as error:
        raise InputError(f"--command {command} cannot be read ({error}); correct its quotes") from None


def digest_of(command: str) -> str:
    """Hash of the files that a command names, the program's own among them: a changed program is another method."""
    found = hashlib.sha256()
    for word in words_of(command):
        file = Path(shutil.which(word) or word)
        if file.is_file():
            found.update(file.read_bytes())
    return found.hexdigest()


def external(folder: Path, command: str | None) -> dict[str, Any]:
    """The answer of a program to a case, in the form of ``diagnosis.json`` (at least ``effects`` and ``unknown``).

    The program runs in the folder that the user is in, so that relative paths in the command mean what they say, and
    for an hour at most. What it says of errors is its own claim: nothing here simulates its model.

    Args:
        folder: the case, in a folder of its own.
        command: with ``{case}`` for the folder and ``{answer}`` for the file.

    Raises:
        InputError: it failed, or its answer cannot be read.
    """
    file = folder.parent / "answer.json"
    words = [w.replace(CASE, str(folder)).replace(ANSWER, str(file)) for w in words_of(command)]
    try:
        done = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=LONGEST
        )
    except OSError as error:
        raise InputError(f"{words[0]} cannot be started ({error.strerror})") from None
    except subprocess.TimeoutExpired:
        raise InputError(f"{words[0]} was ended after {LONGEST:.0f} s without an answer") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{words[0]} ended with exit code {done.returncode}: {last}")
    try:
        said = _Answer.model_validate_json(file.read_bytes()).model_dump()
    except OSError as error:
        raise InputError(f"{words[0]} has written no answer that can be read ({error.strerror})") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        key = ".".join(map(str, first["loc"])) or "it"
        raise InputError(f"the answer of {words[0]} cannot be taken: {key}: {first['msg']}") from None
    names = [(e["name"], e["where"]) for e in said["effects"]]
    if len(set(names)) < len(names) or {"unknown", "none", "broken"} & {name for name, _ in names}:
        raise InputError(f"the answer of {words[0]} names an effect twice, or one that is none")
    found = "effects" if any(e["selected"] for e in said["effects"]) else "no_gap"
    verdict = said["verdict"] or ("outside_catalogue" if said["unknown"] else found)
    return said | {"verdict": verdict}

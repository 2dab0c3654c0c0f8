"""Another program as a contender: it gets a folder with one case, and a file to write its answer to."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hybrid_id.errors import InputError

CASE, ANSWER = "{case}", "{answer}"


def words_of(command: str | None) -> list[str]:
    """A command line in words; no shell ever sees it.

    Raises:
        InputError: it does not say where case and answer go.
    """
    if command is None or CASE not in command or ANSWER not in command:
        raise InputError(f"an external contender needs --command with {CASE} and {ANSWER} in it")
    try:
        return shlex.split(command)
    except ValueError as error:
        raise InputError(f"--command {command} cannot be read ({error}); correct its quotes") from None


def refuse_missing(program: str) -> None:
    """Refuse a program that this machine does not have, before any case is taken."""
    if shutil.which(program) is None:
        raise InputError(f"--command: {program} is not a program that can be run from here; give its path")


def external(folder: Path, command: str | None) -> dict[str, Any]:
    """The answer of a program to a case, in the form of ``diagnosis.json`` (at least ``effects`` and ``unknown``).

    The program runs in the folder that the user is in, so that relative paths in the command mean what they say.

    Args:
        folder: the case, in a folder of its own.
        command: with ``{case}`` for the folder and ``{answer}`` for the file.

    Raises:
        InputError: it failed, or its answer cannot be read.
    """
    file = folder.parent / "answer.json"
    words = [w.replace(CASE, str(folder)).replace(ANSWER, str(file)) for w in words_of(command)]
    try:
        done = subprocess.run(words, capture_output=True, text=True)
    except OSError as error:
        raise InputError(f"{words[0]} cannot be started ({error.strerror})") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{words[0]} ended with exit code {done.returncode}: {last}")
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        for effect in said["effects"]:
            effect["probability"] = float(effect["probability"])
            effect["selected"] = bool(effect["selected"])
            effect["name"], effect["where"] = str(effect["name"]), str(effect["where"])
            if not 0.0 <= effect["probability"] <= 1.0:
                raise ValueError(f"probability {effect['probability']} is none")
        said["unknown"] = bool(said["unknown"])
        gap = said.get("gap") or {}
        for key in ("refit", "with_effect", "shrink"):
            gap[key] = None if gap.get(key) is None else float(gap[key])
        if gap.get("shrink_interval") is not None:
            low, high = gap["shrink_interval"]
            gap["shrink_interval"] = [float(low), float(high)]
        said["gap"] = gap
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the answer of {words[0]} cannot be read ({type(error).__name__}: {error})"
        ) from None
    return {"verdict": "outside_catalogue" if said["unknown"] else "effects"} | said

"""What runs leave behind: a folder for each method, in it a diagnosis for each case, whole or not there."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_id.baselines.run import Case, Settings
from hybrid_id.errors import InputError
from hybrid_id.reading import read_object
from hybrid_id.records.files import make_folder, write_json
from hybrid_id.records.manifest import check_manifest

RUN, DIAGNOSIS = "run.json", "diagnosis.json"


def key_of(case: Case, settings: Settings, version: str, commit: str) -> str:
    """Digest of all that decides an answer: records, model, method, program."""
    return hashlib.sha256(repr((case.digest, settings, version, commit)).encode()).hexdigest()


def begin(folder: Path, about: Mapping[str, Any]) -> None:
    """Write down what a run is about, with the hash of the answers that it does not see, before its first case.

    Args:
        folder: of the method.
        about: at least ``method`` and ``cases`` (the manifest).

    Raises:
        InputError: the folder holds a run of other cases or settings, or cannot be made.
    """
    kept = read_run(folder) if (folder / RUN).exists() else about
    for name in ("method", "cases", "command"):
        mended = name == "command" and not any(folder.glob(f"*/{DIAGNOSIS}"))
        if kept.get(name) != about.get(name) and not mended:
            raise InputError(f"{folder} holds a run with other {name.replace('_', ' ')}; give another folder")
    write_json(make_folder(folder) / RUN, about)


def read_run(folder: Path) -> dict[str, Any]:
    """What a run was about.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    try:
        about = read_object(folder / RUN, "run of cases")
    except OSError:
        raise InputError(f"{folder} holds no run; 'hybrid-id blind run' makes one") from None
    check_manifest(about.get("cases"), folder / RUN)
    if not isinstance(about.get("method"), str):
        raise InputError(f"{folder / RUN} does not say which method it was; run it again")
    return about


def save(folder: Path, said: Mapping[str, Any], key: str) -> None:
    """Keep an answer as ``NAME/diagnosis.json``, with the key of what it was made from."""
    place = folder / str(said["case"])
    place.mkdir(exist_ok=True)
    write_json(place / DIAGNOSIS, {**said, "run": {**said["run"], "key": key}})


def load(folder: Path, name: str) -> dict[str, Any] | None:
    """The answer to a case, None where there is none that can be read."""
    try:
        content = read_object(folder / name / DIAGNOSIS, "diagnosis")
        return content if isinstance(content.get("run"), dict) else None
    except (OSError, InputError):
        return None


def is_done(said: Mapping[str, Any] | None, key: str) -> bool:
    """Whether an answer was made from the same, and did not break."""
    return said is not None and said["run"].get("key") == key and not said["run"].get("message")

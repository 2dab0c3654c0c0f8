"""What a folder of withheld cases says of itself, and the files of runs that repeat it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_id.errors import InputError
from hybrid_id.reading import PLAIN_NAME

_SHA256 = re.compile(r"[0-9a-f]{64}")


def check_manifest(manifest: Any, source: Path) -> Mapping[str, Any]:
    """A manifest whose names are those of folders beside it, and which gives the hash of the answers.

    Args:
        manifest: as it was read.
        source: its file, for the message.

    Raises:
        InputError: it is none; a name that would lead elsewhere is refused, too.
    """
    answers = manifest.get("answers") if isinstance(manifest, dict) else None
    sha256 = answers.get("sha256") if isinstance(answers, dict) else None
    if not isinstance(sha256, str) or not _SHA256.fullmatch(sha256):
        raise InputError(f"{source} does not give the hash of the answers; make the cases anew")
    names = manifest.get("names", [])
    if not isinstance(names, list) or not all(
        isinstance(name, str) and PLAIN_NAME.fullmatch(name) for name in names
    ):
        raise InputError(f"{source}: key 'names' is no list of names of cases; make the cases anew")
    return manifest

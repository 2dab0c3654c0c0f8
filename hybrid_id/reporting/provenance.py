"""Which commit of this program is running."""

import functools
import subprocess
from pathlib import Path

from hybrid_id import __version__

UNKNOWN = "unknown"


def commit() -> str:
    """The commit's hash, `-dirty` behind it where files were changed since; `unknown` outside of a checkout."""
    found = _git("rev-parse", "HEAD")
    if found is None:
        return UNKNOWN
    return f"{found}-dirty" if _git("status", "--porcelain", "--untracked-files=no") else found


@functools.cache
def program() -> str:
    """Version and commit: what was computed by another program is computed again."""
    return f"hybrid_id {__version__}, {commit()}"


def _git(*words: str) -> str | None:
    home = Path(__file__).resolve().parents[2]
    if not (home / ".git").exists():
        return None
    try:
        run = subprocess.run(["git", *words], cwd=home, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return run.stdout.strip()

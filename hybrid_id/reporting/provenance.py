"""Which commit of this program is running."""

import functools
import hashlib
import subprocess
from pathlib import Path

from hybrid_id import __version__

UNKNOWN, DIRTY = "unknown", "-dirty"


def commit() -> str:
    """The commit's hash; `-dirty` and a hash of the changes behind it where files were changed since.

    `unknown` outside of a checkout.
    """
    found = _git("rev-parse", "HEAD")
    if found is None:
        return UNKNOWN
    changes = _git("diff", "HEAD")
    return f"{found}{DIRTY}.{hashlib.sha256(changes.encode()).hexdigest()[:8]}" if changes else found


def short(commit: str) -> str:
    """The first digits of a commit's hash, and whether files had been changed since."""
    head, dirty, _ = commit.partition(DIRTY)
    return head[:7] + dirty


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

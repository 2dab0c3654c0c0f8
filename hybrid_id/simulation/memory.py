"""How freed memory is kept for the next use."""

from __future__ import annotations

import ctypes
import functools

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's settings, see mallopt(3)."""
KEPT = 256 << 20
LARGEST = 32 << 20


@functools.cache
def keep_freed_memory() -> bool:
    """Let the C library keep up to 256 MB of freed blocks, where it has such a setting; whether it has.

    A fit frees and asks again for rows of a few hundred kB thousands of times. By default each goes back to the
    system, and fetching it anew, page by page, is a sixth of the fit's time.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc
        return False
    return bool(mallopt(M_TRIM_THRESHOLD, KEPT)) and bool(mallopt(M_MMAP_THRESHOLD, LARGEST))

"""Freed memory is kept, where the C library can be told so."""

import ctypes
import sys

from hybrid_id.simulation import memory


def test_glibc_accepts_the_settings() -> None:
    memory.keep_freed_memory.cache_clear()
    glibc = sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")
    assert memory.keep_freed_memory() == glibc

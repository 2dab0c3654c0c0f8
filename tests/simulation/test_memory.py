"""Freed memory is kept, where the C library can be told so."""

import ctypes
import sys

from hybrid_id.simulation import memory


def test_settings_are_made_once_and_refusal_is_no_error(monkeypatch) -> None:
    memory.keep_freed_memory.cache_clear()
    asked: list[tuple[int, int]] = []

    class Library:
        def mallopt(self, setting: int, value: int) -> int:
            asked.append((setting, value))
            return 1

    monkeypatch.setattr(ctypes, "CDLL", lambda _: Library())
    assert memory.keep_freed_memory() and memory.keep_freed_memory()
    assert asked == [(-1, memory.KEPT), (-3, memory.LARGEST)]
    memory.keep_freed_memory.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    assert not memory.keep_freed_memory()
    memory.keep_freed_memory.cache_clear()


def test_glibc_accepts_the_settings() -> None:
    memory.keep_freed_memory.cache_clear()
    glibc = sys.platform == "linux" and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")
    assert memory.keep_freed_memory() == glibc

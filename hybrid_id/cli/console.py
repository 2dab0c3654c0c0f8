"""Where the commands print: results to stdout, the course of things to stderr."""

import sys

from rich.console import Console, RenderableType

WIDTH = 120  # where the output goes into a file or a pipe


def out() -> Console:
    """Console for results."""
    return _console(stderr=False)


def err() -> Console:
    """Console for progress and remarks, so that stdout can be piped."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, emoji=False, width=None if stream.isatty() else WIDTH)


def show(*parts: RenderableType) -> None:
    """Print results; words in brackets are words and no markup."""
    console = out()
    for part in parts:
        console.print(part, markup=False, soft_wrap=isinstance(part, str))


def remark(sentence: str) -> None:
    """Say something beside the result."""
    err().print(sentence, markup=False, soft_wrap=True, style="dim")


def printable(words: str) -> str:
    """Words on one line: what a file or a program says may hold escape sequences, which a terminal obeys."""
    return "".join(c if c.isprintable() else "?" for c in words)

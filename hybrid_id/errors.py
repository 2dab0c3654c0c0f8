"""The error that is meant for the user, and words that such errors share."""

import difflib
import unicodedata
from collections.abc import Iterable

MOST_NAMES = 30
CONTROL = "holds a control character, or half of one that no file can hold"
"""Of words that :func:`has_control` finds fault with."""
REVERSING = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
"""Characters that turn the direction of writing, so that a name reads as another one."""
LONGEST_MESSAGE = 1200
"""Signs of a message; of a longer one the middle is left out, for the file comes first and the remedy last."""


class InputError(Exception):
    """Something that the user gave is wrong, and this says where and what to do.

    The message is one sentence that names the file, the row (1-based line of the file), the column or
    key, and the remedy. The command line prints it alone, without a traceback, and exits with code 2;
    any other exception is a fault of the program.

    Example:
        >>> raise InputError("my_robot/rec_00.csv, row 17: column u1 is empty; fill it or drop the row")
        Traceback (most recent call last):
        ...
        hybrid_id.errors.InputError: my_robot/rec_00.csv, row 17: column u1 is empty; fill it or drop the row
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(shortened(str(message), LONGEST_MESSAGE))


class MachineError(InputError):
    """What was given is right, but this machine fails at it: its compiler does, say. No try with other values helps."""


def has_control(words: str, *, lines: bool = False) -> bool:
    """Whether words hold what a terminal obeys (escape sequences, reversed writing), or half a character.

    Half a character (a lone surrogate) cannot be written as UTF-8: it ends a program when all work is done.

    Args:
        words: of a file or a command line.
        lines: whether they may have several lines.
    """
    allowed = "\n\r\t" if lines else ""
    return any(
        c not in allowed and (c in REVERSING or unicodedata.category(c) in ("Cc", "Cs")) for c in words
    )


def shown(words: str, *, lines: bool = False) -> str:
    """Words as a screen may show them: a question mark for each character that :func:`has_control` finds."""
    return "".join("?" if has_control(c, lines=lines) else c for c in words)


def shortened(words: str, most: int) -> str:
    """Words of so many signs at most, the middle of longer ones left out."""
    kept = max(most - 3, 0)
    return words if len(words) <= most else f"{words[: kept - kept // 3]}...{words[len(words) - kept // 3 :]}"


def close_match(name: str, known: Iterable[str]) -> str:
    """``" (did you mean 'speed'?)"``, or nothing where no known name is near."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def listed(names: Iterable[str]) -> str:
    """Names one after the other, the first thirty of many."""
    names = list(names)
    return ", ".join(names[:MOST_NAMES]) + (", ..." if len(names) > MOST_NAMES else "") or "none"

"""The recorded statements of a C function, and a long one as a row of shorter ones, which a compiler takes better."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

NAMES = re.compile(r"\b(?:[a-z]\d+|h)\b")
"""Variables in a recorded expression."""
ROWS = re.compile(r"\b([xupsdk]|fixed|side|margin|against|between|g\[\d+\])\[(\d+)\]")
"""Arrays of which every lane has its own."""
FUNCTION = re.compile(r"\b(?=[a-z]\w*\()")
"""Where the name of a function begins."""
BETWEEN = re.compile(r"\bbetween\[(\d+)\]")
WRITTEN = ("k", "side", "margin", "against", "between")
"""Arrays that a function writes, beside its gradients g."""


@dataclass(frozen=True)
class Body:
    """C statements of one function, for one lane.

    Attributes:
        parts: statements of each part; a value that a later one needs goes through the array ``between``.
        between: size of that array.
        gradients: of each row that has tangents, what its gradient consists of: places of ``g``, or numbers.
    """

    parts: list[list[str]]
    between: int
    gradients: dict[int, list[str]]


def in_parts(
    load: Sequence[str], statements: Sequence[str], stores: Mapping[str, Sequence[str]], length: int
) -> tuple[list[list[str]], int]:
    """Statements in parts, each of which reads what it needs, and the size of the array between them.

    Args:
        load: statements that read arrays; any part may repeat them.
        statements: the others, in their order, which stays.
        stores: by the name of a value, or a number, the statements that write it into arrays.
        length: statements of a part at most.
    """
    pieces = [list(statements[k : k + length]) for k in range(0, len(statements), length)] or [[]]
    made = {assigned(line): k for k, piece in enumerate(pieces) for line in piece}
    for value, lines in stores.items():
        pieces[made.get(value, 0)] += lines
    used = [{name for line in piece for name in NAMES.findall(line.partition(" = ")[2])} for piece in pieces]
    last = {name: k for k, names in enumerate(used) for name in names}
    kinds = {assigned(line): line.split(" = ")[0] for line in statements}
    place: dict[str, str] = {}
    idle: list[str] = []
    parts = []
    for k, piece in enumerate(pieces):
        needed = [name for name in place if name in used[k]]
        part = [line for line in load if assigned(line) in used[k]]
        part += [f"{kinds[name]} = {place[name]};" for name in needed] + piece
        idle += [place.pop(name) for name in list(place) if last[name] == k]
        for name in (name for name, where in made.items() if where == k and last.get(name, k) > k):
            place[name] = idle.pop() if idle else f"between[{len(place)}]"
            part.append(stored(kinds[name], name, place[name]))
        parts.append(part)
    return parts, 1 + max(
        (int(n) for part in parts for line in part for n in BETWEEN.findall(line)), default=-1
    )


def lanes(name: str, arrays: Sequence[str], body: Body) -> tuple[str, str]:
    """Functions for the parts of a body, and the body that calls them, for the lanes side by side."""
    texts = [f"    VECTORS {{\n{in_lanes(lines(part))}\n    }}" for part in body.parts]
    if len(texts) == 1:
        return "", texts[0]
    given = [*arrays, "between"]
    kinds = (f"{'double' if array in WRITTEN else 'const double'} (*{array})[W]" for array in given)
    declared = ", ".join(kinds).replace("const double (*g)[W]", "double (*g)[MC][W]")
    functions = [
        f"static __attribute__((noinline)) void {name}_{k}({declared})\n{{\n{text}\n}}\n"
        for k, text in enumerate(texts)
    ]
    calls = [f"{name}_{k}({', '.join(given)});" for k in range(len(texts))]
    return "\n".join(functions), lines([f"double between[{body.between}][W] ALIGNED;", *calls])


def in_lanes(body: str) -> str:
    """Statements of one lane as those of a vector of lanes, as equations.c.in has them."""
    body = FUNCTION.sub("v_", ROWS.sub(r"AT(\1[\2])", body))
    body = re.sub(r"const _Bool (\w+) = (AT\(.*\));", r"const M \1 = \2 != 0.0;", body)
    body = body.replace("const _Bool ", "const M ").replace("const double ", "const V ")
    return re.sub(r"^( *AT\(\S+\)) = (.*);$", r"\1 = ALL(\2);", body, flags=re.MULTILINE)


def stored(kind: str, name: str, place: str) -> str:
    """The statement that keeps a value in an array of numbers, a truth as 1 or 0."""
    return f"{place} = pick({name}, 1.0, 0.0);" if "_Bool" in kind else f"{place} = {name};"


def lines(statements: Sequence[str]) -> str:
    """Statements as the body of a function."""
    return "\n".join(f"    {line}" for line in statements)


def assigned(statement: str) -> str:
    """Name of the variable that a statement defines."""
    return statement.split(" = ", 1)[0].split()[-1]

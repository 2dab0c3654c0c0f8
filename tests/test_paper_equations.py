"""Each equation of the paper, (1) to (16), stands in exactly one class, and docs/paper.md says in which."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import hybrid_id

PACKAGE = Path(hybrid_id.__file__).parent
TABLE = PACKAGE.parent / "docs" / "paper.md"
# The twin, which is the truth, is written apart from the models on purpose.
MODULES = [path for path in PACKAGE.rglob("*.py") if path.relative_to(PACKAGE).parts[0] != "twin"]
HEAD = re.compile(r"Paper, eq\. ((?:\(\d+\)(?:, | and )?)+):")


def equations(source: str) -> Iterator[tuple[int, str]]:
    """Number and class of every equation that a class's docstring begins with."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef) and (head := HEAD.match(ast.get_docstring(node) or "")):
            yield from ((int(number), node.name) for number in re.findall(r"\d+", head[1]))


def test_each_equation_stands_in_exactly_one_class() -> None:
    found = [
        (number, name, path.relative_to(PACKAGE).as_posix())
        for path in MODULES
        for number, name in equations(path.read_text(encoding="utf-8"))
    ]
    assert sorted(number for number, _, _ in found) == list(range(1, 17))
    rows = re.findall(
        r"\| \((\d+)\) \| [^|]* \| `(\w+)` \| `([\w/.]+)` \|", TABLE.read_text(encoding="utf-8")
    )
    assert sorted(found) == [(int(number), name, file) for number, name, file in rows]

"""The generator of withheld cases shares no numbers with the diagnosis, nor with the laws' start values and ranges.

A grader knows nothing of the graded. Numbers are read off the syntax trees: named constants and defaults of fields,
tuples and lists of numbers, and the ends of ranges and distributions, of which a factor before a size counts. Names
of effects, places, units and physical constants may be the same.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import hybrid_id

PACKAGE = Path(hybrid_id.__file__).parent
RANGES = {"uniform", "log_uniform", "_log", "integers", "range", "geomspace", "linspace", "logspace", "clip"}
"""Calls whose numbers are the ends of a range."""
STARTS = "free"
"""Call whose second and third number are the ends of a range, after a start value."""
ROUND = {0.0, 0.001, 0.1, 0.25, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 30.0}
"""Round numbers, which two people choose alike: as a named constant they say nothing."""
PLAIN = {
    (0.0, 1.0),  # the unit interval
    (-1.0, 1.0),  # both directions
    (1.0, -1.0),
    (1.0, 2.0),  # two things counted
    (0.0, 2.0),
    (2.0, 3.0),
    (1.0, 1.0),
    (0.0, 0.0),
    (0.0, 1.0, 2.0),
}
"""Tuples and ranges that are no choice of anybody's."""
SAME_MEANING = {
    "LOST": "weight of an error that is no number, far above all others",
    "LEVEL": "level of all intervals, 95 %",
    "SAMPLE_TIME": "of the records: physics",
    "SETTLING_STEP": "a step of the integrator: physics",
    "DOMINANT": "definition of a dominant effect, stated to both sides",
    "COPPER": "temperature coefficient of copper [1/K]: physics",
    "WARM": "temperature coefficient of copper [1/K]: physics",
    "ADDS": "least share of the gap that a second dominant effect adds; the diagnosis' 0.11 is a difference of rivals",
    "TRIVIAL": "part of the definition of the calibration error, stated to both sides",
}
"""Named constants of the generator that tell nothing of a decision of the diagnosis."""
CLEAN_ONLY = {"LEAST", "SEEN", "PLAIN", "RIGHT", "WRONG", "CLOSE", "ENOUGH"}
"""Named constants of clean cases, whose published seeds have to stay as they are; messy machines have their own."""
OF_CLEAN = tuple(f"machines/{name}.py" for name in ("draw", "make", "score", "rivals"))
OTHER_QUANTITY = {
    (-0.3, 0.3): "angle of a tight spot or a latch [rad]",
    (0.02, 0.1): "damping ratio of a mounted mass",
    (0.03, 0.15): "damping ratio of a flexible joint",
    (0.05, 0.2): "length of a pulse of torque [s]",
    (0.1, 1.0): "load at the end of an arm [kg]",
    (0.5, 3.0): "mass of an arm's link [kg]; the law's is a shape exponent",
    (0.3, 1.0): "time of the first pulse of torque [s], share of the dry friction",
}
"""Ranges of clean machines that stand for something else in the diagnosis; messy machines spread shapes beyond them."""

Found = dict[tuple[str, tuple[float, ...]], str]


def number(node: ast.AST) -> float | None:
    """The value of a number as it is written, with its sign."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = number(node.operand)
        return None if value is None else -value
    if (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    ):
        return float(node.value)
    return None


def scaled(node: ast.AST) -> float | None:
    """A number, or the one before what it multiplies or is divided by: a range in units of a size."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        return number(node.left)
    return number(node)


def numbers(nodes: list[ast.expr]) -> tuple[float, ...]:
    """All of the nodes that are numbers; none where others are among them."""
    values = [number(node) for node in nodes]
    return () if None in values else tuple(v for v in values if v is not None)


def of_source(source: str, at: str) -> Iterator[tuple[str, tuple[float, ...], str]]:
    """Yield kind, values and place of every number that somebody chose."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        where = f"{at}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Tuple | ast.List) and len(node.elts) > 1 and (found := numbers(node.elts)):
            yield "several", found, where
        elif isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            args = node.args[1:3] if name == STARTS else node.args
            for read in (number, scaled):
                ends = tuple(v for v in map(read, args) if v is not None)[:2]
                if name in RANGES | {STARTS} and len(ends) == 2:
                    yield "several", ends, where
        elif isinstance(node, ast.AnnAssign):  # of a class: parameters of functions are no assignments
            if node.value is not None and (single := number(node.value)) is not None:
                yield "constant", (single,), where
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name | ast.Tuple):
            target, value = node.targets[0], node.value
            pairs: list[tuple[ast.expr, ast.expr]] = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=False))
            for one, own in pairs:
                name, single = one.id if isinstance(one, ast.Name) else "", number(own)
                if single is None or not name.isupper() or name in SAME_MEANING:
                    continue
                if not (at.endswith(OF_CLEAN) and name in CLEAN_ONLY):
                    yield "constant", (single,), where


def of_package(name: str) -> Found:
    """All chosen numbers of a package, and where each stands first."""
    found: Found = {}
    for path in sorted((PACKAGE / name).rglob("*.py")):
        for kind, values, at in of_source(path.read_text(encoding="utf-8"), str(path.relative_to(PACKAGE))):
            if values in PLAIN or values in OTHER_QUANTITY or (kind == "constant" and values[0] in ROUND):
                continue
            found.setdefault((kind, values if kind == "constant" else tuple(sorted(values))), at)
    return found


def shared(one: Found, other: Found) -> list[str]:
    """What stands in both."""
    return sorted(
        f"{values}: {one[kind, values]} and {other[kind, values]}"
        for kind, values in one.keys() & other.keys()
    )


@pytest.mark.parametrize("other", ["diagnosis", "components"])
def test_generator_shares_no_number(other: str) -> None:
    assert not shared(of_package("machines"), of_package(other))


def test_a_shared_number_would_be_seen() -> None:
    def found(source: str) -> Found:
        return {(kind, values): at for kind, values, at in of_source(source, "x")}

    assert shared(found("A = 0.37"), found("B = 0.37"))
    assert shared(found("x = rng.uniform(0.2, 0.9)"), found("RANGE = (0.2, 0.9)"))
    assert shared(found("x = size * log_uniform(0.2, 7)"), found("free(2.0 * size, 0.2 * size, 7 * size)"))
    assert shared(found("A = 0.37"), found("class Criteria:\n    level: float = 0.37"))
    assert not shared(found("A = 0.37"), found("A = 0.36"))

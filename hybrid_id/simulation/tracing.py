"""C statements of a function of rows: what PyTorch computes in every lane, gradients included, written down once.

The function runs once on example rows while every elementary operation is recorded as one assignment. Lanes do not
mix, so that the assignments hold for vectors of lanes as well as for one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from hybrid_id.errors import InputError

OPERATIONS: dict[str, str] = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "rsub": "{1} - {0}", "mul": "{0} * {1}", "div": "{0} / {1}",
    "neg": "-({0})", "reciprocal": "1.0 / {0}", "abs": "fabs({0})", "square": "{0} * {0}",
    "sqrt": "sqrt({0})", "rsqrt": "1.0 / sqrt({0})", "exp": "exp({0})", "expm1": "expm1({0})", "log": "log({0})",
    "log1p": "log1p({0})", "sin": "sin({0})", "cos": "cos({0})", "tan": "tan({0})", "atan": "atan({0})",
    "asinh": "asinh({0})", "tanh": "tanh({0})", "cosh": "cosh({0})", "sinh": "sinh({0})", "erf": "erf({0})",
    "sigmoid": "1.0 / (1.0 + exp(-{0}))",
    "sign": "pick({0} > 0.0, 1.0, 0.0) - pick({0} < 0.0, 1.0, 0.0)",
    "sgn": "pick({0} > 0.0, 1.0, 0.0) - pick({0} < 0.0, 1.0, 0.0)",
    "tanh_backward": "{0} * (1.0 - {1} * {1})", "sigmoid_backward": "{0} * {1} * (1.0 - {1})",
    "lerp": "{0} + {2} * ({1} - {0})", "pow": "pow({0}, {1})", "atan2": "atan2({0}, {1})",
    "maximum": "pick({0} > {1}, {0}, {1})", "minimum": "pick({0} < {1}, {0}, {1})",
    "clamp_min": "pick({0} > {1}, {0}, {1})", "clamp_max": "pick({0} < {1}, {0}, {1})",
    "where": "pick({0}, {1}, {2})", "masked_fill": "pick({1}, {2}, {0})",
    "threshold_backward": "pick({1} > {2}, {0}, 0.0)",
    "gt": "{0} > {1}", "ge": "{0} >= {1}", "lt": "{0} < {1}", "le": "{0} <= {1}", "eq": "{0} == {1}",
    "ne": "{0} != {1}",
    "logical_and": "{0} & {1}", "logical_or": "{0} | {1}", "logical_not": "{0} == 0",
    "bitwise_and": "{0} & {1}", "bitwise_or": "{0} | {1}", "bitwise_not": "{0} == 0",
    "zeros_like": "0.0", "new_zeros": "0.0", "ones_like": "1.0", "new_ones": "1.0", "fill": "{1}", "zero": "0.0",
    "scalar_tensor": "{0}", "full_like": "{1}", "full": "{0}", "new_full": "{1}",
    "detach": "{0}", "alias": "{0}", "clone": "{0}", "expand": "{0}", "view": "{0}", "_to_copy": "{0}", "copy": "{1}",
    "_unsafe_view": "{0}", "reshape": "{0}",
}  # fmt: skip
"""C expression of each operation of PyTorch's kernel language; {0}, {1} ... stand for its arguments. ``pick(c, a, b)``
is a where c holds, else b: of one lane and of several at once, for which C has no such operator."""
CONDITIONS = {("where", 0), ("masked_fill", 1)}
"""Arguments that are conditions, by operation and place."""
COMPARISONS = ("gt", "ge", "lt", "le", "eq", "ne")
FUNCTIONS = [name for name, code in OPERATIONS.items() if code == f"{name}({{0}})" and name != "sqrt"]
"""Functions of one argument that the C library may offer for whole vectors."""
DECLARED = "\n".join(
    f'__attribute__((simd("notinbranch"), const)) double {name}({"double, " * (name in ("pow", "atan2"))}double);'
    for name in (*FUNCTIONS, "pow", "atan2")
)
"""C declarations that say so."""
WRAPPED = "\n".join(
    [*(f"OF_ONE({name})" for name in (*FUNCTIONS, "sqrt")), *(f"OF_TWO({name})" for name in ("pow", "atan2"))]
)
"""The same of several lanes at once, by macros of equations.c.in."""

MIXED = "mixed"
"""Name of a value that belongs to no lane."""


class Recorder(TorchDispatchMode):
    """Writes down what happens to rows; arrays of one value that it has not met are constants.

    Args:
        rows: example rows, ``(B,)`` each.
        names: what they are called in C.

    Attributes:
        statements: the assignments so far.

    Raises:
        InputError: while recording, an operation that has no C expression.
    """

    def __init__(self, rows: Sequence[Tensor], names: Sequence[str]) -> None:
        super().__init__()
        self.statements: list[str] = []
        self._alive = list(rows)  # a freed row would lend its address to another
        self._names = {_address(row): name for row, name in zip(rows, names, strict=True)}
        self._known: dict[str, str] = {}

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # else PyTorch loads its own compiler, which takes seconds, to keep it away from here

    def name(self, row: Tensor) -> str:
        """C name or constant that holds a row."""
        found = self._names.get(_address(row))
        if found == MIXED:
            raise InputError("The model adds up lanes, which compiled steps cannot; leave 'compiled' off.")
        if found is not None:
            return found
        if row.numel() != 1:
            raise InputError(
                "The model computes with an array of its own, which compiled steps cannot; leave 'compiled' off."
            )
        return _literal(row.item())

    def _written(self, value: Any, truth: bool = False) -> str:
        """A value as a number, or as a truth."""
        if not isinstance(value, Tensor):
            return _literal(value)
        name = self.name(value)
        if _is_atom(name) and not name.isidentifier():
            return name
        if truth and value.dtype != torch.bool:
            return f"({name} != 0.0)"
        return name if truth or value.dtype != torch.bool else f"pick({name}, 1.0, 0.0)"

    def __torch_dispatch__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        key = name.rstrip("_")
        in_place = name.endswith("_") and not name.endswith("__")
        result = func(*args, **(kwargs or {}))
        if key.startswith("empty") or key.startswith("new_empty"):
            return self._keep(result, "0.0")
        if key == "sum" and result.ndim == 0:
            return self._keep(result, MIXED)  # where a gradient starts; nothing may come of its value
        if key not in (*OPERATIONS, "clamp") or not isinstance(result, Tensor):
            raise InputError(
                f"The model uses '{name}', which compiled steps do not know; leave 'compiled' off."
            )
        alpha = (kwargs or {}).get("alpha", 1)
        used = OPERATIONS.get(key, "{0}{1}{2}")
        # not a shape, a type or a switch
        values = enumerate(a for a in args if isinstance(a, Tensor | int | float) and not isinstance(a, bool))
        truth = result.dtype == torch.bool and key not in COMPARISONS
        given = [
            self._written(a, truth or (key, k) in CONDITIONS) if f"{{{k}}}" in used else "" for k, a in values
        ]
        if alpha != 1:
            given[1] = f"({_literal(alpha)} * {given[1]})"
        code = _expression(key, given, args)
        return self._keep(result if not in_place else args[0], _folded(key, given, code), result.dtype)

    def _keep(self, row: Tensor, code: str, dtype: torch.dtype = torch.float64) -> Tensor:
        if not _is_atom(code):
            kind = "_Bool" if dtype == torch.bool else "double"
            known = self._known.get(kind + code)
            if known is None:
                known = self._known[kind + code] = f"t{len(self.statements)}"
                self.statements.append(f"const {kind} {known} = {code};")
            code = known
        self._alive.append(row)
        self._names[_address(row)] = code
        return row


def record(
    function: Callable[..., Sequence[Tensor]], names: Sequence[str], examples: Sequence[float]
) -> tuple[list[str], list[str]]:
    """Record a function of rows.

    Args:
        function: takes one row for each name and returns rows.
        names: C names of its rows.
        examples: a value for each at which it can be evaluated.

    Returns:
        The assignments, and the C name or constant of each result.
    """
    rows = [torch.full((3,), value, dtype=torch.float64) for value in examples]
    with Recorder(rows, names) as recorder:
        results = function(*rows)
    return recorder.statements, [recorder.name(row) for row in results]


def _address(row: Tensor) -> int:
    return row.untyped_storage().data_ptr()


def _literal(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    text = repr(float(value)).replace("inf", "INFINITY")
    return f"({text})" if value < 0 else text


def _is_atom(code: str) -> bool:
    return (
        code.isidentifier()
        or code.strip("()").replace("e-", "").replace("e+", "").lstrip("-").replace(".", "").isdigit()
    )


def _expression(key: str, given: Sequence[str], args: Sequence[Any]) -> str:
    """C expression of an operation with the names ``given`` of its arguments ``args``."""
    if key == "pow":
        base, exponent = given
        powers = {
            "2.0": f"{base} * {base}",
            "1.0": base,
            "3.0": f"{base} * {base} * {base}",
            "0.5": f"sqrt({base})",
        }
        return powers.get(exponent, OPERATIONS[key].format(base, exponent))
    if key == "clamp":
        value, *limits = given
        below = args[1] is not None
        above = len(args) > 2 and args[2] is not None
        held = f"pick({value} > {limits[-1]}, {limits[-1]}, {value})" if above else value
        return f"pick({value} < {limits[0]}, {limits[0]}, {held})" if below else held
    return OPERATIONS[key].format(*given)


def _folded(key: str, given: Sequence[str], code: str) -> str:
    """The expression without terms that are nothing and factors that are one."""
    if key == "mul" and "0.0" in given:
        return "0.0"
    if key == "mul" and "1.0" in given:
        return given[1] if given[0] == "1.0" else given[0]
    if key == "add" and "0.0" in given:
        return given[1] if given[0] == "0.0" else given[0]
    if key in ("sub", "div") and given[1] == ("0.0" if key == "sub" else "1.0"):
        return given[0]
    if key == "neg" and given[0] == "0.0":
        return "0.0"
    if key.endswith("_and") and {"0.0", "1.0"} & {*given}:
        return "0.0" if "0.0" in given else given[given[0] == "1.0"]
    if key.endswith("_or") and {"0.0", "1.0"} & {*given}:
        return "1.0" if "1.0" in given else given[given[0] == "0.0"]
    if key.endswith("_not") and given[0] in ("0.0", "1.0"):
        return "1.0" if given[0] == "0.0" else "0.0"
    if key in ("where", "masked_fill"):
        truth, one, other = given if key == "where" else (*given[1:], given[0])
        if truth in ("0.0", "1.0"):
            return one if truth == "1.0" else other
    return code

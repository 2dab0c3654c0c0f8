"""Steps of many runs side by side, in C where there is a compiler.

A step is written in NumPy, once. To play it in C it is called a single time with `Term`s in place of signals, which
note what is done to them; C then goes through these notes for sixteen runs at a time, step after step. Without a
compiler NumPy makes the steps, which gives the same up to rounding.
"""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

OPERATIONS = {
    "add": "x + y",
    "subtract": "x - y",
    "multiply": "x * y",
    "divide": "x / y",
    "negative": "-x",
    "power": "pow(x, y)",
    "absolute": "fabs(x)",
    "sign": "x > 0 ? 1 : x < 0 ? -1 : x",
    "maximum": "x > y || x != x ? x : y",
    "minimum": "x < y || x != x ? x : y",
    "greater": "x > y",
    "less": "x < y",
    "bitwise_and": "x && y",
    "where": "x ? y : z",
    "floor": "floor(x)",
    "sin": "sin(x)",
    "cos": "cos(x)",
    "tanh": "tanh(x)",
    "exp": "exp(x)",
    "expm1": "expm1(x)",
    "at": "past[(x < 0 ? 0 : x < last ? (long long) x : last) * inputs * lanes + j]",
}
"""NumPy's functions of up to three signals x, y, z as C; `at` is input y at an earlier sample x."""

SOURCE = r"""
#include <math.h>
#include <string.h>
#define W 16 /* runs that go together */
typedef long long whole;

void play(whole first, whole samples, whole lanes, whole substeps, whole states, whole inputs, whole given, whole rows,
          whole notes, whole kept, whole last, double *start, const double *input, const double *times,
          const whole *note, const whole *after, double *trail)
{
    for (whole lane = 0; lane < lanes; lane += W) {
        double row[rows][W], next[states][W];
        for (whole i = 0; i < given; i++) memcpy(row[i], start + i * lanes + lane, sizeof *row);
        for (whole k = first * substeps; k < (first + samples) * substeps; k++) {
            const double *now = input + k / substeps * inputs * lanes + lane;
            for (whole i = 0; i < inputs; i++) memcpy(row[states + i], now + i * lanes, sizeof *row);
            for (int j = 0; j < W; j++) row[states + inputs][j] = times[k];
            for (const whole *n = note; n < note + 4 * notes; n += 4) {
                double *restrict out = row[given + (n - note) / 4];
                const double *a = row[n[1]], *b = row[n[2]], *c = row[n[3]];
                const double *past = input + (n[2] - states) * lanes + lane;
                switch (n[0]) {
CASES
                }
            }
            for (whole i = 0; i < states; i++) memcpy(next[i], row[after[i]], sizeof *row);
            memcpy(row, next, sizeof next);
            for (whole i = 0; i < kept; i++)
                memcpy(trail + ((k + 1) * kept + i) * lanes + lane, row[i], sizeof *row);
        }
        for (whole i = 0; i < states; i++) memcpy(start + i * lanes + lane, row[i], sizeof *row);
    }
}
"""
CASE = "case {}: for (int j = 0; j < W; j++) {{ double x = a[j], y = b[j], z = c[j]; out[j] = {}; }} break;"
FLAGS = ("-O3", "-march=native", "-std=gnu11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
TOGETHER = 16
"""Runs that C takes together."""

Place = tuple[Any, Any]
"""Where a state (B,) is kept: a list or an object's dictionary, and index or name there."""


@functools.cache
def library() -> ctypes.CDLL | None:
    """The compiled player; None where there is no compiler or its library may not be loaded."""
    compiler = next((name for name in ("gcc", "clang", "cc") if shutil.which(name)), None)
    if compiler is None:
        return None
    cases = "\n".join(CASE.format(i, value) for i, value in enumerate(OPERATIONS.values()))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        code, built = Path(folder) / "play.c", Path(folder) / "play.so"
        code.write_text(SOURCE.replace("CASES", cases), encoding="utf-8")
        call = [compiler, *FLAGS, "-shared", "-fPIC", str(code), "-o", str(built), "-lm"]
        try:
            subprocess.run(call, capture_output=True, check=True)
            return ctypes.CDLL(str(built))
        except (OSError, subprocess.CalledProcessError):
            return None


class Notes:
    """What a step does to its signals.

    Attributes:
        numbers: what is given beside states, inputs and time, each a number or (B,).
        lines: operation and up to three operands of each result; an operand is a `Term`.
    """

    def __init__(self) -> None:
        self.numbers: list[Any] = []
        self.lines: list[tuple[str, tuple[Term, ...]]] = []
        self._known: dict[Any, Term] = {}

    def add(self, operation: str, operands: Sequence[Any]) -> "Term":
        """Note a line, once."""
        terms = tuple(self.term(one) for one in operands)
        key = (operation, *((one.kind, one.number) for one in terms))
        if key not in self._known:
            self._known[key] = Term(self, "line", len(self.lines))
            self.lines.append((operation, terms))
        return self._known[key]

    def term(self, value: Any) -> "Term":
        """The term of a signal or number."""
        if isinstance(value, Term):
            return value
        key = id(value) if isinstance(value, np.ndarray) else (float(value), np.signbit(value))
        if key not in self._known:
            self._known[key] = Term(self, "number", len(self.numbers))
            self.numbers.append(value)
        return self._known[key]


class Term(np.lib.mixins.NDArrayOperatorsMixin):
    """A signal of a step that is being written down; what NumPy does to it becomes a line of the notes."""

    def __init__(self, notes: Notes, kind: str, number: int) -> None:
        self.notes, self.kind, self.number = notes, kind, number

    def __array_ufunc__(self, function: np.ufunc, method: str, *operands: Any) -> "Term":
        return self.notes.add(function.__name__, operands)

    def __array_function__(self, function: Callable, types: Any, operands: Any, options: Any) -> "Term":
        if function is np.clip:
            return np.minimum(np.maximum(operands[0], operands[1]), operands[2])
        return self.notes.add(function.__name__, operands)

    def __pow__(self, exponent: float) -> "Term":
        if exponent in (1.0, 2.0):
            return self if exponent == 1.0 else self * self
        return self.notes.add("power", (self, exponent))

    def __bool__(self) -> bool:
        raise TypeError("a step does the same with all runs: use np.where")

    def at(self, sample: "Term") -> "Term":
        """An input as it was at a sample, the first before all."""
        return self.notes.add("at", (sample, self))


class Steps:
    """Steps of B runs over samples of held inputs.

    Args:
        step: carries the states from one step to the next, given time [s] and inputs (n_inputs, B).
        states: where they are kept.
        lanes: B.
        times: of the steps [s], `substeps` of them for each sample.
        inputs: how many.
        substeps: steps a sample.
        kept: how many of the states, the first ones, leave a trail.

    Attributes:
        inputs: (T, n_inputs, B), to be filled.
        trail: (steps + 1, kept, B) from before the first step on.
    """

    def __init__(
        self,
        step: Callable[[Any, Sequence[Any]], None],
        states: Sequence[Place],
        lanes: int,
        times: np.ndarray,
        *,
        inputs: int,
        substeps: int = 1,
        kept: int = 0,
    ) -> None:
        self.step, self.states, self.times, self.substeps = step, list(states), times, substeps
        room = -(-lanes // TOGETHER) * TOGETHER
        whole_inputs = np.zeros((max(len(times) // substeps, 1), inputs, room))
        whole_trail = np.zeros((len(times) + 1, kept, room))
        self.inputs, self.trail = whole_inputs[..., :lanes], whole_trail[..., :lanes]
        for i, (holder, key) in enumerate(self.states[:kept]):
            self.trail[0, i] = holder[key]
        code = library()
        self._play = code and self._written(code, whole_inputs, whole_trail)

    def play(self, first: int, samples: int) -> None:
        """Make the steps of some samples."""
        if self._play:
            # states move to where C has them, which they are then views of
            for (holder, key), row, view in zip(self.states, self._start, self._views, strict=False):
                if holder[key] is not view:
                    row[:] = _filled(holder[key], len(row))
                    holder[key] = view
            self._play(ctypes.c_longlong(first), ctypes.c_longlong(samples))
            return
        for n in range(first * self.substeps, (first + samples) * self.substeps):
            self.step(float(self.times[n]), self.inputs[n // self.substeps])
            for i, (holder, key) in enumerate(self.states[: self.trail.shape[1]]):
                self.trail[n + 1, i] = holder[key]

    def _written(
        self, code: ctypes.CDLL, inputs: np.ndarray, trail: np.ndarray
    ) -> Callable[[ctypes.c_longlong, ctypes.c_longlong], Any]:
        """The step in C, called with first sample and number of samples."""
        notes, count = Notes(), len(self.states)
        before = [holder[key] for holder, key in self.states]
        for i, (holder, key) in enumerate(self.states):
            holder[key] = Term(notes, "state", i)
        try:
            self.step(Term(notes, "time", 0), [Term(notes, "input", i) for i in range(inputs.shape[1])])
            ends = [notes.term(holder[key]) for holder, key in self.states]
        finally:
            for (holder, key), value in zip(self.states, before, strict=True):
                holder[key] = value
        offset = {"state": 0, "input": count, "time": count + inputs.shape[1]}
        offset["number"] = offset["time"] + 1
        given = offset["line"] = offset["number"] + len(notes.numbers)
        self._start = np.zeros((given, inputs.shape[2]))
        for row, value in zip(self._start[offset["number"] :], notes.numbers, strict=True):
            row[:] = _filled(value, len(row))
        self._views: list[np.ndarray] = [row[: self.inputs.shape[2]] for row in self._start[:count]]
        codes = {name: i for i, name in enumerate(OPERATIONS)}

        def rows(terms: Sequence[Term]) -> list[int]:
            return [offset[term.kind] + term.number for term in terms]

        lines = [[codes[name], *rows(terms), *[0] * (3 - len(terms))] for name, terms in notes.lines]
        self._arrays = (
            self._start,
            inputs,
            np.array(self.times, float),
            np.array(lines, np.int64),
            np.array(rows(ends), np.int64),
            trail,
        )
        sizes = (inputs.shape[2], self.substeps, count, inputs.shape[1], given, given + len(lines))
        sizes += (len(lines), trail.shape[1], len(inputs) - 1)
        fixed = [*map(ctypes.c_longlong, sizes), *(ctypes.c_void_p(a.ctypes.data) for a in self._arrays)]
        return lambda first, samples: code.play(first, samples, *fixed)


def _filled(value: Any, room: int) -> np.ndarray:
    """Lanes (room,), those beyond the last one like it."""
    flat = np.ravel(value)
    return np.pad(flat, (0, room - flat.size), mode="edge")

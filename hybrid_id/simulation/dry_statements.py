"""Equations of a system as C statements: for one lane with its tangents, and for lanes that go side by side.

What a function of rows computes is recorded (:mod:`hybrid_id.simulation.tracing`), its gradients included, and divided
by how often it has to be found: once a row, once a sample, or at every evaluation.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.simulation.tracing import record
from hybrid_id.systems.chain import System

NAMES = re.compile(r"\b(?:[a-z]\d+|h)\b")
"""Variables in a recorded expression."""
ROWS = re.compile(r"\b([xupsdk]|fixed|side|over|against)\[(\d+)\]")
"""Arrays of which every lane has its own."""
NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?![\w.])")
"""A number in a recorded expression."""
PLAIN = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""Numbers that belong to a formula and not to a machine."""


def in_lanes(body: str) -> str:
    """Statements of one lane as those of lane l."""
    return ROWS.sub(r"\1[\2][l]", body)


@dataclass(frozen=True)
class Body:
    """C statements of one function.

    Attributes:
        alone: for one lane, its tangents included.
        lanes: for lane l of several.
        tangents: what makes tangents of the gradients that lanes leave, after all lanes.
    """

    alone: str
    lanes: str
    tangents: list[str]


class Statements:
    """C statements of functions of a system's rows.

    What depends on parameters alone is found once a row, what depends on held inputs as well once a sample.

    Args:
        system: its equations are recorded.
        channels: names of the channels.
        free: indices of the parameters by which tangents are taken; None for no tangents.

    Attributes:
        columns: number of tangents.
        prepare: statements that fill ``fixed`` with the values that depend on parameters alone.
        hold: those that add the values that depend on parameters and held inputs.
        n_fixed: how many values these are.
        constants: numbers of the machine, as they are written, and the rows that hold them.
    """

    def __init__(self, system: System, channels: Sequence[str], free: Sequence[int] | None) -> None:
        self.system, self.channels = system, channels
        self.wanted = [f"x{i}" for i in range(len(system.state_names))] + [f"p{i}" for i in free or ()]
        self.columns = 0 if free is None else len(self.wanted)
        self.prepare: list[str] = []
        self.hold: list[str] = []
        self.n_fixed = 0
        self.constants: dict[str, int] = {}

    @torch.no_grad()
    def function(
        self,
        function: Callable[..., list[Tensor]],
        extra: Mapping[str, int],
        targets: Sequence[str],
        tangents: Sequence[int] = (),
    ) -> Body:
        """Body of a function of x, u, p and more.

        Args:
            function: takes rows of x, channels, views and the rows of ``extra``, and returns rows.
            extra: names of its further arrays and their sizes; 0 for a number.
            targets: what is assigned its results.
            tangents: rows of ``k_t`` that hold the results' tangents.
        """
        sizes = {
            "x": len(self.system.state_names),
            "u": len(self.channels),
            "p": len(self.system.table),
            **extra,
        }
        names = {key: [f"{key}{i}" for i in range(n)] if n else [key] for key, n in sizes.items()}
        names |= {key: [] for key in ("u", "d", "s") if sizes.get(key) == 0}
        values = {"x": 0.1, "u": 1.0, "h": 1e-3, "d": 1.0, "s": 1.0}
        flat = [(key, name) for key, own in names.items() for name in own]
        theta = iter(self.system.theta().tolist())
        examples = [next(theta) if key == "p" else values[key] for key, _ in flat]

        def run(*rows: Tensor) -> list[Tensor]:
            left = iter(rows)  # in the order of their names
            given = {key: [next(left) for _ in own] for key, own in names.items()}
            u = dict(zip(self.channels, given["u"], strict=True))
            more = [given[key][0] if key == "h" else given[key] for key in extra]
            return function(given["x"], u, self.system.views(given["p"]), *more)

        def differentiated(*rows: Tensor) -> list[Tensor]:
            leaves = {
                name: row.detach().requires_grad_(name in self.wanted)
                for (_, name), row in zip(flat, rows, strict=True)
            }
            with torch.enable_grad():
                found = run(*leaves.values())
                totals = [one.sum() for one in found]
            results = [one.detach() for one in found]
            for total, one in zip(totals, found, strict=True):
                inputs = [leaves[name] for name in self.wanted]
                grads: Sequence[Tensor | None] = [None] * len(inputs)
                if total.requires_grad:
                    grads = torch.autograd.grad(total, inputs, retain_graph=True, allow_unused=True)
                results += [torch.zeros_like(one) if g is None else g for g in grads]
            return results

        whole = differentiated if tangents and self.columns else run
        statements, results = record(whole, [name for _, name in flat], examples)
        statements, results = (
            [NUMBER.sub(self._named, line) for line in lines] for lines in (statements, results)
        )
        used = {name for line in (*statements, *results) for name in NAMES.findall(line)}
        flat += [("p", name) for name in (f"p{row}" for row in self.constants.values()) if name in used]
        load = [f"const double {n} = {key}[{n[1:]}];" for key, n in flat if n != "h"]
        given = {key: [line for line in load if f" {key}" in line[:15]] for key in "pu"}
        fixed, moving = self._split(statements, results, given["p"], self.prepare)
        held, moving = self._split(moving, results, [*given["p"], *given["u"], *fixed], self.hold)
        body = [*load, *fixed, *held, *moving]
        body += [f"{target} = {result};" for target, result in zip(targets, results, strict=False)]
        alone, lanes, chained = [*body], [in_lanes(line) for line in body], []
        for k, row in enumerate(tangents if self.columns else ()):
            first = len(targets) + k * self.columns
            gradient = results[first : first + self.columns]
            alone += self._chained(row, gradient)
            left = [f"g[{row}][{c}][l]" if NAMES.search(g) else g for c, g in enumerate(gradient)]
            lanes += [f"{name} = {g};" for name, g in zip(left, gradient, strict=True) if name != g]
            chained += self._chained(row, left, "TANGENTS", "LANES", "[l]")
        return Body(lines(alone), lines(lanes), chained)

    def _named(self, number: re.Match[str]) -> str:
        """The row that holds a number, unless it belongs to the formula."""
        text = number.group()
        if float(text) in PLAIN:
            return text
        return f"p{self.constants.setdefault(text, len(self.system.table) + len(self.constants))}"

    def _split(
        self, statements: Sequence[str], results: Sequence[str], load: Sequence[str], earlier: list[str]
    ) -> tuple[list[str], list[str]]:
        """Statements that read what is found earlier, and those that depend on more than that.

        Args:
            statements: to be divided.
            results: names of what their function returns.
            load: statements that read what is known early.
            earlier: gets the statements that depend on nothing else.
        """
        given = {_assigned(line) for line in load}
        known, moving, needed = {}, [], set(results)
        for line in statements:
            used = NAMES.findall(line.split(" = ", 1)[1])
            if all(name in known or name in given for name in used):
                known[_assigned(line)] = line
            else:
                moving.append(line)
                needed.update(used)
        kept = [name for name in known if name in needed]
        places = {name: f"fixed[{self.n_fixed + i}]" for i, name in enumerate(kept)}
        self.n_fixed += len(kept)
        body = [*load, *known.values(), *(f"{place} = {name};" for name, place in places.items())]
        earlier += ["    {", *(f"        {line}" for line in body), "    }"] if kept else []
        kinds = {name: known[name].split(" = ")[0] for name in kept}
        return [f"{kinds[name]} = {place};" for name, place in places.items()], moving

    def _chained(
        self, row: int, gradient: Sequence[str], all_columns: str = "COLUMNS", one: str = "", lane: str = ""
    ) -> list[str]:
        """Statements that fill a row of ``k_t`` by the chain rule from a gradient by states and free parameters."""
        n_x = len(self.system.state_names)
        terms = [f"{g} * x_t[{j}][c]{lane}" for j, g in enumerate(gradient[:n_x]) if g != "0.0"]
        own = [(c, g) for c, g in enumerate(gradient) if c >= n_x and g != "0.0"]
        return [
            f"{all_columns} k_t[{row}][c]{lane} = {' + '.join(terms) or '0.0'};",
            *(f"{one} k_t[{row}][{c}]{lane} += {g};" for c, g in own),
        ]


def lines(statements: Sequence[str]) -> str:
    """Statements as the body of a function."""
    return "\n".join(f"    {line}" for line in statements)


def _assigned(statement: str) -> str:
    """Name of the variable that a statement defines."""
    return statement.split(" = ", 1)[0].split()[-1]

"""C code of the dry engine for one structure of system: its equations of motion, recorded, in the template's places.

Recorded are the time derivative of the state for given directions of dry friction, what may hold a speed at rest, and
the states that remember (see :mod:`hybrid_id.simulation.tracing`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from string import Template

import torch
from torch import Tensor

from hybrid_id.simulation.dry_code import STEPS
from hybrid_id.simulation.dry_lanes import SHOOT
from hybrid_id.simulation.dry_loops import LINEARISE
from hybrid_id.simulation.step import remember
from hybrid_id.simulation.tracing import DECLARED, record
from hybrid_id.systems.balance import Directions
from hybrid_id.systems.chain import Channels, System, Views

NAMES = re.compile(r"\b(?:[a-z]\d+|h)\b")
"""Variables in a recorded expression."""
ROWS = re.compile(r"\b([xupsdk]|fixed|side|over|against)\[(\d+)\]")
"""Arrays of which every lane has its own."""
NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(?![\w.])")
"""A number in a recorded expression."""
PLAIN = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
"""Numbers that belong to a formula and not to a machine."""
WIDTH = 8
"""Lanes that go side by side."""


def source(
    system: System, channels: Sequence[str], free: Sequence[int] | None = None
) -> tuple[str, list[float]]:
    """C code of one structure of system under named channels, of rollouts or of tangents, and a machine's constants.

    Values of parameters stay free, and so do constants (gear ratios, say), which follow the parameters: machines of one
    structure share their code.

    Args:
        system: equations of motion.
        channels: names of the channels.
        free: indices of the parameters by which, beside the states, tangents are taken; None for rollouts.
    """
    n_x, n_u, speeds = len(system.state_names), len(channels), len(system.speed_rows)
    dry = [k for k, is_dry in enumerate(system.dry) if is_dry]
    n, kept = len(dry), system.memory_rows
    pairs: list[tuple[int, int] | None] = []

    def full(rows: Sequence[Tensor]) -> Directions:
        """A direction for each speed from one for each dry speed."""
        return [rows[dry.index(k)] if k in dry else None for k in range(speeds)]

    def rates(x: Sequence[Tensor], u: Channels, p: Views, d: Sequence[Tensor]) -> list[Tensor]:
        return system.rates(x, u, p, full(d))

    def pushes(
        x: Sequence[Tensor], u: Channels, p: Views, s: Sequence[Tensor], d: Sequence[Tensor]
    ) -> list[Tensor]:
        rest, along = system.rest(x, u, p, full(s)), full(d)
        pairs.append(rest.forward.pair)
        now, found = rest.along(along), rest.pushes(along)
        accelerations = now.accelerations(along, held=True)
        against = [-d[i] * accelerations[k] * now.speeds[k].inertia for i, k in enumerate(dry)]
        return [found[k][0] for k in dry] + [found[k][1] for k in dry] + against

    def memory(x: Sequence[Tensor], u: Channels, p: Views, h: Tensor) -> list[Tensor]:
        after = remember(system, list(x), u, p, h)
        return [after[row] for row in kept]

    code = _Code(system, channels, free)
    targets = [f"{name}[{i}]" for name in ("side", "over", "against") for i in range(n)]
    bodies = {
        "rates": code.function(rates, {"d": n}, [f"k[{i}]" for i in range(n_x)], tangents=range(n_x)),
        "pushes": code.function(pushes, {"s": n, "d": n}, targets),
        "remember": code.function(memory, {"h": 0}, [f"x[{i}]" for i in kept], tangents=kept),
    }
    first, second = (dry.index(k) if k in dry else "NONE" for k in pairs[0] or (-1, -1))
    lanes = {f"{name}_lanes": _in_lanes(bodies[name]) for name in ("rates", "pushes", "remember")}
    lanes["hold_lanes"] = _in_lanes("\n".join(code.hold))
    bodies["remember"] += "".join(f"\n    COLUMNS x_t[{i}][c] = k_t[{i}][c];" for i in kept if code.columns)
    written = Template(STEPS + (SHOOT if free is None else LINEARISE)).substitute(
        bodies, **lanes, functions=DECLARED, width=WIDTH, remembers=int(bool(kept)),
        prepare="\n".join(code.prepare), hold="\n".join(code.hold), n_x=n_x, held=n_u,
        n_p=len(system.table) + len(code.constants), n_fixed=code.n_fixed, n_columns=code.columns, n_dry=n,
        n_speeds=speeds, first=first, second=second, rows=", ".join(str(system.speed_rows[k]) for k in dry) or "0",
    )  # fmt: skip
    return written, [float(text) for text in code.constants]


def _in_lanes(body: str) -> str:
    """Statements of one lane as those of lane l."""
    return ROWS.sub(r"\1[\2][l]", body)


class _Code:
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
    ) -> str:
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
        ends = [f"{target} = {result};" for target, result in zip(targets, results, strict=False)]
        for k, row in enumerate(tangents if self.columns else ()):
            first = len(targets) + k * self.columns
            ends += self._chained(row, results[first : first + self.columns])
        return "\n".join(f"    {line}" for line in [*load, *fixed, *held, *moving, *ends])

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

    def _chained(self, row: int, gradient: Sequence[str]) -> list[str]:
        """Statements that fill a row of ``k_t`` by the chain rule from a gradient by states and free parameters."""
        n_x = len(self.system.state_names)
        terms = [f"{g} * x_t[{j}][c]" for j, g in enumerate(gradient[:n_x]) if g != "0.0"]
        own = [(c, g) for c, g in enumerate(gradient) if c >= n_x and g != "0.0"]
        return [
            f"COLUMNS k_t[{row}][c] = {' + '.join(terms) or '0.0'};",
            *(f"k_t[{row}][{c}] += {g};" for c, g in own),
        ]


def _assigned(statement: str) -> str:
    """Name of the variable that a statement defines."""
    return statement.split(" = ", 1)[0].split()[-1]

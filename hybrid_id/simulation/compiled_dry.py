"""Compiled forward path of the dry engine: scalar code, one lane after the other, each with its own events.

The equations of motion with given directions of dry friction, what is left of a push on a speed at rest, and the states
that remember are recorded (see :mod:`hybrid_id.simulation.tracing`); the C code around them follows
:mod:`hybrid_id.simulation.step`. A whole record is walked in milliseconds, so that nothing is gained by nodes between
its samples. Sensitivities stay eager.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from hybrid_id.simulation.c_code import call, library
from hybrid_id.simulation.dry_code import FLAGS, TEMPLATE
from hybrid_id.simulation.step import Engine, remember
from hybrid_id.simulation.tracing import record
from hybrid_id.systems.balance import Directions
from hybrid_id.systems.chain import Channels, System, Views

_SOURCES: WeakKeyDictionary[System, dict[tuple[str, ...], str]] = WeakKeyDictionary()
NAMES = re.compile(r"\b(?:[a-z]\d+|h)\b")
"""Variables in a recorded expression."""


def walks(system: System, engine: Engine, x: Tensor) -> bool:
    """Whether compiled steps with dry friction are asked for and possible here: no network or GPU."""
    here = x.device.type == "cpu" and x.dtype == torch.float64
    return engine.compiled and engine.friction == "dry" and not system.networks and here


def walk(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    length: int,
) -> Tensor:
    """Nodes ``(R, T, n_x)`` with those inside each chunk of ``length`` replaced by a rollout of its first.

    Args:
        system: equations of motion.
        engine: gives the number of sub-steps.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        dt: sample times [s], ``(R, T)``.
        theta: all parameters in table order, ``(n_p, R)``.
        length: samples of a chunk.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """
    rows, samples, _ = x.shape
    u = _arrived(system, u, theta)
    held = torch.stack(list(u.values())) if u else dt.new_empty(0)
    path = x.contiguous().clone()
    arguments = (
        path,
        held,
        dt / engine.substeps,
        theta.T.contiguous(),
        rows,
        samples,
        length,
        engine.substeps,
    )
    known = _SOURCES.setdefault(system, {})
    if tuple(u) not in known:
        known[tuple(u)] = source(system, tuple(u))
    call(library(known[tuple(u)], FLAGS), "shoot", *arguments)
    return path


def _arrived(system: System, u: Mapping[str, Tensor], theta: Tensor) -> Mapping[str, Tensor]:
    """Channels ``(R, T)`` as they arrive at the motors, without the past that a delay needs."""
    if not any(joint.drive.delay for joint in system.joints):
        return u
    shape = next(iter(u.values())).shape
    p = system.views(list(theta.repeat_interleave(shape[1], 1)))
    arrived = system.hold({name: channel.reshape(-1) for name, channel in u.items()}, p)
    return {name: channel.reshape(shape) for name, channel in arrived.items() if "@" not in name}


def source(system: System, channels: Sequence[str]) -> str:
    """C code of one structure of system under named channels; parameter values stay free."""
    n_x, n_u, speeds = len(system.state_names), len(channels), len(system.speed_rows)
    dry = [k for k, is_dry in enumerate(system.dry) if is_dry]
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
        return [after[row] for row in system.memory_rows]

    code = _Code(system, channels)
    n = len(dry)
    targets = [f"{name}[{i}]" for name in ("side", "over", "against") for i in range(n)]
    bodies = {
        "rates": code.function(rates, {"d": n}, [f"k[{i}]" for i in range(n_x)]),
        "pushes": code.function(pushes, {"s": n, "d": n}, targets),
        "remember": code.function(memory, {"h": 0}, [f"x[{row}]" for row in system.memory_rows]),
    }
    first, second = (dry.index(k) if k in dry else "NONE" for k in pairs[0] or (-1, -1))
    return TEMPLATE.substitute(
        bodies, prepare="\n".join(code.prepare), n_x=n_x, held=n_u, n_p=len(system.table), n_fixed=code.n_fixed,
        n_dry=n, n_speeds=speeds, rows=", ".join(str(system.speed_rows[k]) for k in dry) or "0",
        first=first, second=second,
    )  # fmt: skip


class _Code:
    """C statements of functions of a system's rows; what depends on parameters alone is found once a row.

    Args:
        system: its equations are recorded.
        channels: names of the channels.

    Attributes:
        prepare: statements that fill ``fixed``, the values that depend on parameters alone.
        n_fixed: how many these are.
    """

    def __init__(self, system: System, channels: Sequence[str]) -> None:
        self.system, self.channels = system, channels
        self.prepare: list[str] = []
        self.n_fixed = 0

    @torch.no_grad()
    def function(
        self, function: Callable[..., list[Tensor]], extra: Mapping[str, int], targets: Sequence[str]
    ) -> str:
        """Body of a function of x, u, p and more.

        Args:
            function: takes rows of x, channels, views and the rows of ``extra``, and returns rows.
            extra: names of its further arrays and their sizes; 0 for a number.
            targets: what is assigned its results.
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
            left = iter(rows)
            given = {key: [next(left) for _ in own] for key, own in names.items()}
            u = dict(zip(self.channels, given["u"], strict=True))
            more = [given[key][0] if key == "h" else given[key] for key in extra]
            return function(given["x"], u, self.system.views(given["p"]), *more)

        statements, results = record(run, [name for _, name in flat], examples)
        load = [f"const double {n} = {key}[{n[1:]}];" for key, n in flat if n != "h"]
        moving = self._split(statements, results, [line for line in load if " p" in line[:15]])
        ends = [f"{target} = {result};" for target, result in zip(targets, results, strict=True)]
        return "\n".join(f"    {line}" for line in [*load, *moving, *ends])

    def _split(self, statements: Sequence[str], results: Sequence[str], load: Sequence[str]) -> list[str]:
        """The statements that depend on more than parameters; the others go to ``prepare``."""
        alone, moving, needed = {}, [], set(results)
        for line in statements:
            head, expression = line.split(" = ", 1)
            used = NAMES.findall(expression)
            if all(name in alone or name[0] == "p" for name in used):
                alone[head.split()[-1]] = line
            else:
                moving.append(line)
                needed.update(used)
        kept = [name for name in alone if name in needed]
        places = {name: f"fixed[{self.n_fixed + i}]" for i, name in enumerate(kept)}
        self.n_fixed += len(kept)
        body = [*load, *alone.values(), *(f"{place} = {name};" for name, place in places.items())]
        self.prepare += ["    {", *(f"        {line}" for line in body), "    }"] if kept else []
        kinds = {name: alone[name].split(" = ")[0] for name in kept}
        return [f"{kinds[name]} = {place};" for name, place in places.items()] + moving

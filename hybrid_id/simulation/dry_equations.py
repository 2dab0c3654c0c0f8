"""C code of the dry engine for one structure of system: its equations of motion, recorded, in the template's places.

Recorded are the time derivative of the state for given directions of dry friction, what may hold a speed at rest, and
the states that remember (see :mod:`hybrid_id.simulation.tracing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from string import Template
from typing import cast

import numpy as np
from torch import Tensor, nn

from hybrid_id.components.base import Component
from hybrid_id.simulation.dry_code import STEPS
from hybrid_id.simulation.dry_lanes import LANES, LINEARISE, SHOOT
from hybrid_id.simulation.dry_statements import Statements, in_lanes, lines
from hybrid_id.simulation.step import remember
from hybrid_id.simulation.tracing import DECLARED
from hybrid_id.systems.balance import Directions
from hybrid_id.systems.chain import Channels, System, Views

WIDTH = 8
"""Lanes that go side by side."""
EVERY_MODULE = {*vars(nn.Module()), "specs"}
"""Attributes that tell no structure."""


def structure(system: System) -> tuple[object, ...]:
    """What the code depends on: gear ratios, and of each component its class and all but its parameters' values."""
    return system.gear_ratio, tuple((key, type(part), _own(part)) for key, part in system.components.items())


def _own(part: nn.Module) -> str:
    """What a component holds beside its parameters, written out."""
    declared = cast(Component, part).declared
    kept = {name: value for name, value in vars(part).items() if name not in EVERY_MODULE}
    kept |= {name: value for name, value in part.state_dict().items() if name not in declared}
    arrays = (Tensor, np.ndarray)
    return repr({name: v.tolist() if isinstance(v, arrays) else v for name, v in kept.items()})


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

    code = Statements(system, channels, free)
    targets = [f"{name}[{i}]" for name in ("side", "over", "against") for i in range(n)]
    bodies = {
        "rates": code.function(rates, {"d": n}, [f"k[{i}]" for i in range(n_x)], tangents=range(n_x)),
        "pushes": code.function(pushes, {"s": n, "d": n}, targets),
        "remember": code.function(memory, {"h": 0}, [f"x[{i}]" for i in kept], tangents=kept),
    }
    first, second = (dry.index(k) if k in dry else "NONE" for k in pairs[0] or (-1, -1))
    if code.columns:
        bodies["remember"].tangents.extend(f"TANGENTS x_t[{i}][c][l] = k_t[{i}][c][l];" for i in kept)
    texts = {name: body.alone for name, body in bodies.items()}
    texts |= {f"{name}_lanes": body.lanes for name, body in bodies.items()}
    texts |= {f"{name}_tangents": lines(body.tangents) for name, body in bodies.items()}
    written = Template(STEPS + LANES + (SHOOT if free is None else LINEARISE)).substitute(
        texts, functions=DECLARED, width=WIDTH, remembers=int(bool(kept)),
        prepare="\n".join(code.prepare), hold_lanes=in_lanes("\n".join(code.hold)), n_x=n_x, held=n_u,
        n_p=len(system.table) + len(code.constants), n_fixed=code.n_fixed, n_columns=code.columns, n_dry=n,
        n_speeds=speeds, first=first, second=second, rows=", ".join(str(system.speed_rows[k]) for k in dry) or "0",
    )  # fmt: skip
    return written, [float(text) for text in code.constants]

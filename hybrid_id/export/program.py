"""One sample of a system, networks included, as a program that torch alone can run."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from hybrid_id.errors import InputError
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine
from hybrid_id.systems.chain import System


class Step(nn.Module):
    """Next state ``(B, n_x)`` from the state ``(B, n_x)`` and the held channels ``(B, n_u)``.

    Dry friction is smoothed as ``tanh(v / width)``: a program has no room for the events of the dry engine.

    Args:
        system: equations of motion; its parameters and weights become those of the program.
        sample_time: [s].
        engine: smooth engine.
    """

    def __init__(self, system: System, sample_time: float, engine: Engine) -> None:
        super().__init__()
        self.system, self.sample_time, self.engine = system, sample_time, engine

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """The state one sample later."""
        channels = dict(zip(self.system.input_names, u.unbind(1), strict=True))
        views = self.system.views(list(self.system.theta()[:, None]))
        step = torch.full_like(x[:, 0], self.sample_time)
        return torch.stack(self.engine.sample(self.system, x.unbind(1), channels, step, views), 1)


@dataclass(frozen=True)
class Program:
    """An exported step.

    Attributes:
        content: bytes of the file, which ``torch.export.load`` reads.
        interface: what goes in and what comes out.
        difference: largest difference of the reloaded program from the step itself over random states, as a share of
            the largest state.
    """

    content: bytes
    interface: dict[str, Any]
    difference: float


def to_program(system: System, *, sample_time: float, width: float = 0.5) -> Program:
    """The step of a system as a ``torch.export`` program, written, read back and compared with the original.

    Args:
        system: the system; its batch size stays free.
        sample_time: over which commands are held [s].
        width: smoothing speed of dry friction [rad/s].

    Raises:
        InputError: the system has a delay, whose past a single step does not know.
    """
    if delayed := [f"joint{joint.number}" for joint in system.joints if joint.drive.delay is not None]:
        raise InputError(
            f"{delayed[0]} has a delay, whose past a single step does not know; export without it"
        )
    # as many sub-steps as friction near zero speed needs
    x = torch.zeros(1, 5, len(system.state_names), dtype=torch.float64)
    u = {name: torch.zeros(1, 5, dtype=torch.float64) for name in system.input_names}
    dt, y = torch.full((1, 5), sample_time, dtype=torch.float64), torch.zeros(1, 5, 0, dtype=torch.float64)
    batch = Batch(u, dt, y, y, x, x[:, 0], (), ("rest",))
    engine = with_substeps(system, Engine("smooth", width=width), batch, system.theta().detach()[:, None])
    if engine.substeps >= MAX_SUBSTEPS:
        raise InputError(
            f"a step of {sample_time:g} s would need {MAX_SUBSTEPS} sub-steps or more beside friction smoothed over "
            f"±{width:g} rad/s; give a shorter --sample-time or a larger --width"
        )
    step = Step(system, sample_time, engine).eval().requires_grad_(False)
    draw = torch.Generator().manual_seed(0)
    sizes = len(system.state_names), len(system.input_names)
    x, u = (torch.randn(5, size, generator=draw, dtype=torch.float64) for size in sizes)
    free = {0: torch.export.Dim.DYNAMIC}
    program = torch.export.export(step, (x, u), dynamic_shapes=(free, free))
    buffer = io.BytesIO()
    torch.export.save(program, buffer)
    reloaded = torch.export.load(io.BytesIO(buffer.getvalue())).module()
    worst = 0.0
    for rows in (1, 64):
        x, u = (torch.randn(rows, size, generator=draw, dtype=torch.float64) for size in sizes)
        after = step(x, u)
        if not torch.isfinite(after).all():
            raise InputError(
                f"a step of {sample_time:g} s diverges; give a shorter --sample-time or a larger --width"
            )
        worst = max(worst, float((reloaded(x, u) - after).abs().max() / after.abs().max()))
    interface = {
        "states": list(system.state_names),
        "inputs": list(system.input_names),
        "sample_time": sample_time,
        "substeps": engine.substeps,
        "width": width,
        "dtype": "float64",
    }
    return Program(buffer.getvalue(), interface, worst)

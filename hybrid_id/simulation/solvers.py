"""torchdiffeq behind one class: an engine whose sample is an `odeint`, differentiated by the adjoint or by backprop.

A record's inputs are held between samples, so that the vector field jumps at every sample and at no other time. Each
sample is therefore one initial value problem of its own over the unit interval, autonomous, with all samples (of all
records) as lanes: an adaptive solver never meets a jump, and lanes may differ in sample time. The adjoint integrates
the state backwards, too, and is unstable there (smoothed friction: e^(+3000 t), a bristle that slides: e^(+10000 t));
so the state is stored, and the backward integration starts again, at every sample and at every step of a fixed
method. Chained over a record this equals one ``odeint_adjoint`` that requests the state at all these times.

Source: R. T. Q. Chen et al., "Neural Ordinary Differential Equations", NeurIPS 2018; torchdiffeq 0.2.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torchdiffeq import odeint, odeint_adjoint

from hybrid_id.errors import InputError
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.stability import fastest_rate, with_substeps
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine, LaneSubset
from hybrid_id.systems.chain import Channels, Rows, System, Views

FIXED = ("euler", "midpoint", "heun2", "heun3", "rk4")
ADAPTIVE = ("dopri5", "dopri8", "bosh3", "adaptive_heun")
STABLE_TO = {"euler": 1.8, "midpoint": 1.8, "heun2": 1.8, "heun3": 2.3, "rk4": 2.5}
"""Step times eigenvalue that each fixed method bears with a margin (limits of stability: 2, 2, 2, 2.51, 2.79)."""


LONGEST = 2_000
"""Steps of an adaptive method within one sample, beyond which it is of no use: friction is too sharp for it."""
NEAR_BOUND = 1e-3
"""Time [s] within which a state that its bounds stop comes to rest there: a solver cannot meet a corner."""
REST_STEP = 0.2
"""Step times eigenvalue near rest: there the smoothed friction is not only to be stable but to be followed."""


class HeldField(nn.Module):
    """Smooth equations of motion under held inputs, ``dx/ds = dt f(x, u)`` with s = 0 ... 1 over one sample.

    Friction is smoothed as ``tanh(v / width)``; what remembers is a state like any other.

    Args:
        system: equations of motion.
        u: held channels, ``(B,)`` each.
        dt: sample time of each lane [s], ``(B,)``.
        p: parameter views.
        width: smoothing speed [rad/s].
    """

    def __init__(self, system: System, u: Channels, dt: Tensor, p: Views, width: float) -> None:
        super().__init__()
        self.system, self.u, self.dt, self.p, self.width = system, u, dt, p, width

    def forward(self, s: Tensor, x: Tensor) -> Tensor:
        """Rates of all lanes, ``(n_x, B)``, at the states ``x`` ``(n_x, B)``; the time ``s`` does not enter."""
        rows = x.unbind(0)
        rates = self.system.rates(rows, self.u, self.p, width=self.width)
        for row, (drive, rate, low, high) in self.system.state_updates(rows, self.u, self.p):
            rates[row] = drive - rate * rows[row]
            if low is not None and high is not None:
                least, most = (low - rows[row]) / NEAR_BOUND, (high - rows[row]) / NEAR_BOUND
                rates[row] = torch.maximum(torch.minimum(rates[row], most), least)
        return self.dt * torch.stack(rates)


def extra_parameters(system: System) -> list[nn.Parameter]:
    """Trainable parameters of a system beyond its table: the weights of a network in a place."""
    table = {id(getattr(system.components[i.component], i.symbol)) for i in system.table}
    return [p for p in system.parameters() if p.requires_grad and id(p) not in table]


@dataclass(frozen=True)
class OdeEngine(Engine):
    """An engine that integrates a sample by torchdiffeq; takes the place of :class:`Engine` wherever one is asked for.

    Attributes:
        friction, width: as in :class:`Engine`; only "smooth" is possible.
        substeps: steps a sample of a fixed method; an adaptive one chooses its own.
        fine: steps of those samples in which a speed comes near zero, where tanh(v / width) is the stiff part and is
            passed within a fraction of a sample; few samples, and what they cost in accuracy decides all others.
        method: torchdiffeq's name: euler, midpoint, heun2, heun3, rk4 (the 3/8 rule, not the classical one of
            :class:`Engine`), or the adaptive dopri5, dopri8, bosh3, adaptive_heun.
        rtol, atol: tolerances of an adaptive method in the worst lane; all lanes take its steps, so that tighter ones
            and a smaller width cost several times as much as a fixed method.
        gradient: "adjoint" (integrates the costate backwards) or "backprop" (through the steps, exact for them).
    """

    friction: str = "smooth"
    fine: int = 32
    method: str = "rk4"
    rtol: float = 1e-6
    atol: float = 1e-8
    gradient: str = "adjoint"

    def __post_init__(self) -> None:
        if self.friction != "smooth":
            raise InputError(
                f"An ODE solver needs smooth friction, not '{self.friction}'; use friction='smooth'."
            )
        super().__post_init__()
        if self.fine < 1 or not min(self.rtol, self.atol) > 0.0:
            raise InputError(
                f"The solver has {self.fine} fine steps and tolerances {self.rtol}, {self.atol}; give at least 1, "
                "and more than 0."
            )
        if self.compiled:
            raise InputError("An ODE solver has no compiled steps; leave 'compiled' off.")
        if self.method not in FIXED + ADAPTIVE:
            raise InputError(
                f"Method '{self.method}' is not known; use one of {', '.join(FIXED + ADAPTIVE)}."
            )
        if self.gradient not in ("adjoint", "backprop"):
            raise InputError(f"Gradient '{self.gradient}' is not known; use 'adjoint' or 'backprop'.")

    def halved(self) -> OdeEngine:
        """The engine with half the step, or with tighter tolerances where a method chooses its own steps."""
        finer = replace(self, substeps=2 * self.substeps, fine=2 * self.fine)
        return (
            replace(finer, rtol=0.1 * self.rtol, atol=0.1 * self.atol) if self.method in ADAPTIVE else finer
        )

    def sample(self, system: System, x: Rows, u: Channels, dt: Tensor, p: Views) -> list[Tensor]:
        """State after ``dt`` seconds under the held channels ``u``; arguments as in :meth:`Engine.sample`."""
        start = torch.stack(list(x))
        if self.method in ADAPTIVE:
            return list(self._integrate(system, start, u, dt, p, 1).unbind(0))
        near = self.near_rest(system, x, u, dt, p)
        after = start
        for wanted, steps in ((~near, self.substeps), (near, max(self.fine, self.substeps))):
            lanes = wanted.nonzero().squeeze(1)
            if lanes.numel() == 0:
                continue
            if lanes.numel() == near.numel():
                return list(self._integrate(system, start, u, dt, p, steps).unbind(0))
            part = LaneSubset(lanes, near.numel())
            channels, own = part.take_all(u), part.take_views(p)
            end = self._integrate(system, start[:, lanes], channels, part.take(dt), own, steps)
            after = after.index_copy(1, lanes, end)
        return list(after.unbind(0))

    def _integrate(
        self, system: System, start: Tensor, u: Channels, dt: Tensor, p: Views, steps: int
    ) -> Tensor:
        """States ``(n_x, B)`` at the sample's end; the state is requested, and so stored, after each of the steps."""
        field = HeldField(system, u, dt, p, self.width)
        times = torch.linspace(0.0, 1.0, steps + 1, dtype=start.dtype, device=start.device)
        settings: dict = {"method": self.method}
        if self.method in ADAPTIVE:  # a step ends where the sample ends; interpolation would lose the order
            # in the largest change no lane hides behind the others
            limits = {"norm": lambda x: x.abs().max(), "step_t": times, "max_num_steps": LONGEST}
            settings |= {"rtol": self.rtol, "atol": self.atol, "options": limits}
        try:
            if self.gradient == "backprop" or not torch.is_grad_enabled():
                return odeint(field, start, times, **settings)[-1]  # type: ignore[index]
            rows = [row for view in p.values() for row in vars(view).values() if row.requires_grad]
            wanted = (*rows, *extra_parameters(system))
            return odeint_adjoint(field, start, times, adjoint_params=wanted, **settings)[-1]  # type: ignore[index]
        except AssertionError as error:  # torchdiffeq's way to say that its steps shrink without end
            raise InputError(
                f"{self.method} needs more than {LONGEST} steps for one sample ({error}); use rk4, or smooth friction "
                f"over a larger width than {self.width:g} rad/s."
            ) from None

    @torch.no_grad()
    def near_rest(self, system: System, x: Rows, u: Channels, dt: Tensor, p: Views) -> Tensor:
        """Lanes in which a speed comes within four smoothing widths of zero during the sample, ``(B,)`` of bool."""
        rates = system.rates(x, u, p, width=self.width)
        near = torch.zeros_like(x[0], dtype=torch.bool)
        for row in system.speed_rows:
            now, then = x[row], x[row] + dt * rates[row]
            near |= (torch.minimum(now.abs(), then.abs()) < 4.0 * self.width) | (now * then < 0.0)
        return near

    def stable(self, system: System, batch: Batch, theta: Tensor) -> OdeEngine:
        """The engine with at least as many steps as stability and accuracy need at these parameters.

        Args:
            system: equations of motion.
            batch: where the records move.
            theta: all parameters of each row in table order, ``(n_p, R)``.
        """
        if self.method in ADAPTIVE:
            return self
        step = float(batch.dt.max())
        moving = (
            with_substeps(system, Engine("dry"), batch, theta).substeps
            * STABLE_TO["rk4"]
            / STABLE_TO[self.method]
        )
        memories = step * memory_rate(system, batch, theta) / STABLE_TO[self.method]
        resting = step * fastest_rate(system, self, batch, theta) / REST_STEP
        substeps = max(self.substeps, _whole(moving), _whole(memories))
        return replace(self, substeps=substeps, fine=max(self.fine, substeps, _whole(resting)))


def stable_engine(system: System, engine: Engine, batch: Batch) -> Engine:
    """An engine of either kind with at least as many steps as a batch needs at the system's values."""
    theta = system.theta().detach().to(batch.x.device)[:, None].expand(-1, batch.rows)
    if isinstance(engine, OdeEngine):
        return engine.stable(system, batch, theta)
    return with_substeps(system, engine, batch, theta)


@torch.no_grad()
def memory_rate(system: System, batch: Batch, theta: Tensor) -> float:
    """Largest rate [1/s] at which a state forgets, over the batch (0 without memory); see :class:`HeldField`."""
    x = [column.flatten() for column in batch.x.unbind(2)]
    u = {name: channel.flatten() for name, channel in batch.u.items()}
    p = system.views(list(theta.repeat_interleave(batch.x.shape[1], 1)))
    found = [one for _, one in system.state_updates(x, u, p)]
    bounded = [1.0 / NEAR_BOUND for one in found if one.low is not None]
    return max([*bounded, *(float(one.rate.nan_to_num(0.0).max()) for one in found)], default=0.0)


def _whole(steps: float) -> int:
    return min(math.ceil(steps), MAX_SUBSTEPS) if math.isfinite(steps) else MAX_SUBSTEPS

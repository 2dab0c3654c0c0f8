"""One sample of a system: the map from state and held input to the next state, by fixed sub-steps.

Two engines share the same equations of motion. ``dry`` treats dry friction as the set-valued force that it is:
inside a sub-step its direction is fixed, the moment at which a speed reaches zero is located, and the joint sticks or
slides on from there (an event-driven time-stepping scheme of fourth order, with exact sensitivities of the discrete
map, the saltation at a reversal included). ``smooth`` replaces sgn(v) by tanh(v / width) and is a plain RK4; it
serves torchdiffeq and comparisons with solvers that need smooth laws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.systems.chain import Channels, Rows, System, Views


@dataclass(frozen=True)
class Engine:
    """How one sample is integrated.

    Attributes:
        friction: "dry" (projection) or "smooth" (tanh).
        substeps: RK4 steps a sample.
        width: smoothing speed [rad/s] of the smooth engine.
        compiled: whether the smooth engine's sub-steps are compiled (see :mod:`hybrid_id.simulation.compiled`).
    """

    friction: str = "dry"
    substeps: int = 1
    width: float = 0.5
    compiled: bool = False

    def __post_init__(self) -> None:
        if self.friction not in ("dry", "smooth"):
            raise InputError(f"The engine's friction '{self.friction}' is not known; use dry or smooth.")
        if self.substeps < 1 or not self.width > 0.0:
            raise InputError(
                f"The engine has {self.substeps} sub-steps and width {self.width}; give at least 1 and more than 0."
            )

    def sample(self, system: System, x: Rows, u: Channels, dt: Tensor, p: Views) -> list[Tensor]:
        """State after ``dt`` seconds under the held channels ``u``; lanes with ``dt`` = 0 stay as they are.

        Args:
            system: equations of motion.
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            dt: sample time [s], ``(B,)``.
            p: parameter views.
        """
        h = dt / self.substeps
        rows = list(x)
        for _ in range(self.substeps):
            rows = self._relax_bristles(system, rows, p, 0.5 * h)
            if self.friction == "dry":
                rows = _slide(system, rows, u, h, p, events=len(system.speed_rows))
            else:
                rows = rk4(rows, h, lambda now: system.rates(now, u, p, width=self.width))
            rows = self._relax_bristles(system, rows, p, 0.5 * h)
        return rows

    @staticmethod
    def _relax_bristles(system: System, x: list[Tensor], p: Views, h: Tensor) -> list[Tensor]:
        if not system.bristle_rows:
            return x
        x = list(x)
        for row, speed, level in system.bristle_levels(x, p):
            key, law = system.bristle(row)
            x[row] = law.advance(p[key], x[row], speed, level, h)
        return x


def rk4(x: Sequence[Tensor], h: Tensor, rates) -> list[Tensor]:
    """The classical Runge-Kutta step of fourth order on rows of a state."""
    k1 = rates(x)
    k2 = rates([a + (0.5 * h) * k for a, k in zip(x, k1, strict=True)])
    k3 = rates([a + (0.5 * h) * k for a, k in zip(x, k2, strict=True)])
    k4 = rates([a + h * k for a, k in zip(x, k3, strict=True)])
    sixth = h / 6.0
    return [a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]


def _slide(system: System, x: list[Tensor], u: Channels, h: Tensor, p: Views, events: int) -> list[Tensor]:
    """One step with dry friction: to the moment at which a speed reaches zero, then stick or slide on.

    Args:
        system: equations of motion.
        x: state rows, ``(B,)`` each.
        u: channels, ``(B,)`` each.
        h: step [s], ``(B,)``.
        p: parameter views.
        events: speeds that may still reach zero within the step; one more stops there until the next step.
    """
    signs = directions(system, x, u, p)
    dry = [(row, sign) for row, sign in zip(system.speed_rows, signs, strict=True) if sign is not None]
    # a speed that is held has forgotten its value: a small push would have been stopped at once
    x = list(x)
    for row, sign in dry:
        x[row] = x[row] * sign.abs()
    after = rk4(x, h, lambda rows: system.rates(rows, u, p, signs))
    if not dry:
        return after
    crossed = torch.stack([sign * after[row] < 0 for row, sign in dry])
    lanes = crossed.any(0).nonzero().squeeze(1)
    if lanes.numel() == 0:
        return after
    if events == 0:
        for (row, _), hit in zip(dry, crossed, strict=True):
            after[row] = after[row].where(~hit, torch.zeros_like(h))
        return after
    part = LaneSubset(lanes, h.shape[0])
    u, p, h, crossed = part.take_all(u), part.take_views(p), part.take(h), part.take(crossed)
    signs = [None if sign is None else part.take(sign) for sign in signs]
    at, late = _reach_rest(
        system,
        [part.take(row) for row in x],
        [part.take(row) for row in after],
        u, h, p, signs, [row for row, _ in dry], crossed,
    )  # fmt: skip
    rest = _slide(system, at, u, h - late, p, events - 1)
    return [row.index_put((lanes,), new) for row, new in zip(after, rest, strict=True)]


def _reach_rest(
    system: System,
    before: list[Tensor],
    after: list[Tensor],
    u: Channels,
    h: Tensor,
    p: Views,
    signs: Directions,
    rows: list[int],
    crossed: Tensor,
) -> tuple[list[Tensor], Tensor]:
    """State at the moment at which the first of the speeds reaches zero, and that moment [s], ``(B,)``.

    Args:
        system: equations of motion.
        before: state rows before the step.
        after: state rows after the step without regard to what happens at zero speed.
        u: channels.
        h: step [s].
        p: parameter views.
        signs: directions of dry friction before that moment.
        rows: state rows of the speeds that carry dry friction.
        crossed: which of them pass zero within the step, ``(len(rows), B)``.
    """
    fractions = torch.stack(
        [
            torch.where(hit, before[row] / torch.where(hit, before[row] - after[row], h), torch.ones_like(h))
            for row, hit in zip(rows, crossed, strict=True)
        ]
    )
    fraction, first = fractions.min(0)
    moment = fraction * h
    # the chord's estimate of that moment, then one Newton step on the speed that reaches zero there
    at = rk4(before, moment, lambda now: system.rates(now, u, p, signs))
    rates = system.rates(at, u, p, signs)
    late = torch.zeros_like(h)
    for i, row in enumerate(rows):
        slows = (first == i) & (rates[row] * before[row] < 0)
        late = torch.where(slows, at[row] / torch.where(slows, rates[row], torch.ones_like(h)), late)
    late = torch.minimum(torch.maximum(late, moment - h), moment)
    at = [a - late * k for a, k in zip(at, rates, strict=True)]
    for i, row in enumerate(rows):
        at[row] = torch.where(first == i, torch.zeros_like(h), at[row])
    return at, moment - late


Directions = Sequence[Tensor | None]
"""Direction of dry friction for each speed, ``(B,)``; None where a speed has no dry friction."""


@torch.no_grad()
def directions(system: System, x: Rows, u: Channels, p: Views) -> Directions:
    """Direction of dry friction for each speed: its sign, and at rest the push where it exceeds the level, else 0."""
    speeds = [x[row] for row in system.speed_rows]
    signs = [torch.sign(v) if dry else None for v, dry in zip(speeds, system.dry, strict=True)]
    if not any(s is not None and bool((s == 0).any()) for s in signs):
        return signs
    zeros = [torch.zeros_like(v) for v in speeds]
    push = system.balances(x, u, p, zeros, zeros)
    forwards = [
        torch.where(v == 0, (b.smooth > 0).to(v.dtype), (v > 0).to(v.dtype))
        for v, b in zip(speeds, push, strict=True)
    ]
    found: list[Tensor | None] = []
    for sign, balance in zip(signs, system.balances(x, u, p, zeros, forwards), strict=True):
        if sign is not None:
            breakaway = balance.smooth.abs() > balance.holding_level()
            sign = torch.where(sign == 0, torch.sign(balance.smooth) * breakaway, sign)
        found.append(sign)
    return found


class LaneSubset:
    """A subset of lanes: takes it from rows of length B and leaves rows of length 1 as they are."""

    def __init__(self, lanes: Tensor, count: int) -> None:
        self.lanes, self.count = lanes, count

    def take(self, row: Tensor) -> Tensor:
        """The subset of a row."""
        return row if row.shape[-1] != self.count else row.index_select(-1, self.lanes)

    def take_all(self, u: Channels) -> Channels:
        """The subset of every channel."""
        return {name: self.take(channel) for name, channel in u.items()}

    def take_views(self, p: Views) -> Views:
        """The subset of every parameter."""
        return {key: type(v)(**self.take_all(vars(v))) for key, v in p.items()}

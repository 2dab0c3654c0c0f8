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

from hybrid_id.systems.chain import Channels, Rows, System, Views


@dataclass(frozen=True)
class Engine:
    """How one sample is integrated.

    Attributes:
        friction: "dry" (projection) or "smooth" (tanh).
        substeps: RK4 steps a sample.
        width: smoothing speed [rad/s] of the smooth engine.
    """

    friction: str = "dry"
    substeps: int = 1
    width: float = 0.5

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
        substep = self._dry if self.friction == "dry" else self._smooth
        rows = list(x)
        for _ in range(self.substeps):
            rows = self._relax_bristles(system, rows, p, 0.5 * h)
            rows = substep(system, rows, u, h, p)
            rows = self._relax_bristles(system, rows, p, 0.5 * h)
        return rows

    def _smooth(self, system: System, x: list[Tensor], u: Channels, h: Tensor, p: Views) -> list[Tensor]:
        return rk4(x, h, lambda rows: system.rates(rows, u, p, width=self.width))

    def _dry(self, system: System, x: list[Tensor], u: Channels, h: Tensor, p: Views) -> list[Tensor]:
        signs = directions(system, x, u, p)
        # a speed that is held has forgotten its value: a small push would have been stopped at once
        x = list(x)
        for row, sign in zip(system.speed_rows, signs, strict=True):
            x[row] = x[row] * sign.abs()
        after = rk4(x, h, lambda rows: system.rates(rows, u, p, signs))
        crossed = torch.stack([s * after[row] < 0 for row, s in zip(system.speed_rows, signs, strict=True)])
        lanes = crossed.any(0).nonzero().squeeze(1)
        if lanes.numel() == 0:
            return after
        part = LaneSubset(lanes, x[0].shape[0])
        fixed = self._through_rest(
            system,
            [part.take(row) for row in x],
            [part.take(row) for row in after],
            {name: part.take(c) for name, c in u.items()},
            part.take(h),
            part.take_views(p),
            [part.take(s) for s in signs],
            part.take(crossed),
        )
        return [row.index_put((lanes,), new) for row, new in zip(after, fixed, strict=True)]

    def _through_rest(
        self,
        system: System,
        before: list[Tensor],
        after: list[Tensor],
        u: Channels,
        h: Tensor,
        p: Views,
        signs: list[Tensor],
        crossed: Tensor,
    ) -> list[Tensor]:
        """The sub-step of lanes in which a speed reaches zero: up to that moment, then stick or slide on."""
        fractions = torch.stack(
            [
                torch.where(hit, before[row] / torch.where(hit, before[row] - after[row], h), torch.ones_like(h))
                for row, hit in zip(system.speed_rows, crossed, strict=True)
            ]
        )
        fraction, first = fractions.min(0)
        # the chord's estimate of that moment, then one Newton step on the speed that reaches zero there
        at = rk4(before, fraction * h, lambda rows: system.rates(rows, u, p, signs))
        rates = system.rates(at, u, p, signs)
        late = torch.zeros_like(h)
        for i, row in enumerate(system.speed_rows):
            slows = (first == i) & (rates[row] * signs[i] < 0)
            late = torch.where(slows, at[row] / torch.where(slows, rates[row], torch.ones_like(h)), late)
        late = torch.minimum(torch.maximum(late, (fraction - 1.0) * h), fraction * h)
        at = [a - late * k for a, k in zip(at, rates, strict=True)]
        for i, row in enumerate(system.speed_rows):
            at[row] = torch.where(first == i, torch.zeros_like(h), at[row])
        onward = directions(system, at, u, p)
        rest = (1.0 - fraction) * h + late
        end = rk4(at, rest, lambda rows: system.rates(rows, u, p, onward))
        for row, sign in zip(system.speed_rows, onward, strict=True):
            end[row] = torch.where(sign * end[row] > 0, end[row], torch.zeros_like(h))
        return end

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


@torch.no_grad()
def directions(system: System, x: Rows, u: Channels, p: Views) -> list[Tensor]:
    """Direction of dry friction for each speed: its sign, and at rest the push where it exceeds the level, else 0."""
    speeds = [x[row] for row in system.speed_rows]
    signs = [torch.sign(v) for v in speeds]
    resting = [s == 0 for s in signs]
    if not any(bool(r.any()) for r in resting):
        return signs
    zeros = [torch.zeros_like(v) for v in speeds]
    push = system.balances(x, u, p, zeros, zeros)
    forwards = [
        torch.where(r, (b.smooth > 0).to(s.dtype), (s > 0).to(s.dtype))
        for s, r, b in zip(signs, resting, push, strict=True)
    ]
    found = []
    for sign, rest, balance in zip(signs, resting, system.balances(x, u, p, zeros, forwards), strict=True):
        breakaway = balance.smooth.abs() > balance.holding_level()
        found.append(torch.where(rest, torch.sign(balance.smooth) * breakaway, sign))
    return found


class LaneSubset:
    """A subset of lanes: takes it from rows of length B and leaves rows of length 1 as they are."""

    def __init__(self, lanes: Tensor, count: int) -> None:
        self.lanes, self.count = lanes, count

    def take(self, row: Tensor) -> Tensor:
        """The subset of one row."""
        return row if row.shape[-1] != self.count else row.index_select(-1, self.lanes)

    def take_views(self, p: Views) -> Views:
        """The subset of all parameter views."""
        return {key: type(v)(**{n: self.take(row) for n, row in vars(v).items()}) for key, v in p.items()}

"""One sample of a system: the map from state and held input to the next state, by fixed sub-steps.

Two engines share the same equations of motion. ``dry`` treats dry friction as the set-valued force that it is:
inside a sub-step its direction is fixed, the moment at which a speed reaches zero is located, and the joint sticks or
slides on from there (an event-driven time-stepping scheme of fourth order, with exact sensitivities of the discrete
map, the saltation at a reversal included). ``smooth`` replaces sgn(v) by tanh(v / width) and is a plain RK4; it
serves torchdiffeq and comparisons with solvers that need smooth laws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybrid_id.components.bristle import relax
from hybrid_id.errors import InputError
from hybrid_id.systems.balance import Directions
from hybrid_id.systems.chain import Channels, Rows, System, Views

MAX_SUBSTEPS = 64
"""Sub-steps of a sample at most."""


@dataclass(frozen=True)
class Engine:
    """How one sample is integrated.

    Attributes:
        friction: "dry" (set-valued: stick and slip are events) or "smooth" (tanh).
        substeps: RK4 steps a sample.
        width: smoothing speed [rad/s] of the smooth engine.
        compiled: whether rollouts and sensitivities are compiled steps (see :mod:`hybrid_id.simulation.compiled`); what
            fits or simulates records takes these by itself where it can.
        most_substeps: that stability and accuracy may ask for.
    """

    friction: str = "dry"
    substeps: int = 1
    width: float = 0.5
    compiled: bool = False
    most_substeps: int = MAX_SUBSTEPS

    def __post_init__(self) -> None:
        if self.friction not in ("dry", "smooth"):
            raise InputError(f"The engine's friction '{self.friction}' is not known; use dry or smooth.")
        if self.substeps < 1 or not self.width > 0.0:
            raise InputError(
                f"The engine has {self.substeps} sub-steps and width {self.width}; give at least 1 and more than 0."
            )

    def halved(self) -> Engine:
        """The engine with half the step, to tell its own error by comparison."""
        return replace(self, substeps=2 * self.substeps)

    def sample(self, system: System, x: Rows, u: Channels, dt: Tensor, p: Views) -> list[Tensor]:
        """State after ``dt`` seconds under the held channels ``u``; lanes with ``dt`` = 0 stay as they are.

        Args:
            system: equations of motion.
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            dt: sample time [s], ``(B,)``.
            p: parameter views.
        """
        h, u = dt / self.substeps, system.hold(u, p)
        rows = list(x)
        for _ in range(self.substeps):
            rows = update_internal_states(system, rows, u, p, 0.5 * h)
            if self.friction == "dry":
                rows = _slide(system, rows, u, h, p, events=2 * len(system.speed_rows))
            else:
                rows = rk4(rows, h, lambda now: system.rates(now, u, p, width=self.width))
            rows = update_internal_states(system, rows, u, p, 0.5 * h)
        return rows


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


def fill_jacobian(jacobian: Tensor, targets: Rows, wanted: Rows) -> None:
    """Write the derivatives of rows ``(B,)`` by other rows into ``(targets, wanted, B)``, zero where there is none.

    Lanes do not mix, so that one backward sweep of its sum differentiates a row in every lane.
    """
    for i, target in enumerate(targets):
        if not target.requires_grad:
            continue
        with torch.enable_grad():
            total = target.sum()
        for j, grad in enumerate(torch.autograd.grad(total, wanted, retain_graph=True, allow_unused=True)):
            if grad is not None:
                jacobian[i, j] = grad


def update_internal_states(system: System, x: list[Tensor], u: Channels, p: Views, h: Tensor) -> list[Tensor]:
    """The states that remember, ``h`` seconds later at constant motion: exact however stiff they are."""
    if not system.memory_rows:
        return x
    after = list(x)
    for row, (drive, rate, low, high) in system.state_updates(x, u, p):
        after[row] = relax(x[row], drive, rate, h)
        if low is not None and high is not None:  # on a bound it forgets where it came from
            after[row] = torch.where(after[row] <= low, low, after[row])
            after[row] = torch.where(after[row] >= high, high, after[row])
    return after


def rk4(x: Sequence[Tensor], h: Tensor, rates) -> list[Tensor]:
    """The classical Runge-Kutta step of fourth order on rows of a state."""
    k1 = rates(x)
    k2 = rates([a + (0.5 * h) * k for a, k in zip(x, k1, strict=True)])
    k3 = rates([a + (0.5 * h) * k for a, k in zip(x, k2, strict=True)])
    k4 = rates([a + h * k for a, k in zip(x, k3, strict=True)])
    sixth = h / 6.0
    return [a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]


def _slide(
    system: System,
    x: list[Tensor],
    u: Channels,
    h: Tensor,
    p: Views,
    events: int,
    released: Tensor | None = None,
) -> list[Tensor]:
    """One step with dry friction: to the moment at which a speed reaches zero or breaks away, and on from there.

    Args:
        system: equations of motion.
        x: state rows, ``(B,)`` each.
        u: channels, ``(B,)`` each.
        h: step [s], ``(B,)``.
        p: parameter views.
        events: how often that may still happen within the step; after that, what reaches zero stays until the next.
        released: direction in which each dry speed breaks away just now, else 0, ``(dry speeds, B)``.
    """
    signs = system.directions(x, u, p)
    dry = [k for k, sign in enumerate(signs) if sign is not None]
    rows = [system.speed_rows[k] for k in dry]
    if not dry:
        return rk4(x, h, lambda now: system.rates(now, u, p, signs))
    sense = torch.stack([sign for sign in signs if sign is not None])
    if released is not None:
        sense = torch.where(released != 0, released, sense)
    signs = [sense[dry.index(k)] if k in dry else None for k in range(len(signs))]
    # a speed that is held has forgotten its value: a small push would have been stopped at once
    x = list(x)
    for row, sign in zip(rows, sense, strict=True):
        x[row] = x[row] * sign.abs()
    after = rk4(x, h, lambda now: system.rates(now, u, p, signs))
    crossed = torch.stack([sign * after[row] < 0 for row, sign in zip(rows, sense, strict=True)])
    leaves, when = _breakaways(system, x, after, u, p, sense, dry)
    lanes = (crossed | (leaves != 0)).any(0).nonzero().squeeze(1)
    if lanes.numel() == 0:
        return after
    if events == 0:
        for row, hit in zip(rows, crossed, strict=True):
            after[row] = after[row].where(~hit, torch.zeros_like(h))
        return after
    part = LaneSubset(lanes, h.shape[0])
    u, p, h = part.take_all(u), part.take_views(p), part.take(h)
    crossed, leaves, when = part.take(crossed), part.take(leaves), part.take(when)
    before, end = [part.take(row) for row in x], [part.take(row) for row in after]
    signs = [None if sign is None else part.take(sign) for sign in signs]
    at, moment, first = _next_event(system, before, end, u, h, p, signs, rows, crossed, when)
    leaves = torch.where(
        torch.arange(len(rows), device=h.device)[:, None] == first, leaves, torch.zeros_like(leaves)
    )
    rest = _slide(system, at, u, h - moment, p, events - 1, leaves)
    return [row.index_put((lanes,), new) for row, new in zip(after, rest, strict=True)]


def _next_event(
    system: System,
    before: list[Tensor],
    after: list[Tensor],
    u: Channels,
    h: Tensor,
    p: Views,
    signs: Directions,
    rows: list[int],
    crossed: Tensor,
    when: Tensor,
) -> tuple[list[Tensor], Tensor, Tensor]:
    """State at the moment at which the first of the dry speeds reaches zero or breaks away, that moment, and which.

    Args:
        system: equations of motion.
        before: state rows before the step.
        after: state rows after the step without regard to events.
        u: channels.
        h: step [s].
        p: parameter views.
        signs: directions of dry friction before that moment.
        rows: state rows of the speeds that carry dry friction.
        crossed: which of them pass zero within the step, ``(len(rows), B)``.
        when: share of the step after which they break away, 1 where they do not, ``(len(rows), B)``.
    """
    shares = torch.stack(
        [
            torch.where(hit, before[row] / torch.where(hit, before[row] - after[row], h), start)
            for row, hit, start in zip(rows, crossed, when, strict=True)
        ]
    )
    share, first = shares.min(0)
    moment = share * h
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
    return at, moment - late, first


@torch.no_grad()
def _breakaways(
    system: System, x: Rows, after: Rows, u: Channels, p: Views, sense: Tensor, dry: list[int]
) -> tuple[Tensor, Tensor]:
    """Direction in which held speeds break away within the step, else 0, and after which share of it, else 1.

    The moment has no gradient and needs none: motion sets in with no acceleration. A single speed that is held holds
    all that could move it, so that it waits for the next sample.
    """
    leaves, when = torch.zeros_like(sense), torch.ones_like(sense)
    lanes = (sense == 0).any(0).nonzero().squeeze(1)
    if len(system.speed_rows) == 1 or lanes.numel() == 0:
        return leaves, when
    part = LaneSubset(lanes, sense.shape[1])
    u, p = part.take_all(u), part.take_views(p)
    signs = [part.take(sense[dry.index(k)]) if k in dry else None for k in range(len(system.speed_rows))]
    start, end = (
        system.rest([part.take(row) for row in rows], u, p, signs).breakaway_margins(signs)
        for rows in (x, after)
    )
    for i, k in enumerate(dry):
        (_, short), (side, over) = start[k], end[k]
        loose = (part.take(sense[i]) == 0) & (over > 0)
        leaves[i, lanes] = side * loose
        when[i, lanes] = torch.where(
            loose, short / torch.where(loose, short - over, -torch.ones_like(over)), 1.0
        )
    return leaves, when.clamp(0.0, 1.0)

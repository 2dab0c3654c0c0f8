"""Torque balances of all speeds: their accelerations, and which of them dry friction holds at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import torch
from torch import Tensor

Directions = Sequence[Tensor | None]
"""Direction of dry friction for each speed, ``(B,)``; None where a speed has no dry friction."""


@dataclass
class SpeedBalance:
    """Forces on one speed: ``inertia * a = smooth - direction * (level + factor |transmitted|)``.

    ``transmitted = link_share * inertia * a + load`` is the torque through a rigid gear, dry friction at the link left
    out, which no record parts from that at the motor there; with a spring the chain
    knows it beforehand, puts its friction into ``level`` and leaves ``factor`` empty.
    """

    inertia: Tensor
    smooth: Tensor
    level: Tensor
    factor: Tensor | None = None
    link_share: Tensor | None = None
    load: Tensor | None = None

    def acceleration(self, direction: Tensor | None) -> Tensor:
        """Acceleration for a direction of dry friction in [-1, 1], the load's loop closed exactly."""
        if direction is None:
            return self.smooth / self.inertia
        net = self.smooth - direction * self.level
        if self.factor is None or self.link_share is None or self.load is None:
            return net / self.inertia
        # with |factor| < 1 the transmitted torque has the sign that it has without load-dependent friction
        signed = direction * self.factor * torch.sign(self.link_share * net + self.load)
        return (net - signed * self.load) / (self.inertia * (1.0 + signed * self.link_share))

    def holding_level(self, reaction: Tensor | float) -> Tensor:
        """Largest dry friction at rest, under a ``reaction`` of the other joint."""
        if self.factor is None:
            return self.level
        return self.level + self.factor * (cast(Tensor, self.load) + reaction).abs()

    def transmitted(self, own: Tensor, reaction: Tensor) -> Tensor:
        """Torque through the gear at the acceleration ``own`` and under a reaction of the other joint."""
        return cast(Tensor, self.link_share) * self.inertia * own + reaction + cast(Tensor, self.load)


@dataclass
class Balances:
    """Balances of all speeds of a system; the links of an arm share an off-diagonal inertia.

    Attributes:
        speeds: one balance a speed.
        pair: the two speeds that carry the links of an arm, None where nothing couples them.
        coupling: their off-diagonal inertia, ``(B,)``.
    """

    speeds: list[SpeedBalance]
    pair: tuple[int, int] | None = None
    coupling: Tensor | None = None

    def accelerations(self, directions: Directions, *, held: bool) -> list[Tensor]:
        """Accelerations for directions of dry friction in [-1, 1]; with ``held``, 0 is at rest and stays there."""
        free = [None if d is None or not held else d.abs() for d in directions]
        found: dict[int, Tensor] = {}
        if self.pair is not None and self.coupling is not None:
            found = dict(
                zip(self.pair, self._coupled(self.pair, self.coupling, directions, free), strict=True)
            )
        for k, balance in enumerate(self.speeds):
            own = found[k] if k in found else balance.acceleration(directions[k])
            found[k] = own if (f := free[k]) is None else own * f
        return [found[k] for k in range(len(self.speeds))]

    def _coupled(
        self, pair: tuple[int, int], coupling: Tensor, directions: Directions, free: Directions
    ) -> tuple[Tensor, Tensor]:
        """Accelerations of both links; one that is held does not push the other."""
        both, along = [self.speeds[k] for k in pair], [directions[k] for k in pair]
        for move in (free[k] for k in pair):
            coupling = coupling if move is None else coupling * move
        loaded = [b.factor is not None and d is not None for b, d in zip(both, along, strict=True)]
        signs: list[Tensor | None] = [None, None]
        found = []
        # the signs of the torques through the gears: without load-dependent friction, then as they come out
        for _ in range(3 if any(loaded) else 1):
            rows = [_row(*of) for of in zip(both, along, signs, strict=True)]
            (m_1, g_1, f_1), (m_2, g_2, f_2) = rows
            m_12 = coupling if g_1 is None else coupling * g_1
            m_21 = coupling if g_2 is None else coupling * g_2
            determinant = m_1 * m_2 - m_12 * m_21
            found = [(m_2 * f_1 - m_12 * f_2) / determinant, (m_1 * f_2 - m_21 * f_1) / determinant]
            torques = zip(both, found, reversed(found), loaded, strict=True)
            signs = [
                torch.sign(b.transmitted(own, coupling * other).detach()) if needed else None
                for b, own, other, needed in torques
            ]
        return found[0], found[1]

    def reactions(self, accelerations: Sequence[Tensor]) -> list[Tensor | float]:
        """Torque that each speed needs only because the other link accelerates."""
        found: list[Tensor | float] = [0.0] * len(self.speeds)
        if self.pair is not None and self.coupling is not None:
            i, j = self.pair
            found[i], found[j] = self.coupling * accelerations[j], self.coupling * accelerations[i]
        return found


def _row(
    balance: SpeedBalance, direction: Tensor | None, sign: Tensor | None
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Inertia, factor of the off-diagonal inertia and force of one row of the two links' equations."""
    net = balance.smooth if direction is None else balance.smooth - direction * balance.level
    if sign is None or direction is None or balance.factor is None:
        return balance.inertia, None, net
    signed = direction * balance.factor * sign
    own = balance.inertia * (1.0 + signed * cast(Tensor, balance.link_share))
    return own, 1.0 + signed, net - signed * cast(Tensor, balance.load)


@dataclass
class Rest:
    """What may hold the speeds that are zero: the balances with dry friction forward and backward.

    Moving speeds have their own direction in both.
    """

    forward: Balances
    backward: Balances

    def along(self, directions: Directions) -> Balances:
        """The balances with each dry friction in its direction."""
        speeds = []
        for ahead, back, d in zip(self.forward.speeds, self.backward.speeds, directions, strict=True):
            if d is None:
                speeds.append(ahead)
                continue
            smooth = torch.where(d > 0, ahead.smooth, back.smooth)
            speeds.append(replace(ahead, smooth=smooth, level=torch.where(d > 0, ahead.level, back.level)))
        return replace(self.forward, speeds=speeds)

    def pushes(self, directions: Directions) -> list[tuple[Tensor, Tensor]]:
        """For each speed at rest where it is pushed (-1, 0, 1), and how far beyond what dry friction holds [N m]."""
        now = self.along(directions)
        reactions = now.reactions(now.accelerations(directions, held=True))
        found = []
        for ahead, back, r in zip(self.forward.speeds, self.backward.speeds, reactions, strict=True):
            up = ahead.smooth - r - ahead.holding_level(r)
            down = r - back.smooth - back.holding_level(r)
            found.append((torch.sign(up - down), torch.maximum(up, down)))
        return found

    def settle(self, directions: Directions) -> list[Tensor | None]:
        """Where each speed goes, 0 where it stays at rest: the one answer that contradicts no balance.

        A single speed stays unless it is pushed beyond its level. With two coupled links, whether one stays depends on
        the other: ``min 1/2 a' M a - f' a + sum level |a|`` over the accelerations a of those at rest is strictly
        convex, so that exactly one of its nine combinations of directions agrees with itself.

        Args:
            directions: sign of each speed, None where there is no dry friction.
        """
        found = [
            None if d is None else torch.where(d == 0, side * (over > 0), d)
            for d, (side, over) in zip(directions, self.pushes(directions), strict=True)
        ]
        pair = self.forward.pair
        if pair is None:
            return found
        options = [[0.0] if directions[k] is None else [0.0, 1.0, -1.0] for k in pair]
        like = self.forward.speeds[pair[0]].smooth
        grid = torch.cartesian_prod(*(torch.tensor(o, dtype=like.dtype, device=like.device) for o in options))
        trial, resting = list(directions), {}
        for k, choice in zip(pair, grid.unbind(1), strict=True):
            if (d := directions[k]) is not None:
                resting[k] = d == 0
                trial[k] = torch.where(resting[k], choice[:, None], d)
        now = self.along(trial)
        accelerations, pushes = now.accelerations(trial, held=True), self.pushes(trial)
        wrong = torch.full_like(like, -torch.inf)
        for k, rests in resting.items():
            along = cast(Tensor, trial[k])
            against = -along * accelerations[k] * now.speeds[k].inertia
            fault = torch.where(along == 0, pushes[k][1], against)
            wrong = torch.maximum(wrong, fault.where(rests, torch.full_like(fault, -torch.inf)))
        best = wrong.argmin(0, keepdim=True)
        for k in resting:
            found[k] = cast(Tensor, trial[k]).gather(0, best)[0]
        return found

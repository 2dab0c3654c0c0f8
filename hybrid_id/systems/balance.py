"""Torque balances of all speeds: their accelerations, and which of them dry friction holds at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import cast

import torch
from torch import Tensor

Rows = Sequence[Tensor]
"""State rows, ``(B,)`` each."""
Channels = Mapping[str, Tensor]
"""Logged channels by name, ``(B,)`` each."""
Views = Mapping[str, SimpleNamespace]
"""Parameter views by component key."""
Directions = Sequence[Tensor | None]
"""Direction of dry friction for each speed, ``(B,)``; None where a speed has no dry friction."""

PIVOTS = 100
"""Changes of direction at most in which coupled speeds find out who moves; two or three are the rule."""


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
        """Largest dry friction at rest, under a ``reaction`` of other joints."""
        if self.factor is None:
            return self.level
        return self.level + self.factor * (cast(Tensor, self.load) + reaction).abs()

    def transmitted(self, own: Tensor, reaction: Tensor | float) -> Tensor:
        """Torque through the gear at the acceleration ``own`` and under a reaction of other joints."""
        return cast(Tensor, self.link_share) * self.inertia * own + reaction + cast(Tensor, self.load)


@dataclass
class Balances:
    """Balances of all speeds of a system; links that push each other share off-diagonal inertias.

    Attributes:
        speeds: one balance a speed.
        couplings: off-diagonal inertia of two speeds by their numbers, the lower first, ``(B,)`` each.
    """

    speeds: list[SpeedBalance]
    couplings: Mapping[tuple[int, int], Tensor] = field(default_factory=dict)

    @property
    def coupled(self) -> list[int]:
        """Numbers of the speeds that share an inertia with another one."""
        return sorted({k for pair in self.couplings for k in pair})

    def accelerations(self, directions: Directions, *, held: bool) -> list[Tensor]:
        """Accelerations for directions of dry friction in [-1, 1]; with ``held``, 0 is at rest and stays there."""
        free = [None if d is None or not held else d.abs() for d in directions]
        found = self._together(directions, free)
        for k, balance in enumerate(self.speeds):
            own = found[k] if k in found else balance.acceleration(directions[k])
            found[k] = own if (f := free[k]) is None else own * f
        return [found[k] for k in range(len(self.speeds))]

    def _together(self, directions: Directions, free: Directions) -> dict[int, Tensor]:
        """Accelerations of the coupled speeds by number; one that is held pushes no other."""
        group = self.coupled
        shared: dict[tuple[int, int], Tensor] = {}
        for (i, j), inertia in self.couplings.items():
            for move in (free[i], free[j]):
                inertia = inertia if move is None else inertia * move
            shared[i, j] = shared[j, i] = inertia
        loaded = [k for k in group if self.speeds[k].factor is not None and directions[k] is not None]
        signs: dict[int, Tensor] = {}
        found: dict[int, Tensor] = {}
        # the signs of the torques through the gears: without load-dependent friction, then as they come out
        for _ in range(3 if loaded else 1):
            rows: list[dict[int, Tensor]] = []
            forces: list[Tensor] = []
            for k in group:
                own, factor, force = _row(self.speeds[k], directions[k], signs.get(k))
                others = {j: shared[k, j] for j in group if (k, j) in shared}
                others = others if factor is None else {j: m * factor for j, m in others.items()}
                rows.append({k: own} | others)
                forces.append(force)
            found = dict(zip(group, _solved(group, rows, forces), strict=True))
            for k in loaded:
                reaction = sum(shared[k, j] * found[j] for j in group if (k, j) in shared)
                torque = self.speeds[k].transmitted(found[k], cast(Tensor, reaction))
                signs[k] = torch.sign(torque.detach())
        return found

    def reactions(self, accelerations: Sequence[Tensor]) -> list[Tensor | float]:
        """Torque that each speed needs only because others accelerate."""
        found: list[Tensor | float] = [0.0] * len(self.speeds)
        for (i, j), inertia in self.couplings.items():
            found[i] = found[i] + inertia * accelerations[j]
            found[j] = found[j] + inertia * accelerations[i]
        return found


def _solved(
    group: Sequence[int], rows: Sequence[dict[int, Tensor]], forces: Sequence[Tensor]
) -> list[Tensor]:
    """Solution of linear equations by elimination, entries by number; what is not there is zero.

    No pivoting: a mass matrix is positive definite, and load-dependent friction scales its rows.
    """
    rows, forces, n = [dict(row) for row in rows], list(forces), len(group)
    for i, k in enumerate(group):
        for below in range(i + 1, n):
            if k not in rows[below]:
                continue
            share = rows[below].pop(k) / rows[i][k]
            for j, entry in rows[i].items():
                if j in group[i + 1 :]:
                    rows[below][j] = rows[below][j] - share * entry if j in rows[below] else -share * entry
            forces[below] = forces[below] - share * forces[i]
    found: dict[int, Tensor] = {}
    for i in reversed(range(n)):
        force = forces[i]
        for j, known in found.items():
            if j in rows[i]:
                force = force - rows[i][j] * known
        found[group[i]] = force / rows[i][group[i]]
    return [found[k] for k in group]


def _row(
    balance: SpeedBalance, direction: Tensor | None, sign: Tensor | None
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Inertia, factor of the off-diagonal inertias and force of one row of coupled equations."""
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

    def breakaway_margins(self, directions: Directions) -> list[tuple[Tensor, Tensor]]:
        """For each speed at rest where it is pushed (-1, 0, 1), and how far beyond what dry friction holds [N m]."""
        now = self.along(directions)
        reactions = now.reactions(now.accelerations(directions, held=True))
        found = []
        for ahead, back, r in zip(self.forward.speeds, self.backward.speeds, reactions, strict=True):
            up = ahead.smooth - r - ahead.holding_level(r)
            down = r - back.smooth - back.holding_level(r)
            found.append((torch.sign(up - down), torch.maximum(up, down)))
        return found

    def stick_slip(self, directions: Directions) -> list[Tensor | None]:
        """Where each speed goes, 0 where it stays at rest: the one answer that contradicts no balance.

        A single speed stays unless it is pushed beyond its level. Of coupled speeds, whether one stays depends on the
        others: ``min 1/2 a' M a - f' a + sum level |a|`` over the accelerations a of those at rest is strictly
        convex, so that one combination of directions agrees with itself. It is found by changing one contradicted
        direction at a time, that of the lowest number first (K. G. Murty, Linear Complementarity, 1988, section 11.2;
        with bounds J. J. Judice and F. M. Pires, Computers & Operations Research 21, 1994).

        Args:
            directions: sign of each speed, None where there is no dry friction.
        """
        rests = [None if d is None else d == 0 for d in directions]
        coupled = [k for k in self.forward.coupled if rests[k] is not None]
        found = [
            d if d is None or k in coupled else torch.where(d == 0, side * (margin > 0), d)
            for k, (d, (side, margin)) in enumerate(
                zip(directions, self.breakaway_margins(directions), strict=True)
            )
        ]
        for _ in range(min(3 ** len(coupled), PIVOTS) if coupled else 0):
            now, margins = self.along(found), self.breakaway_margins(found)
            accelerations, settled = now.accelerations(found, held=True), None
            for k in coupled:
                along, (side, margin) = cast(Tensor, found[k]), margins[k]
                stays = along == 0
                against = -along * accelerations[k] * now.speeds[k].inertia
                wrong = cast(Tensor, rests[k]) & (torch.where(stays, margin, against) > 0)
                first = wrong if settled is None else wrong & settled
                found[k] = torch.where(first, side * stays, along)
                settled = ~wrong if settled is None else settled & ~wrong
            if settled is None or bool(settled.all()):
                break
        return found

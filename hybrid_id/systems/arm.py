"""Two joints that push each other: off-diagonal inertia and torques between the links of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.components.coupling import Coupling
from hybrid_id.errors import InputError
from hybrid_id.systems.balance import Balances, SpeedBalance
from hybrid_id.systems.joint import Joint

Views = Mapping[str, SimpleNamespace]


class Arm:
    """The couplings of a system with two joints.

    Args:
        joints: the system's joints.
        components: the system's components by key; those that are no coupling are ignored.

    Raises:
        InputError: a coupling in a system that has not two joints, or the same one in both places.
    """

    def __init__(self, joints: Sequence[Joint], components: Mapping[str, Component]) -> None:
        self.joints = joints
        self.couplings = {key: part for key, part in components.items() if isinstance(part, Coupling)}
        kinds = [part.kind for part in self.couplings.values()]
        for key, part in self.couplings.items():
            if len(joints) != 2:
                raise InputError(
                    f"{part.kind} at '{key.rsplit('/', 1)[0]}' couples two joints, but the system has {len(joints)}; "
                    "remove it."
                )
            if kinds.count(part.kind) > 1:
                raise InputError(
                    f"{part.kind} sits at both joints; it acts on both from either, so keep one of them."
                )

    def couple(self, speeds: list[SpeedBalance], x: Sequence[Tensor], p: Views) -> Balances:
        """The balances of all speeds with what acts between the links; without couplings as they are."""
        if not self.couplings:
            return Balances(speeds)
        links = [_link_motion(joint, x, p) for joint in self.joints]
        (first_angle, first_rate, *_), (second_angle, second_rate, *_) = links
        first = len(self.joints[0].positions) - 1
        pair = (first, len(speeds) - 1)
        coupling = None
        for key, part in self.couplings.items():
            torques = part.torques(p[key], (first_angle, second_angle), (first_rate, second_rate))
            for k, (_, _, slope, _), torque in zip(pair, links, torques, strict=True):
                _load(speeds[k], torque * slope)
            if (inertia := part.inertia(p[key], second_angle)) is not None:
                (_, _, slope, turn), (_, _, other_slope, other_turn) = links
                _weigh(speeds[first], inertia[0] * slope**2)
                shared = inertia[1] * (p[key].definite * (slope * other_slope))
                coupling = shared if coupling is None else coupling + shared
                # what a gear's error accelerates while its rotor turns evenly
                if turn is not None:
                    _load(speeds[pair[0]], inertia[0] * slope * turn)
                    _load(speeds[pair[1]], inertia[1] * other_slope * turn)
                if other_turn is not None:
                    _load(speeds[pair[0]], inertia[1] * slope * other_turn)
        return Balances(speeds) if coupling is None else Balances(speeds, pair, coupling)

    def guard(self, p: Views) -> None:
        """Make the coupling's inertia not a number wherever the mass matrix is not positive definite for every angle.

        No step of a fit is then accepted there: it ends as a rollout that fails.
        """
        for key, part in self.couplings.items():
            if (least := self.determinant(p, key, part)) is not None:
                one = torch.ones_like(least)
                p[key].definite = torch.where(least.detach() > 0, one, torch.nan * one)

    def check(self, p: Views) -> None:
        """Raise InputError where the mass matrix of the stored values is not positive definite for every angle."""
        for key, part in self.couplings.items():
            least = self.determinant(p, key, part)
            if least is not None and not bool((least > 0).all()):
                values = {**vars(p[key])}
                values |= {f"P_{j.number}": self._link(j, p) for j in self.joints}
                listed = ", ".join(f"{n} = {v.item():.4g}" for n, v in values.items())
                share = "" if all(j.rigid for j in self.joints) else "the links' own (less rotor_share), "
                raise InputError(
                    f"The arm's mass matrix is not positive definite for every angle of joint 2 ({share}{listed} "
                    "kg m^2); bring the values of the coupling down, so that (P_1 + 2 P_3) P_2 exceeds (P_4 + P_3)^2 "
                    "and (P_1 - 2 P_3) P_2 exceeds (P_4 - P_3)^2."
                )

    def determinant(self, p: Views, key: str, part: Coupling) -> Tensor | None:
        """Least determinant of the links' mass matrix over the angles of joint 2; None without inertial coupling."""
        least = None
        first, second = (self._link(joint, p) for joint in self.joints)
        for angle in (0.0, torch.pi):
            inertia = part.inertia(p[key], torch.full_like(first, angle))
            if inertia is None:
                return None
            here = (first + inertia[0]) * second - inertia[1] ** 2
            least = here if least is None else torch.minimum(least, here)
        return least

    @staticmethod
    def _link(joint: Joint, p: Views) -> Tensor:
        """What a joint's link carries at the link, the rotor included behind a rigid gear [kg m^2]."""
        key, inertia = joint.inertia
        view, r = p[key], joint.gear_ratio
        return inertia.total(view, r) * r**2 if joint.rigid else inertia.link(view, r)


def _link_motion(
    joint: Joint, x: Sequence[Tensor], p: Views
) -> tuple[Tensor, Tensor, Tensor | float, Tensor | None]:
    """Angle [rad] and speed [rad/s] of a link, its speed by that of what turns it, and its acceleration at even speed.

    What turns a link is the rotor behind a rigid gear, and the link itself behind a compliant one. The acceleration is
    None where there is none.
    """
    if not joint.rigid:
        return *joint.link_motion(x, p), 1.0, None
    row = joint.positions[0]
    angle, slope, bend = joint.gear.map(x[row], p)
    return angle, x[row + 1] * slope, slope, None if bend is None else bend * x[row + 1].square()


def _load(speed: SpeedBalance, torque: Tensor) -> None:
    """Let a torque oppose a speed."""
    speed.smooth = speed.smooth - torque
    if speed.load is not None:
        speed.load = speed.load + torque


def _weigh(speed: SpeedBalance, inertia: Tensor) -> None:
    """Add inertia to the link of a speed."""
    total = speed.inertia + inertia
    if speed.link_share is not None:
        speed.link_share = (speed.link_share * speed.inertia + inertia) / total
    speed.inertia = total

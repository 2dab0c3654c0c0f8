"""What every component is that acts between the two links of an arm."""

from __future__ import annotations

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Component


class Coupling(Component):
    """Place ``load`` of either joint: acts on both links of an arm with two joints.

    Angles and speeds are those of the links, each joint's relative to the link before it.
    """

    places = ("load",)

    def inertia(self, p: SimpleNamespace, angle: Tensor) -> tuple[Tensor, Tensor] | None:
        """What the coupling adds to M_11 and M_12 [kg m^2] at the second joint's ``angle``, ``(B,)`` each.

        It has to be affine in the cosine of that angle: the mass matrix is checked at 0 and 180 degrees, and between
        them the determinant is then no smaller than at the worse of the two.
        """
        return None

    def torques(
        self, p: SimpleNamespace, angles: tuple[Tensor, Tensor], speeds: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Torques at the two links [N m] that the drives must overcome, ``(B,)`` each."""
        raise NotImplementedError

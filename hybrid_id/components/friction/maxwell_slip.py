"""Presliding friction of several springs that slide one after the other."""

import torch
from torch import Tensor

from hybrid_id.components.bristle import Bristle, stiffnesses
from hybrid_id.parameters import Parameter

ELEMENTS = 3
GIVES = 0.3
"""Share of its level over which a spring goes over from holding to sliding."""


class MaxwellSlip(Bristle):
    """``dF_i/dt = (sigma / N) (v - |v| a_i F_i / l_i)``, ``F = sum F_i``: N springs, each slides at its own level l_i.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | sigma | N m/rad | stiffness at rest |
    | l_i | N m | ``2 i / (N (N + 1))`` of the level of the dry laws on the same speed, i = 1 .. N, N = 3 |
    | a_i | 1 | 0 while a spring holds (``|F_i| < 0.7 l_i``, or it is unloaded), 1 where it slides, smooth in between |

    Dahl's law slides a little at every force; these springs hold fully, so that small reversals cost no energy and
    larger ones leave loops with a memory of where the motion turned.
    Source: W. D. Iwan, J. Appl. Mech. 33(4), 1966; generalised Maxwell slip: F. Al-Bender, V. Lampaert, J. Swevers,
    IEEE TAC 50(11), 2005; a_i after P. Dupont et al., IEEE TAC 47(5), 2002 (there a sine, here a cubic).
    """

    kind = "maxwell_slip"
    states = tuple(f"F{i + 1}" for i in range(ELEMENTS))
    sigma = Parameter(1.0, lower=1e-6, upper=1e6, unit="N m/rad", doc="stiffness at rest")

    def state_updates(self, p, states, speed, level):
        found = []
        for force, limit in zip(states, _limits(level), strict=True):
            drawn = ((force * torch.sign(speed) / limit - (1.0 - GIVES)) / GIVES).clamp(0.0, 1.0)
            slides = drawn.square() * (3.0 - 2.0 * drawn)
            stiffness = p.sigma / ELEMENTS
            found.append((stiffness * speed, stiffness * speed.abs() * slides / limit))
        return found

    def torque(self, p, states, speed, level):
        # a long step may draw a spring beyond its level, where the next one lets it slide back
        held = [force.clamp(-limit, limit) for force, limit in zip(states, _limits(level), strict=True)]
        return sum(held[1:], held[0])

    @staticmethod
    def starts(site):
        return [{"sigma": stiffness} for stiffness in stiffnesses(site)]


def _limits(level: Tensor) -> list[Tensor]:
    return [level * (2.0 * i / (ELEMENTS * (ELEMENTS + 1))) for i in range(1, ELEMENTS + 1)]

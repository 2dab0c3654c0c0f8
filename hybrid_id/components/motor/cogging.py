"""Torque of magnets and slots."""

import torch

from hybrid_id.components.drive import RotorTorque
from hybrid_id.parameters import Parameter


class Cogging(RotorTorque):
    """``tau = T_c cos(n q) + T_s sin(n q)`` with the rotor's angle q, zero on average over a turn.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | T_c, T_s | N m | amplitudes, of either sign |
    | n | 1 | periods per turn of the rotor (least common multiple of poles and slots, or a multiple) |
    | T_c2, T_s2, n_2 | N m, 1 | the same of a second wave, which is added: an overtone, say |

    Source: J. F. Gieras, Permanent Magnet Motor Technology, 3rd ed., 2009, chapter 6: two terms of the series.
    """

    kind = "cogging"
    T_c = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the cosine")
    T_s = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the sine")
    n = Parameter(6.0, lower=0.0, upper=1e4, unit="1", doc="periods per turn", estimate=False)
    T_c2 = Parameter(0.0, -1e3, 1e3, "N m", "amplitude of the second wave's cosine", estimate=False)
    T_s2 = Parameter(0.0, -1e3, 1e3, "N m", "amplitude of the second wave's sine", estimate=False)
    n_2 = Parameter(12.0, upper=1e4, unit="1", doc="periods per turn of the second wave", estimate=False)

    def torque(self, p, angle, speed):
        first = p.T_c * torch.cos(p.n * angle) + p.T_s * torch.sin(p.n * angle)
        return first + p.T_c2 * torch.cos(p.n_2 * angle) + p.T_s2 * torch.sin(p.n_2 * angle)

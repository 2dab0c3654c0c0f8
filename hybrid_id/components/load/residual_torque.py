"""A small network for what the laws of a joint miss, whose weights are parameters like any others."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import LoadTorque
from hybrid_id.parameters import Parameter

NEURONS = 6


def _weights(doc: str, starts: Sequence[float]) -> tuple[Parameter, ...]:
    return tuple(Parameter(start, lower=-8.0, upper=8.0, unit="1", doc=doc) for start in starts)


class ResidualTorque(LoadTorque):
    """``tau = S_r sum_k c_k tanh(a_k (q - m_q) / s_q + b_k v / s_v + d_k)`` at the link, k = 1 ... 6.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | S_r | N m | output scale (held) |
    | m_q, s_q, s_v | rad, rad, rad/s | middle and half range of the angle, RMS of the speed, in the data (held) |
    | a_k, b_k, d_k | 1 | weights of angle and speed, and shift, of each neuron; the start spreads them |
    | c_k | 1 | weight of each neuron in the torque; zero at the start, so that the torque is exactly zero |

    As its weights are parameters, least squares and the compiled steps fit them as they fit physics; a
    ``residual_network`` may sit in any place, read more and remember, and is trained by the adjoint.

    Source: Y. Yin et al., APHYNITY, ICLR 2021 (physics plus a network of least norm).
    """

    kind = "residual_torque"
    S_r = Parameter(1.0, lower=1e-12, upper=1e9, unit="N m", doc="output scale", estimate=False)
    m_q = Parameter(0.0, lower=-1e6, upper=1e6, unit="rad", doc="middle of the angle", estimate=False)
    s_q = Parameter(1.0, lower=1e-9, upper=1e6, unit="rad", doc="half range of the angle", estimate=False)
    s_v = Parameter(1.0, lower=1e-9, upper=1e6, unit="rad/s", doc="RMS of the speed", estimate=False)
    a_1, a_2, a_3, a_4, a_5, a_6 = _weights("weight of the angle", (2.0, 1.0, -1.0, 0.5, 0.0, 0.0))
    b_1, b_2, b_3, b_4, b_5, b_6 = _weights("weight of the speed", (0.0, 0.5, 0.5, 0.0, 4.0, 1.0))
    d_1, d_2, d_3, d_4, d_5, d_6 = _weights("shift", (-1.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    c_1, c_2, c_3, c_4, c_5, c_6 = _weights("weight in the torque", (0.0,) * NEURONS)

    def torque(self, p: SimpleNamespace, angle: Tensor, speed: Tensor) -> Tensor:
        z, w = (angle - p.m_q) / p.s_q, speed / p.s_v
        found = torch.zeros_like(z)
        for k in range(1, NEURONS + 1):
            a, b, d, c = (getattr(p, f"{name}_{k}") for name in "abdc")
            found = found + c * torch.tanh(a * z + b * w + d)
        return p.S_r * found

"""Integral part of a servo's position loop."""

import torch

from hybrid_id.components.base import LoopStage, StateUpdate
from hybrid_id.parameters import Parameter


class ServoIntegral(LoopStage):
    """``dz/dt = w_i e'``, ``|z| <= z_max``: the loop's proportional part takes ``e' + z`` in the place of its error e'.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | z | rad | state: the error that has been gathered, seen at the gain k_p |
    | w_i = k_i / k_p | 1/s | integral over proportional gain; 0 is no integral |
    | z_max | rad | integrator limit: ``k_p z_max`` is the largest torque that it holds |

    A record that begins at rest begins with the z that holds the joint there without friction. The integral gathers on
    where the torque is limited, up to its own limit.

    Source: K. J. Astrom, T. Hagglund, PID Controllers, 2nd ed., 1995, sections 3.2 and 3.5 (integrator clamping);
    Dynamixel's and Feetech's register I.
    """

    kind = "servo_integral"
    states = ("gathered",)
    w_i = Parameter(1.0, upper=1e4, unit="1/s", doc="integral over proportional gain")
    z_max = Parameter(
        1.0, upper=1e3, unit="rad", doc="integrator limit over the proportional gain", estimate=False
    )

    def integral(self, p, state):
        return state

    def state_update(self, p, aim, error, speed, state):
        return StateUpdate(p.w_i * error, torch.zeros_like(error), -p.z_max, p.z_max)

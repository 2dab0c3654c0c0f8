"""What acts on a link from outside; torques at the joint [N m]."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals


@dataclass
class Gravity(Law):
    """``tau = -G sin(q_a - q_0)``; G [N m], q_0 [rad] where the load hangs down."""

    G: Lanes
    q_0: Lanes = 0.0

    def act(self, push: Push, x: Signals) -> None:
        push.torque = push.torque - self.G * np.sin(x.q_a - self.q_0)


@dataclass
class RestSpring(Law):
    """``tau = -k d - k_3 d^3`` with d = q_a - rest: a cable or hose; k [N m/rad], k_3 [N m/rad^3]."""

    k: Lanes
    rest: Lanes
    k_3: Lanes = 0.0

    def act(self, push: Push, x: Signals) -> None:
        twist = x.q_a - self.rest
        push.torque = push.torque - (self.k + self.k_3 * twist**2) * twist


@dataclass
class ConstantTorque(Law):
    """A bias [N m], of the rotor or of the link."""

    bias: Lanes

    def act(self, push: Push, x: Signals) -> None:
        push.torque = push.torque + self.bias

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

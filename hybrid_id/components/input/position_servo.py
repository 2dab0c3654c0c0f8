"""Position loop of a servo or of MuJoCo's position actuator, in torque at the joint."""

import torch

from hybrid_id.components.base import ServoLoop
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, Parameter


class PositionServo(ServoLoop):
    """``tau = clip(k_p e' - k_d w, -tau_max, tau_max)`` at the joint, ``e' = sgn e max(|e| - e_0, 0)``.

    ``e = clip(goal, goal_min, goal_max) - q``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | q, w | rad, rad/s | angle and speed of the link, which the servo's encoder reads |
    | k_p | N m/rad | stiffness: torque at the joint per error |
    | k_d | N m s/rad | damping by the loop, inside the limit only; viscous friction acts beyond it too |
    | tau_max | N m | largest torque, the motor's at full duty and standstill |
    | e_0 | rad | dead band: errors below it are left alone |
    | goal_min, goal_max | rad | angle limits of the servo, to which it clips its goal |

    A loop that sets the duty of a motor at constant supply gives the same law: ``tau_max`` is the stall torque, and
    the back-EMF, which acts whatever the duty, is part of viscous friction. The loop runs much faster than records
    are sampled; here it acts in continuous time on a goal that is held between samples.

    An integral, a rate limit of the goal and dead time within the loop are parts of their own beside it
    (``servo_integral``, ``goal_rate_limit``, ``loop_delay``).

    Reads channel ``goal`` [rad]. Source: MuJoCo's ``position`` actuator (kp, kv, forcerange); dead band as in servo
    registers (Feetech STS, Dynamixel).
    """

    kind = "position_servo"
    gives = "N m"
    channels = ("goal",)
    at_joint = True
    k_p = Parameter(10.0, lower=1e-6, upper=1e6, unit="N m/rad", doc="stiffness of the position loop")
    k_d = Parameter(0.0, upper=1e5, unit="N m s/rad", doc="damping of the position loop", estimate=False)
    tau_max = Parameter(1e6, lower=1e-6, upper=1e6, unit="N m", doc="largest torque", estimate=False)
    e_0 = Parameter(0.0, upper=1.0, unit="rad", doc="dead band of the error", estimate=False)
    goal_min = Parameter(-1e4, lower=-1e5, upper=1e5, unit="rad", doc="least goal", estimate=False)
    goal_max = Parameter(1e4, lower=-1e5, upper=1e5, unit="rad", doc="largest goal", estimate=False)

    def __init__(self, **values: float | Bounded) -> None:
        super().__init__(**values)
        low, high = (self.specs[name].value for name in ("goal_min", "goal_max"))
        if not low < high:
            raise InputError(
                f"{self.kind}: goal_min {low:g} rad is not below goal_max {high:g} rad; swap them."
            )

    def aim(self, p, channels):
        return torch.maximum(torch.minimum(channels["goal"], p.goal_max), p.goal_min)

    def error(self, p, channels, angle):
        error = self.aim(p, channels) - angle
        return torch.sign(error) * (error.abs() - p.e_0).clamp_min(0.0)

    def command(self, p, channels, angle, speed):
        beyond = self.with_integral(self.error(p, channels, angle), channels)
        return torch.maximum(torch.minimum(p.k_p * beyond - p.k_d * speed, p.tau_max), -p.tau_max)

    def mjcf(self, p):
        found = {"gainprm": (p.k_p,), "biasprm": (0.0, -p.k_p, -p.k_d)}
        ends = {"forcerange": (-p.tau_max, p.tau_max), "ctrlrange": (p.goal_min, p.goal_max)}
        top = {"forcerange": self.declared["tau_max"].default, "ctrlrange": self.declared["goal_max"].default}
        found |= {name: end for name, end in ends.items() if any(abs(float(e)) < top[name] for e in end)}
        return found, "is carried without its dead band" if float(p.e_0) > 0 else ""

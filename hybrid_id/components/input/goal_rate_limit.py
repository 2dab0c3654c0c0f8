"""Rate limit of a servo's goal."""

import torch

from hybrid_id.components.base import Effect, LoopStage, StateUpdate
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

FAR = 1e12
"""Beyond any goal [rad]."""


class GoalRateLimit(LoopStage):
    """``dg/dt = w_max sgn(goal - g)`` until g is the goal: the loop follows g, which moves no faster than w_max.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | g | rad | state: goal that the loop follows; a record begins with it at the goal |
    | w_max | rad/s | largest rate, at the joint for position_servo and at the motor for position_loop |

    Source: velocity-based profile of servo registers (Feetech's goal speed, Dynamixel's profile velocity) without an
    acceleration; rate limiter, e.g. K. J. Astrom, T. Hagglund, PID Controllers, 2nd ed., 1995, section 3.5.
    """

    kind = "goal_rate_limit"
    states = ("followed",)
    w_max = Parameter(5.0, lower=1e-6, upper=1e9, unit="rad/s", doc="largest rate of the goal")
    effect = Effect(
        "goal_rate_limit",
        "servo that follows its goal no faster than a profile allows; usually a register between 1 and 10 rad/s",
        "K. J. Astrom, T. Hagglund, PID Controllers, 2nd ed., Instrument Society of America, 1995",
        {
            "voltage_saturation": "steps of the goal with and without a load: a rate limit ends at one speed, a "
            "torque limit at one that the load changes",
            "delay": "the same sweep at two amplitudes: a rate limit counts for more the larger the move, a delay "
            "stays",
        },
        smoothness="kinks",
    )

    def goal(self, p, aim, state):
        return state

    def state_update(self, p, aim, error, speed, state):
        low = torch.where(aim <= state, aim, -FAR * torch.ones_like(aim))
        high = torch.where(aim >= state, aim, FAR * torch.ones_like(aim))
        return StateUpdate(p.w_max * torch.sign(aim - state), torch.zeros_like(aim), low, high)

    def start(self, p, aim, speed):
        return aim

    @staticmethod
    def starts(site):
        if site.servo is None:
            return []
        fast = site.speed / (site.ratio if site.servo.at_joint else 1.0)
        # a joint that overshoots the goal that it follows is up to several times as fast as that
        return [{"w_max": free(share * fast, 0.1 * fast, 20.0 * fast)} for share in (0.35, 0.8, 1.3)]

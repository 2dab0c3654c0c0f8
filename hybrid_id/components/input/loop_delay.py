"""Dead time within a servo's position loop."""

from hybrid_id.components.base import LoopStage, StateUpdate
from hybrid_id.components.sensor.sensor_delay import late_motion, trailing
from hybrid_id.parameters import Parameter


class LoopDelay(LoopStage):
    """``y = q + z``, ``dz/dt = -2 v - (2 / T_l) z``: the loop acts on the angle and the speed that were there T_l ago.

    It is the first Pade approximant of the dead time, as in ``sensor_delay``, of what the loop reads; what the record
    reads stays in time. A sampled loop has half its period of it, and all that it takes to measure and to compute. It
    takes ``k_p T_l`` from the loop's damping.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | q, v | rad, rad/s | angle and speed that the loop's encoder reads |
    | z | rad | state: how far the reading trails, ``-T_l v`` at constant speed |
    | T_l | s | dead time within the loop; ``delay`` is that of the goal |

    Source: e.g. G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed., 2015,
    section 5.6.3.
    """

    kind = "loop_delay"
    states = ("trail",)
    T_l = Parameter(0.002, lower=1e-4, upper=0.05, unit="s", doc="dead time within the loop")

    def reading(self, p, angle, speed, state):
        return late_motion(p.T_l, angle, speed, state)

    def state_update(self, p, aim, error, speed, state):
        return StateUpdate(*trailing(p.T_l, speed))

    def start(self, p, aim, speed):
        return -p.T_l * speed

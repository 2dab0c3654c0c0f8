"""Position loop of a hobby servo: the duty follows from the goal, so the simulation closes the loop itself."""

import math

from hybrid_id.components.base import ServoLoop
from hybrid_id.parameters import Parameter

XL330_DUTY_PER_RAD = 4096 / (2 * math.pi) / 256 / 885
"""Firmware of the Dynamixel XL-330: encoder counts per rad, gain divider, full PWM count."""


class PositionLoop(ServoLoop):
    """Proportional firmware loop ``U = clip(c * gain * (goal - q), -1, 1) * supply`` [V].

    | symbol | unit | meaning |
    | --- | --- | --- |
    | c = duty_per_rad | 1/rad | duty per rad of error at gain 1 (a firmware constant) |

    Reads channels ``goal`` [rad], ``gain`` [1] and ``supply`` [V]. Source: Dynamixel XL-330 firmware as verified
    on the logs of Rhoban BAM (Duclusaud et al., ICRA 2025, arXiv 2410.08650). The loop runs at 1 kHz or faster in
    the servo; here it acts in continuous time.
    """

    kind = "position_loop"
    channels = ("goal", "gain", "supply")
    duty_per_rad = Parameter(XL330_DUTY_PER_RAD, unit="1/rad", doc="duty per error and gain", estimate=False)

    def command(self, p, channels, angle, speed):
        error = self.with_integral(self.error(p, channels, angle), channels)
        duty = p.duty_per_rad * channels["gain"] * error
        return duty.clamp(-1.0, 1.0) * channels["supply"]

"""A rotor that no law drives."""

from hybrid_id.components.base import Motor


class FreeRotor(Motor):
    """``tau_m = 0``: the command reaches nothing but what acts beside the motor, a network above all.

    With it a network alone makes the accelerations: a neural ODE without physics, see
    :mod:`hybrid_id.systems.builders`. No parameter and no state; it takes a command of any unit.
    """

    kind = "free_rotor"
    takes = ""

    def torque(self, p, command, speed):
        return 0.0 * command

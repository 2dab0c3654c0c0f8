"""A current sensor that knows no sign."""

from hybrid_id.components.base import Sensor
from hybrid_id.parameters import Parameter


class UnsignedCurrent(Sensor):
    """Current sensor of a servo that reports the size alone, ``y = |i| + i_0`` [A], on channel ``i``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | i_0 | A | reading without motor current: the electronics' own |

    The motor has a current (``dc_motor``, ``current_motor``, ``torque_motor``).
    """

    kind = "unsigned_current"
    channel = "i"
    i_0 = Parameter(0.0, upper=10.0, unit="A", doc="reading without motor current", estimate=False)

    def read(self, p, value):
        return value.abs() + p.i_0

"""Joint torque sensor."""

from hybrid_id.components.base import Sensor
from hybrid_id.parameters import Parameter


class TorqueSensor(Sensor):
    """``y = g tau_a + tau_0`` on channel ``tau_a``, tau_a [N m] the torque that passes the gear to the link.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | g | 1 | gain of the sensor |
    | tau_0 | N m | reading without torque |

    Source: strain gauges between gear and link, e.g. A. Albu-Schaffer, C. Ott, G. Hirzinger, A unified passivity-based
    control framework for position, torque and impedance control of flexible joint robots, Int. J. Robotics Research
    26(1), 2007.
    """

    kind = "torque_sensor"
    channel = "tau_a"
    g = Parameter(1.0, lower=1e-3, upper=1e3, unit="1", doc="gain", estimate=False)
    tau_0 = Parameter(0.0, lower=-1e4, upper=1e4, unit="N m", doc="reading without torque")

    def read(self, p, value):
        return p.g * value + p.tau_0

    def mjcf(self, p):
        return {}, "is left out, the exported model has no torque sensor"

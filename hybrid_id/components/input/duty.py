"""PWM duty times the measured supply."""

from hybrid_id.components.base import Input


class DutySupply(Input):
    """A PWM amplifier: ``U = duty * supply`` [V].

    Reads channels ``duty`` [1], within [-1, 1], and ``supply`` [V].
    """

    kind = "duty_supply"
    channels = ("duty", "supply")

    def command(self, p, channels, angle, speed):
        return channels["duty"] * channels["supply"]

"""Commanded voltage, held between samples."""

from hybrid_id.components.base import Input


class Voltage(Input):
    """The logged voltage acts as it was commanded: ``U = u`` [V] (paper, eq. 3: U).

    Reads channel ``u`` [V].
    """

    kind = "voltage"
    channels = ("u",)

    def command(self, p, channels, angle, speed):
        return channels["u"]

    def mjcf(self, p):
        return {}, ""

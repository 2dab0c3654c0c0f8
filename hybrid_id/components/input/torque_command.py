"""Commanded torque."""

from hybrid_id.components.base import Input


class TorqueCommand(Input):
    """A drive with an inner torque loop: the command is the motor torque itself. Reads channel ``tau`` [N m]."""

    kind = "torque_command"
    gives = "N m"
    channels = ("tau",)

    def command(self, p, channels, angle, speed):
        return channels["tau"]

    def mjcf(self, p):
        return {}, ""

"""Commanded current."""

from hybrid_id.components.base import Input


class CurrentCommand(Input):
    """A drive with an inner current loop: the command is the winding current. Reads channel ``i`` [A]."""

    kind = "current_command"
    gives = "A"
    channels = ("i",)

    def command(self, p, channels, angle, speed):
        return channels["i"]

    def mjcf(self, p):
        return {}, ""

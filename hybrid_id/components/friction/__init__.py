"""Friction laws: speed to a torque of its sign."""

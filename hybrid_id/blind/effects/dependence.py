"""Effects of friction that depends on more than its direction: drag, load, angle."""

import numpy as np

from hybrid_id.blind.effects.base import Effect, dry, fast
from hybrid_id.blind.physics.friction import LoadDependent, PositionDependent, Power


class MotorDrag(Effect):
    """Drag with the square of the rotor's speed."""

    name, place, sized = "quadratic_drag", "motor_friction", ("F",)
    size_keys = {"F": "newton_metre_seconds2"}

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"F": dry(robot, joint) * rng.uniform(0.3, 2.0) / fast(robot, joint) ** 2})

    def install(self, machine, robot):
        self.drive(machine).rotor_laws.append(Power(self.values["F"]))


class LinkDrag(Effect):
    """Drag with the square of the link's speed, behind a flexible gear."""

    name, place, sized = "quadratic_drag", "link_friction", ("F",)
    systems, size_keys = ("one_link_flexible",), {"F": "newton_metre_seconds2_link"}

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = fast(robot, joint) / robot.ratio[joint]
        return cls(joint, {"F": dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 2.0) / speed**2})

    def install(self, machine, robot):
        self.drive(machine).link_laws.append(Power(self.values["F"], on_link=True))


class LoadFriction(Effect):
    """Dry friction with the torque that the gear carries."""

    name, place, sized, size_keys = (
        "load_dependent_friction",
        "motor_friction",
        ("mu",),
        {"mu": "share_of_torque"},
    )
    by_effort = False

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"mu": rng.uniform(0.05, 0.3)})

    def install(self, machine, robot):
        mu = np.minimum(self.values["mu"], 0.6)
        self.drive(machine).rotor_laws.append(LoadDependent(mu, self.by_effort))


class EffortFriction(LoadFriction):
    """Dry friction with the torque of the motor."""

    place, by_effort = "motor_friction", True


class AngleFriction(Effect):
    """Dry friction that waves over the joint's angle."""

    name, place, sized = "position_dependent_friction", "motor_friction", ("amplitude",)
    size_keys = {"amplitude": "newton_metres", "periods": "periods_per_joint_turn"}
    shapes, signed = ("periods", "phase"), ("phase",)
    spot = False

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(
            joint,
            {
                "amplitude": dry(robot, joint) * rng.uniform(0.3, 1.2),
                "periods": float(rng.integers(1, 9)),
                "phase": rng.uniform(0, 2 * np.pi),
            },
        )

    def install(self, machine, robot):
        v = self.values
        law = PositionDependent(v["amplitude"], v["periods"], v["phase"], self.spot)
        self.drive(machine).rotor_laws.append(law)


class TightSpot(AngleFriction):
    """Dry friction in one narrow range of the joint's angle."""

    place, spot = "motor_friction", True

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(
            joint,
            {
                "amplitude": dry(robot, joint) * rng.uniform(0.5, 2.0),
                "periods": rng.uniform(3.0, 8.0),
                "phase": rng.uniform(-0.3, 0.3),
            },
        )


class LinkAngleFriction(AngleFriction):
    """The same at the bearing of a link behind a flexible gear."""

    place, systems = "link_friction", ("one_link_flexible",)

    def install(self, machine, robot):
        v = self.values
        amplitude = v["amplitude"] * robot.ratio[self.joint]
        law = PositionDependent(amplitude, v["periods"], v["phase"], on_link=True)
        self.drive(machine).link_laws.append(law)

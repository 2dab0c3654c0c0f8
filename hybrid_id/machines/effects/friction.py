"""Effects of friction, on either side of the gear."""

import numpy as np

from hybrid_id.machines.effects.base import Effect, choice, dry, dry_at_link, fast, uniform
from hybrid_id.machines.physics.friction import Coulomb, LuGre, MaxwellSlip, Power


def without(drive, kind):
    """Take the laws of a kind off a rotor and give the first of them back."""
    found = [law for law in drive.rotor_laws if isinstance(law, kind)]
    drive.rotor_laws = [law for law in drive.rotor_laws if not isinstance(law, kind)]
    return found[0]


class WithheldCoulomb(Effect):
    """Dry friction of the motor that the nominal model does without."""

    name, place, sized = "coulomb_friction", "motor_friction", ("F_c",)
    drawn = {"F_c": uniform(0.7, 1.5, dry)}

    def alter(self, robot):
        name = robot.name(self.joint, "F_c")
        return robot.with_values({name: self.values["F_c"]}, withheld=True)


class WithheldSmoothCoulomb(WithheldCoulomb):
    """The same as a steep smooth law, ``F_c tanh(v / 0.4)``, which creeps where a set-valued one sticks."""

    replaces = True

    def install(self, machine, robot):
        without(self.drive(machine), Coulomb)
        super().install(machine, robot)

    def act(self, push, x):
        ratio = np.abs(x.v_m) / 0.4
        secant = np.where(ratio > 1e-6, np.tanh(ratio) / np.maximum(ratio, 1e-6), 1.0)
        push.slope = push.slope + self.values["F_c"] / 0.4 * secant


class LinkCoulomb(Effect):
    """Dry friction of the link's bearing behind a flexible gear."""

    name, place, sized, systems = "coulomb_friction", "link_friction", ("F_c",), ("one_link_flexible",)
    drawn = {"F_c": uniform(0.3, 1.2, dry_at_link)}
    made = Coulomb


class WithheldLinkViscous(Effect):
    """Viscous friction of the link's bearing that the nominal model does without."""

    name, place, sized = "viscous_friction", "link_friction", ("F_va",)
    systems = ("one_link_flexible",)
    drawn = {"F_va": uniform(1.0, 4.0, lambda robot, joint: robot.values["F_va"])}

    def alter(self, robot):
        return robot.with_values({"F_va": self.values["F_va"]}, withheld=True)


class StribeckGaussian(Effect):
    """Breakaway above Coulomb, ``drop exp(-(v / v_s)^2)`` (Bo and Pavelescu)."""

    name, place, sized = "stribeck_friction", "motor_friction", ("drop",)
    shapes = ("v_s",)
    drawn = {"drop": uniform(0.2, 1.0, dry), "v_s": uniform(4.0, 40.0, log=True)}

    def act(self, push, x):
        push.dry(self.values["drop"] * self.share(np.abs(x.v_m) / self.values["v_s"]))

    def share(self, ratio):
        """What is left of the breakaway at a speed relative to v_s."""
        return np.exp(-(ratio**2))


class StribeckExponential(StribeckGaussian):
    """The same, exponential in the speed (Tustin)."""

    def share(self, ratio):
        return np.exp(-ratio)


class StribeckLorentzian(StribeckGaussian):
    """The same, with a long tail, ``1 / (1 + x^2)`` (Hess and Soom)."""

    def share(self, ratio):
        return 1 / (1 + ratio**2)


class UnevenDry(Effect):
    """Dry friction higher forwards than backwards, by ``excess`` [N m]."""

    name, place, sized = "asymmetric_friction", "motor_friction", ("excess",)
    signed = ("excess", "slope")
    drawn = {"excess": uniform(0.2, 0.9, dry, either=True)}

    def act(self, push, x):
        # at most 1.9 times the level itself, so that friction opposes motion both ways
        most, steepest = 1.9 * dry(self.robot, self.joint), 1.9 * self.robot.value(self.joint, "F_v")
        excess = np.clip(self.values["excess"], -most, most)
        push.plus = push.plus + 0.5 * excess
        push.minus = push.minus - 0.5 * excess
        if "slope" in self.values:
            slope = np.clip(self.values["slope"], -steepest, steepest)
            push.torque = push.torque - 0.5 * slope * np.abs(x.v_m)


class UnevenBoth(UnevenDry):
    """Dry friction, and viscous friction by ``slope`` [N m s/rad], that differ with the direction."""

    sized = ("excess", "slope")

    @classmethod
    def draw(cls, rng, robot, joint):
        side = rng.choice([-1, 1])
        excess = side * dry(robot, joint) * rng.uniform(0.2, 0.7)
        slope = side * robot.value(joint, "F_v") * rng.uniform(0.2, 0.6)
        return cls(joint, {"excess": excess, "slope": slope})


class PreslidingDahl(Effect):
    """The dry friction builds up over a deflection: Dahl's law in Coulomb's place."""

    name, place, sized = "presliding_friction", "motor_friction", ("deflection",)
    replaces = True
    drawn = {"deflection": uniform(0.3, 4.0, log=True)}
    made = LuGre

    def install(self, machine, robot):
        drive = self.drive(machine)
        level = without(drive, Coulomb).F_c
        drive.rotor_laws.append(self.made(level, level / self.values["deflection"], **self.options))


class PreslidingLuGre(PreslidingDahl):
    """LuGre's bristles with a little damping of their own."""

    options = {"settling": 0.01}


class PreslidingMaxwell(PreslidingDahl):
    """Springs that slide one after the other."""

    made = MaxwellSlip


class MotorDrag(Effect):
    """Drag with the square of the rotor's speed."""

    name, place, sized = "quadratic_drag", "motor_friction", ("F",)
    drawn = {"F": uniform(0.3, 2.0, lambda robot, joint: dry(robot, joint) / fast(robot, joint) ** 2)}
    made = Power


class LinkDrag(Effect):
    """Drag with the square of the link's speed, behind a flexible gear."""

    name, place, sized = "quadratic_drag", "link_friction", ("F",)
    systems = ("one_link_flexible",)
    drawn = {
        "F": uniform(
            0.3,
            2.0,
            lambda robot, joint: dry(robot, joint) * robot.ratio[joint] ** 3 / fast(robot, joint) ** 2,
        )
    }
    made, options = Power, {"on_link": True}


class LoadFriction(Effect):
    """Dry friction ``mu |tau|`` with the torque that the gear carries."""

    name, place, sized = "load_dependent_friction", "motor_friction", ("mu",)
    drawn = {"mu": uniform(0.05, 0.3)}
    needs_carried = True

    def act(self, push, x):
        push.dry(np.minimum(self.values["mu"], 0.6) * np.abs(x.carried if self.needs_carried else x.effort))


class EffortFriction(LoadFriction):
    """Dry friction with the torque of the motor."""

    needs_carried = False


class AngleFriction(Effect):
    """Dry friction that waves over the joint's angle: ``A (1 + sin(n q + phase))``."""

    name, place, sized = "position_dependent_friction", "motor_friction", ("amplitude",)
    shapes, signed = ("periods", "phase"), ("phase",)
    drawn = {
        "amplitude": uniform(0.3, 1.2, dry),
        "periods": choice(range(1, 9)),
        "phase": uniform(0, 2 * np.pi),
    }

    def act(self, push, x):
        push.dry(
            self.values["amplitude"] * (1.0 + np.sin(self.values["periods"] * x.q_a + self.values["phase"]))
        )


class TightSpot(AngleFriction):
    """Dry friction in one narrow range of the joint's angle: ``A exp(-(n (q - phase))^2)``."""

    drawn = {
        "amplitude": uniform(0.5, 2.0, dry),
        "periods": uniform(3.0, 8.0),
        "phase": uniform(-0.3, 0.3),
    }

    def act(self, push, x):
        v = self.values
        push.dry(v["amplitude"] * np.exp(-((v["periods"] * (x.q_a - v["phase"])) ** 2)))


class LinkAngleFriction(AngleFriction):
    """The same at the bearing of a link behind a flexible gear."""

    place, systems = "link_friction", ("one_link_flexible",)

    def law(self, robot):
        amplitude = self.values["amplitude"] * robot.ratio[self.joint]
        return self.with_values({"amplitude": amplitude})

"""Random robots: their true parameters, and the simulator that somebody uses for them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid_id.machines.physics.friction import Coulomb, Viscous
from hybrid_id.machines.physics.law import Lanes
from hybrid_id.machines.physics.load import Gravity
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink, TwoLinks
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.transmission import Gear, LinearSpring
from hybrid_id.records.dataset import Channel

if TYPE_CHECKING:
    from hybrid_id.machines.effects import Effect

SYSTEMS = ("one_link", "one_link_flexible", "two_link")
UNITS = {
    "J": "kg m^2",
    "k": "N m/rad",
    "d": "N m s/rad",
    "F_c": "N m",
    "F_v": "N m s/rad",
    "G": "N m",
    "P_m1": "N m/V",
    "P_m2": "V s/rad",
    "P": "kg m^2",
}


@dataclass(frozen=True)
class Robot:
    """One machine.

    Attributes:
        system: one_link, one_link_flexible or two_link.
        ratio: motor turns per joint turn, each joint.
        vertical: whether the arm moves in the field of gravity.
        values: true parameters by the names of the model file; zero where the machine lacks one.
        rotor_share: rotor's part of what the motor turns, each joint.
        supply: voltage that the amplifier is built for [V].
        link_encoder: whether the link has an encoder of its own.
        moments: mass times distance of each link of an arm [kg m], for tilts.
        lacks: parameters that the machine has and the nominal model does not.
    """

    system: str
    ratio: tuple[float, ...]
    vertical: bool
    values: Mapping[str, Lanes]
    rotor_share: tuple[float, ...]
    supply: float
    link_encoder: bool = False
    moments: tuple[float, float] = (0.0, 0.0)
    lacks: frozenset[str] = frozenset()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.ratio)

    def name(self, joint: int, symbol: str) -> str:
        """Name of a drive's parameter (P_m1, P_m2, F_c, F_v of the motor) in the model file."""
        if self.system == "one_link":
            return symbol
        if self.system == "one_link_flexible":
            return {"F_c": "F_cm", "F_v": "F_vm"}.get(symbol, symbol)
        return f"{symbol}m{joint + 1}"

    def value(self, joint: int, symbol: str) -> Any:
        """True value of a drive's parameter."""
        return self.values[self.name(joint, symbol)]

    def inertia(self, joint: int) -> Any:
        """What motor `joint` turns when its own gear is rigid and the arm is stretched, at the motor [kg m^2]."""
        if self.system == "one_link":
            return self.values["J"]
        if self.system == "one_link_flexible":
            return self.values["J_m"] + self.values["J_a"] / self.ratio[0] ** 2
        own = self.values["P_1"] + 2 * self.values["P_3"] if joint == 0 else self.values["P_2"]
        return own / self.ratio[joint] ** 2

    @property
    def free(self) -> list[str]:
        """Parameters that records can tell: all but one torque constant (scale) and the motors' viscous frictions."""
        held = {self.name(0, "P_m1"), *(self.name(i, "F_v") for i in range(self.joints)), *self.lacks}
        return [
            name for name, value in self.values.items() if name not in held and np.all(np.asarray(value) > 0)
        ]

    @property
    def inputs(self) -> list[Channel]:
        """Channels of the commands."""
        return [Channel(f"u{i + 1}", "V") for i in range(self.joints)]

    @property
    def outputs(self) -> list[str]:
        """Names of the encoders' channels."""
        return [f"q_m{i + 1}" for i in range(self.joints)] + ["q_a1"] * self.link_encoder

    def drifted(self, factor: np.ndarray) -> "Robot":
        """The robot whose motors' friction is off by a factor (n_joints, B)."""
        names = [(i, self.name(i, symbol)) for i in range(self.joints) for symbol in ("F_c", "F_v")]
        return self.with_values({name: self.values[name] * factor[i] for i, name in names})

    def places(self, effect: "Effect") -> list[str]:
        """Places of an effect that physics alone cannot tell apart."""
        if self.system == "two_link" and effect.name in ("gravity_load", "joint_coupling"):
            return ["joint1/load", "joint2/load"]
        if effect.place == "motor_friction" and self.system != "one_link_flexible":
            return [effect.where, effect.where.replace("motor_friction", "link_friction")]
        return [effect.where]

    def with_values(self, values: Mapping[str, Lanes], *, withheld: bool = False) -> "Robot":
        """The same robot with some parameters replaced, which the nominal model may lack."""
        lacks = self.lacks | set(values) if withheld else self.lacks
        return replace(self, values={**self.values, **values}, lacks=lacks)

    def assemble(self, *, substeps: int = 8) -> Machine:
        """The machine without any effect."""
        drives = []
        for i, ratio in enumerate(self.ratio):
            motor = Motor(self.value(i, "P_m1"), self.value(i, "P_m2"))
            drive = Drive(Gear(ratio), self._rotor(i), motor)
            drive.rotor_laws = [Coulomb(self.value(i, "F_c")), Viscous(self.value(i, "F_v"))]
            drives.append(drive)
        if self.system == "one_link":
            links: OneLink | TwoLinks = OneLink(
                (1 - self.rotor_share[0]) * self.values["J"] * self.ratio[0] ** 2
            )
            if self.vertical:
                drives[0].link_laws.append(Gravity(self.values["G_l"]))
        elif self.system == "one_link_flexible":
            links = OneLink(self.values["J_a"])
            drives[0].spring = LinearSpring(self.values["k"], self.values["d"])
            drives[0].link_laws.append(Viscous(self.values["F_va"]))
        else:
            v = self.values
            links = TwoLinks(v["P_1"] - self._rotor(0) * self.ratio[0] ** 2, v["P_4"], v["P_3"])
        return Machine(drives, links, substeps=substeps)

    def _rotor(self, joint: int) -> Any:
        """Inertia of a rotor alone [kg m^2]."""
        if self.system == "one_link":
            return self.rotor_share[0] * self.values["J"]
        if self.system == "one_link_flexible":
            return self.values["J_m"]
        if joint == 1:
            return (self.values["P_2"] - self.values["P_4"]) / self.ratio[1] ** 2
        return self.rotor_share[0] * self.values["P_1"] / self.ratio[0] ** 2

    def model(self, rng: np.random.Generator, error: float) -> dict[str, Any]:
        """Today's simulator as the content of a model file, its nominal values wrong by up to `error`."""
        wrong = {name: float(value) * (1 + rng.uniform(-error, error)) for name, value in self.values.items()}
        while self.system == "two_link" and not _has_mass(wrong):
            wrong |= {
                n: float(self.values[n]) * (1 + rng.uniform(-error, error))
                for n in ("P_1", "P_2", "P_3", "P_4")
            }
        parameters = {}
        for name, value in self.values.items():
            if name in self.lacks or not float(value) > 0:
                continue
            nominal = _rounded(wrong[name], 4)
            parameters[name] = {
                "nominal": nominal,
                "lower": _rounded(nominal / 4, 3),
                "upper": _rounded(4 * nominal, 3),
                "unit": UNITS[next(p for p in sorted(UNITS, key=len, reverse=True) if name.startswith(p))],
            }
        return {
            "system": self.system,
            "gear_ratio": list(self.ratio),
            "gravity": "vertical" if self.vertical else "none",
            "parameters": parameters,
        }


def _has_mass(values: Mapping[str, float]) -> bool:
    """Whether an arm's inertias have a rotor at the second joint and a mass matrix at every angle."""
    P_1, P_2, P_3, P_4 = (values[f"P_{k}"] for k in (1, 2, 3, 4))
    return P_4 < 0.95 * P_2 and all((P_1 + 2 * s * P_3) * P_2 > 1.05 * (P_4 + s * P_3) ** 2 for s in (-1, 1))


def draw_robot(rng: np.random.Generator, system: str) -> Robot:
    """Draw a robot of a system: geared DC motors of 5 to 100 W and links of 0.1 to 5 kg."""
    ratio = tuple(round(log_uniform(rng, 30, 160), 1) for _ in range(2 if system == "two_link" else 1))
    supply = float(rng.choice([12.0, 24.0, 24.0, 36.0, 48.0]))
    if system == "one_link":
        vertical = bool(rng.random() < 0.35)
        inertia = log_uniform(rng, 9e-6, 8e-5)
        drive = _draw_motor(rng, inertia, ratio[0], supply)
        values = {"J": inertia, **drive}
        if vertical:
            # less than a third of the stall torque
            values["G_l"] = ratio[0] * drive["P_m1"] * supply * rng.uniform(0.06, 0.3)
        share = (rng.uniform(0.3, 0.75),)
        return Robot(system, ratio, vertical, values, share, supply)
    if system == "one_link_flexible":
        rotor = log_uniform(rng, 7e-6, 3e-5)
        link = rotor * ratio[0] ** 2 * rng.uniform(0.6, 2.5)
        k = link * (2 * np.pi * rng.uniform(2.5, 7.0)) ** 2
        drive = _draw_motor(rng, rotor + link / ratio[0] ** 2, ratio[0], supply)
        values = {
            "J_m": rotor,
            "J_a": link,
            "k": k,
            "d": 2 * rng.uniform(0.03, 0.15) * np.sqrt(k * link),
            "F_cm": drive["F_c"],
            "F_vm": drive["F_v"],
            "F_va": 2 * rng.uniform(0.02, 0.08) * np.sqrt(k * link),
            "P_m1": drive["P_m1"],
            "P_m2": drive["P_m2"],
        }
        encoder = bool(rng.random() < 0.4)
        return Robot(system, ratio, False, values, (rotor / (rotor + link / ratio[0] ** 2),), supply, encoder)
    # links of given lengths and masses, each a uniform rod with a load at its end
    l_1, l_2 = rng.uniform(0.2, 0.4, 2)
    m_1, m_2 = log_uniform(rng, 0.5, 3), log_uniform(rng, 0.3, 1.5)
    load = rng.uniform(0.1, 1.0)
    second = m_2 * l_2**2 / 3 + load * l_2**2
    third = l_1 * (m_2 * l_2 / 2 + load * l_2)
    first = m_1 * l_1**2 / 3 + (m_2 + load) * l_1**2 + second
    rotor_1, rotor_2 = first * rng.uniform(0.4, 2.0), second * rng.uniform(0.4, 1.5)
    values = {"P_1": first + rotor_1, "P_2": second + rotor_2, "P_3": third, "P_4": second}
    seen = (values["P_1"] + third, values["P_2"])
    for i in range(2):
        drive = _draw_motor(rng, seen[i] / ratio[i] ** 2, ratio[i], supply)
        values |= {f"{name}m{i + 1}": value for name, value in drive.items()}
    share = (rotor_1 / values["P_1"], rotor_2 / values["P_2"])
    moments = (m_1 * l_1 / 2 + (m_2 + load) * l_1, m_2 * l_2 / 2 + load * l_2)
    return Robot("two_link", ratio, False, values, share, supply, moments=moments)


def _draw_motor(rng: np.random.Generator, inertia: float, ratio: float, supply: float) -> dict[str, float]:
    """A motor that suits an inertia [kg m^2 at the rotor], with the friction of its gear."""
    back_emf = supply / (ratio * rng.uniform(3.0, 9.0))  # no-load speed of the joint [rad/s]
    lag = log_uniform(rng, 0.018, 0.07)  # mechanical time constant [s]
    damping, viscous = inertia / lag, rng.uniform(0.06, 0.3)
    gain = (1 - viscous) * damping / back_emf
    return {
        "P_m1": gain,
        "P_m2": back_emf,
        "F_c": gain * supply * rng.uniform(0.015, 0.06),
        "F_v": viscous * damping,
    }


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two limits, evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")

"""The kinds of machine that a twin can be: their parameters, their equations of motion, and their model files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_id.twin.arm import TwoLinkArm
from hybrid_id.twin.automaton import Mechanism
from hybrid_id.twin.drive import RigidDrive
from hybrid_id.twin.flexible import FlexibleDrive
from hybrid_id.twin.friction import AsymmetricStribeck, LinkFriction, Stribeck
from hybrid_id.twin.rotor import Rotor, TorqueRipple
from hybrid_id.twin.spring import BacklashFlexibility

Values = Mapping[str, Any]

MOTOR = ("P_m1", "P_m2")
FRICTION = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3")
#: Of these, what wears, warms and settles from run to run.
DRIFTING = ("f_11", "f_12", "f_21", "f_22", "f_3")
#: Speeds at which friction peaks, which may have either sign; no other parameter is ever below zero.
PEAK_SPEEDS = ("f_13", "f_23")
#: What divides, or would leave no machine at zero.
POSITIVE = ("J", "J_m", "J_a", "P_m1", "f_14", "f_24", "k", "alpha", "beta", "P_1", "P_2")
#: A joint that is held: friction that nothing overcomes.
HELD = Stribeck(F_c=1e6, F_s=1e6)


@dataclass(frozen=True)
class Machine:
    """What the twin needs to know of one kind of machine.

    Attributes:
        system: its name in model files.
        parameters: the names of its parameters, in the order of the paper's table.
        motors: what is appended to the names of each motor's own parameters.
        rows: its state, angles and speeds by name; `_m` at a motor, `_a` at a link.
        build: mechanism for parameters (B,), gear ratios and the ripple of each motor.
        components: (place, kind, parameters there by name) of its model file beyond the flat parameters.
    """

    system: str
    parameters: tuple[str, ...]
    motors: tuple[str, ...]
    rows: tuple[str, ...]
    build: Callable[[Values, Sequence[float], Sequence[TorqueRipple]], Mechanism]
    components: tuple[tuple[str, str, Mapping[str, str]], ...]

    @property
    def drifting(self) -> tuple[str, ...]:
        """Parameters that drift from run to run."""
        on_motors = (name + motor for motor in self.motors for name in DRIFTING)
        return (*on_motors, *(name for name in self.parameters if name in ("f_a1", "f_a2")))

    def symbol(self, name: str) -> str:
        """A parameter's name without the motor that it belongs to."""
        return next((name.removesuffix(m) for m in self.motors if m and name.endswith(m)), name)


def _rotor(values: Values, motor: str, ripple: TorqueRipple, *, held: bool = False) -> dict[str, Any]:
    """Fields of a `Rotor` out of the parameters of one motor."""
    of_motor = {name: values[name + motor] for name in (*MOTOR, *FRICTION)}
    viscous = of_motor.pop("f_3")
    constants = {name: of_motor.pop(name) for name in MOTOR}
    return {
        **constants,
        "f_3": viscous,
        "dry": HELD if held else AsymmetricStribeck(**of_motor),
        "ripple": ripple,
    }


def _one_link(values: Values, gear_ratio: Sequence[float], ripples: Sequence[TorqueRipple]) -> RigidDrive:
    return RigidDrive(J=values["J"], r=gear_ratio[0], **_rotor(values, "", ripples[0]))


def _flexible(values: Values, gear_ratio: Sequence[float], ripples: Sequence[TorqueRipple]) -> FlexibleDrive:
    return FlexibleDrive(
        rotor=Rotor(**_rotor(values, "", ripples[0])),
        J_m=values["J_m"],
        J_a=values["J_a"],
        spring=BacklashFlexibility(values["k"], values["alpha"], values["beta"]),
        link_friction=LinkFriction(values["f_a1"], values["f_a2"]),
        r=gear_ratio[0],
    )


def _two_link(held: int | None) -> Callable[[Values, Sequence[float], Sequence[TorqueRipple]], TwoLinkArm]:
    def build(values: Values, gear_ratio: Sequence[float], ripples: Sequence[TorqueRipple]) -> TwoLinkArm:
        rotors = {
            f"rotor_{i}": Rotor(**_rotor(values, f"m{i}", ripples[i - 1], held=held == i)) for i in (1, 2)
        }
        masses = {name: values[name] for name in ("P_1", "P_2", "P_3", "P_4")}
        return TwoLinkArm(**rotors, **masses, r_1=gear_ratio[0], r_2=gear_ratio[1])

    return build


def _friction(joint: int, motor: str = "") -> tuple[str, str, dict[str, str]]:
    """The motor friction of one joint in a model file."""
    return f"joint{joint}/motor_friction", "asymmetric_stribeck", {name: name + motor for name in FRICTION}


def _itself(*names: str) -> dict[str, str]:
    return {name: name for name in names}


ONE_LINK = Machine(
    "one_link", ("J", *MOTOR, *FRICTION), ("",), ("q_m1", "v_m1"), _one_link, components=(_friction(1),)
)
ONE_LINK_FLEXIBLE = Machine(
    "one_link_flexible",
    ("J_m", "J_a", *MOTOR, "f_a1", "f_a2", "k", "alpha", "beta", *FRICTION),
    ("",),
    ("q_m1", "v_m1", "q_a1", "v_a1"),
    _flexible,
    components=(
        _friction(1),
        ("joint1/transmission", "backlash_flexibility", _itself("k", "alpha", "beta")),
        ("joint1/link_friction", "asymmetric_tanh", _itself("f_a1", "f_a2")),
    ),
)


def two_link(held: int | None = None) -> Machine:
    """The arm, one of its joints held where `held` says which."""
    return Machine(
        "two_link",
        (
            *(name + motor for motor in ("m1", "m2") for name in (*MOTOR, *FRICTION)),
            *("P_1", "P_2", "P_3", "P_4"),
        ),
        ("m1", "m2"),
        ("q_m1", "v_m1", "q_m2", "v_m2"),
        _two_link(held),
        components=(_friction(1, "m1"), _friction(2, "m2")),
    )


def start_state(machine: Machine, angles: np.ndarray, gear_ratio: Sequence[float]) -> np.ndarray:
    """State at rest (n_x, B) with the motors at these angles (n_motors, B) [rad] and no spring deflected."""
    state = np.zeros((len(machine.rows), angles.shape[1]))
    for i, (angle, ratio) in enumerate(zip(angles, gear_ratio, strict=True), start=1):
        for row, per_turn in ((f"q_m{i}", 1.0), (f"q_a{i}", ratio)):
            if row in machine.rows:
                state[machine.rows.index(row)] = angle / per_turn
    return state

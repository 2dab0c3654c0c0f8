"""What a model file may hold: its keys, and the flat parameter names of each system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StrictBool,
    field_validator,
    model_validator,
)

from hybrid_id.components.base import PLACES, REGISTRY, Component
from hybrid_id.components.input.voltage import Voltage
from hybrid_id.components.load.one_link import OneLink, TwoInertias
from hybrid_id.components.load.two_link import LinkInertia
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.components.transmission.linear_spring import LinearSpring
from hybrid_id.components.transmission.rigid import Rigid
from hybrid_id.records.yaml_file import FileName, one_of
from hybrid_id.systems.servos import SERVOS

ParameterPlace = tuple[str, str, str]
"""Place, kind and symbol that a flat name stands for."""

FLAT: dict[str, dict[str, ParameterPlace]] = {
    "one_link": {
        "J": ("joint1/load", "one_link", "J"),
        "rotor_share": ("joint1/load", "one_link", "rotor_share"),
        "P_m1": ("joint1/motor", "dc_motor", "P_m1"),
        "P_m2": ("joint1/motor", "dc_motor", "P_m2"),
        "F_c": ("joint1/motor_friction", "coulomb_friction", "F_c"),
        "F_v": ("joint1/motor_friction", "viscous_friction", "F_v"),
        "G_l": ("joint1/load", "gravity_load", "G_l"),
        "q_0": ("joint1/load", "gravity_load", "q_0"),
    },
    "one_link_flexible": {
        "J_m": ("joint1/load", "two_inertias", "J_m"),
        "J_a": ("joint1/load", "two_inertias", "J_a"),
        "k": ("joint1/transmission", "linear_spring", "k"),
        "d": ("joint1/transmission", "linear_spring", "d"),
        "P_m1": ("joint1/motor", "dc_motor", "P_m1"),
        "P_m2": ("joint1/motor", "dc_motor", "P_m2"),
        "F_cm": ("joint1/motor_friction", "coulomb_friction", "F_c"),
        "F_vm": ("joint1/motor_friction", "viscous_friction", "F_v"),
        "F_ca": ("joint1/link_friction", "coulomb_friction", "F_c"),
        "F_va": ("joint1/link_friction", "viscous_friction", "F_v"),
        "G_l": ("joint1/load", "gravity_load", "G_l"),
        "q_0": ("joint1/load", "gravity_load", "q_0"),
    },
    "two_link": {
        "P_1": ("joint1/load", "link_inertia", "P"),
        "P_2": ("joint2/load", "link_inertia", "P"),
        "P_3": ("joint1/load", "joint_coupling", "P_3"),
        "P_4": ("joint1/load", "joint_coupling", "P_4"),
        **{
            f"{name}{n}": (f"joint{n}/{place}", kind, symbol)
            for n in (1, 2)
            for name, place, kind, symbol in (
                ("rotor_share", "load", "link_inertia", "rotor_share"),
                ("P_m1m", "motor", "dc_motor", "P_m1"),
                ("P_m2m", "motor", "dc_motor", "P_m2"),
                ("F_cm", "motor_friction", "coulomb_friction", "F_c"),
                ("F_vm", "motor_friction", "viscous_friction", "F_v"),
                ("F_ca", "link_friction", "coulomb_friction", "F_c"),
                ("F_va", "link_friction", "viscous_friction", "F_v"),
            )
        },
        "G_l1": ("joint1/load", "arm_gravity", "G_l1"),
        "G_l2": ("joint1/load", "arm_gravity", "G_l2"),
        "q_0": ("joint1/load", "arm_gravity", "q_0"),
    },
}
"""Flat parameter names of each system. A friction or gravity name that is not listed is absent from the model."""

SKELETON: dict[str, tuple[tuple[str, type[Component]], ...]] = {
    "one_link": (
        ("joint1/input", Voltage),
        ("joint1/motor", DCMotor),
        ("joint1/transmission", Rigid),
        ("joint1/load", OneLink),
    ),
    "one_link_flexible": (
        ("joint1/input", Voltage),
        ("joint1/motor", DCMotor),
        ("joint1/transmission", LinearSpring),
        ("joint1/load", TwoInertias),
    ),
    "two_link": tuple(
        (f"joint{n}/{place}", part)
        for n in (1, 2)
        for place, part in (
            ("input", Voltage),
            ("motor", DCMotor),
            ("transmission", Rigid),
            ("load", LinkInertia),
        )
    ),
}
"""Components that a system always has, unless the file puts another one into their place."""


ROBOT = "robot"
"""Name of the system whose joints, masses and gravity stand in a robot's own description."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ParameterEntry(_Section):
    """One parameter in a file, and an optional Gaussian prior, whose mean is the nominal value unless one is given.

    The keys are columns of PEtab's parameter table without their affixes (``nominalValue``, ``lowerBound``,
    ``upperBound``, ``estimate``); PEtab is a file format for parameter estimation in systems biology.

    Attributes:
        nominal: start value of a fit; in a model file that a command writes it is the estimate.
        lower, upper: range that a fit keeps to; by default the component's.
        unit: checked against the component's unit, no conversion.
        estimate: false holds it at its nominal value.
        prior_std: standard deviation of a Gaussian prior, how well a data sheet's value is known say.
        prior_mean: its mean, where that is not the nominal value.
    """

    nominal: float
    lower: float | None = None
    upper: float | None = None
    unit: str | None = None
    estimate: StrictBool | None = None
    prior_std: float | None = Field(default=None, gt=0)
    prior_mean: float | None = None

    @model_validator(mode="after")
    def _prior_is_whole(self) -> ParameterEntry:
        if self.prior_mean is not None and self.prior_std is None:
            raise ValueError("prior_mean stands alone; give prior_std too, or remove it")
        return self


def _short_parameters(value: Any) -> Any:
    """Write `F_c: 0.01` out as `F_c: {nominal: 0.01}`."""
    if not isinstance(value, dict):
        return value
    return {
        key: item if isinstance(item, dict | ParameterEntry) else {"nominal": item}
        for key, item in value.items()
    }


Parameters = Annotated[
    dict[str, ParameterEntry],
    BeforeValidator(_short_parameters, json_schema_input_type=dict[str, float | ParameterEntry]),
]
"""What ``parameters`` may be in a file."""


class ComponentEntry(_Section):
    """One component beyond the system's defaults; a network has options, and weights unless it is fresh.

    Attributes:
        place: joint and place, joint1/motor_friction say; a robot's joints by their names in its file.
        kind: what acts there; hybrid-id components lists all kinds.
        parameters: start values by symbol; short for {nominal: value} is the value alone.
        options: of a network.
        weights: of a network.
    """

    place: str = Field(json_schema_extra={"pattern": f"^.+/({'|'.join(PLACES)})$"})
    kind: str = Field(json_schema_extra=one_of(lambda: sorted(REGISTRY)))
    parameters: Parameters = {}
    options: dict[str, Any] = {}
    weights: dict[str, list[Any]] = {}


class RobotEntry(_Section):
    """A robot's own description.

    Attributes:
        file: its MJCF or URDF.
        base: bodies without a parent stand still.
        hold: joints that do not move, and where they stand [rad or m].
    """

    file: FileName
    base: Literal["fixed"] = "fixed"
    hold: dict[str, float] = {}


class CouplingEntry(_Section):
    """A gear that couples motors of a wrist.

    Attributes:
        joints: that it couples.
        matrix: what each motor turns behind its gear, by the joints' angles; one row a motor.
    """

    joints: list[str]
    matrix: list[list[float]]


class ServoEntry(_Section):
    """A servo that is known by name.

    Attributes:
        preset: its name.
        p: gain that its register P holds.
        voltage: of its supply [V].
    """

    preset: str = Field(json_schema_extra=one_of(lambda: sorted(SERVOS)))
    p: float = Field(gt=0)
    voltage: float | None = Field(default=None, gt=0)


class ModelFile(_Section):
    """Nominal model: a system of a known name, or drives at the joints of a robot's MJCF or URDF.

    Attributes:
        system: a drive or arm that is known by name; left out beside 'robot'.
        robot: the robot's own description: joints, masses, gravity.
        gear_ratio: turns of the motor for one of the joint (rad per m at a slide), one number a joint.
        couplings: gears that couple the motors of a wrist.
        gravity: whether the link moves in a vertical plane.
        parameters: start values of a known system by name; short for {nominal: value} is the value alone.
        servos: by joint, or all.
        components: what acts beyond the system's own parts; one of a kind that a place holds once replaces it.
    """

    instead: ClassVar[Mapping[str, str]] = {
        "joints": "list what sits at a joint under 'components' ({place: elbow/input, kind: position_servo}), a servo "
        "that is known by name under 'servos' (elbow: {preset: sts3215, p: 16})",
        "inertias": "list a body whose inertia is to be estimated under 'components' ({place: wrist/load, kind: "
        "body_inertia, options: {body: hand}})",
    }
    """What to write in the place of keys that one may expect."""
    system: str = Field(default=ROBOT, json_schema_extra=one_of(lambda: [*FLAT, ROBOT]))
    robot: RobotEntry | None = None
    gear_ratio: list[float] = []
    couplings: list[CouplingEntry] = []
    gravity: Literal["none", "vertical"] = "none"
    parameters: Parameters = {}
    servos: dict[str, ServoEntry] = {}
    components: list[ComponentEntry] = []

    @field_validator("gear_ratio", mode="before")
    @classmethod
    def _list_of_ratios(cls, value: Any) -> Any:
        if isinstance(value, int | float):
            raise ValueError(f"it is a list with one number for each joint; write [{value}] for one joint")
        return value

"""The kinds of machine that a twin can be, and all settings of a twin."""

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationInfo, field_validator

from hybrid_id.errors import InputError
from hybrid_id.machines.physics.friction import AsymmetricStribeck, AsymmetricTanh, Coulomb, Viscous
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink, TwoLinks
from hybrid_id.machines.physics.motor import Cogging, Motor
from hybrid_id.machines.physics.stick_slip import StickSlip
from hybrid_id.machines.physics.transmission import BacklashFlexibility, Gear
from hybrid_id.records.yaml_file import validate

Values = Mapping[str, Any]
Wave = tuple[float, float]
"""Amplitude [N m] and periods per turn of a motor's torque ripple A sin(n q): an effect outside every model here."""
NO_RIPPLE = (0.0, 1.0)

MOTOR = ("P_m1", "P_m2")
FRICTION = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3")
#: Of these, what wears, warms and settles from run to run.
DRIFTING = ("f_11", "f_12", "f_21", "f_22", "f_3")
#: Speeds at which friction peaks, which may have either sign; no other parameter is ever below zero.
PEAK_SPEEDS = ("f_13", "f_23")
#: What divides, or would leave no machine at zero.
POSITIVE = ("J", "J_m", "J_a", "P_m1", "f_14", "f_24", "k", "alpha", "beta", "P_1", "P_2")
#: A joint that is held: friction that nothing overcomes [N m].
HELD = 1e6


@dataclass(frozen=True)
class Kind:
    """What the twin needs to know of one kind of machine.

    Attributes:
        system: its name in model files.
        parameters: the names of its parameters, in the order of the paper's table.
        motors: what is appended to the names of each motor's own parameters.
        rows: its state, angles and speeds by name; `_m` at a motor, `_a` at a link.
        build: the machine with parameters (B,), gear ratios and the torque ripple of each motor.
        components: (place, kind, parameters there by name) of its model file beyond the flat parameters.
    """

    system: str
    parameters: tuple[str, ...]
    motors: tuple[str, ...]
    rows: tuple[str, ...]
    build: Callable[[Values, Sequence[float], Sequence[Wave]], StickSlip]
    components: tuple[tuple[str, str, Mapping[str, str]], ...]

    @property
    def drifting(self) -> tuple[str, ...]:
        """Parameters that drift from run to run."""
        on_motors = (name + motor for motor in self.motors for name in DRIFTING)
        return (*on_motors, *(name for name in self.parameters if name in ("f_a1", "f_a2")))

    def symbol(self, name: str) -> str:
        """A parameter's name without the motor that it belongs to."""
        return next((name.removesuffix(m) for m in self.motors if m and name.endswith(m)), name)


def _drive(
    values: Values, motor: str, ratio: float, inertia: Any, ripple: Wave, *, held: bool = False
) -> Drive:
    """The drive of one motor: eq. (3) in the units of the reading notes, with the friction of eq. (15) and (16)."""
    own = {name: values[name + motor] for name in (*MOTOR, *FRICTION)}
    viscous = Viscous(own.pop("f_3"))
    drive = Drive(Gear(ratio), inertia, Motor(own.pop("P_m1"), own.pop("P_m2")))
    drive.rotor_laws = [Coulomb(HELD) if held else AsymmetricStribeck(**own), viscous]
    if ripple[0]:
        drive.rotor_laws.append(Cogging([-ripple[0]], [ripple[1]], [0.0]))
    return drive


def _one_link(values: Values, ratio: Sequence[float], ripples: Sequence[Wave]) -> StickSlip:
    """A motor, a rigid gear and one link, whose inertia J is that of all at the motor."""
    return StickSlip(Machine([_drive(values, "", ratio[0], values["J"], ripples[0])], OneLink(0.0)))


def _flexible(values: Values, ratio: Sequence[float], ripples: Sequence[Wave]) -> StickSlip:
    """A rotor and a link joined by a spring, eq. (4)-(5), (9) and (12) of the paper.

    Differs from the source by leaving out x_3 = q_m / r - q_a, which the other states hold, and by set-valued dry
    friction: the rotor sticks while the spring moves the link, and breaks away when spring and motor exceed its level.
    """
    drive = _drive(values, "", ratio[0], values["J_m"], ripples[0])
    drive.spring = BacklashFlexibility(values["k"], values["alpha"], values["beta"])
    drive.link_laws = [AsymmetricTanh(values["f_a1"], values["f_a2"])]
    return StickSlip(Machine([drive], OneLink(values["J_a"])))


def _two_link(held: int | None) -> Callable[[Values, Sequence[float], Sequence[Wave]], StickSlip]:
    """An arm in the horizontal plane, eq. (13)-(14) of the paper; P_1, P_2 are what the joints see, rotors included.

    Rotor 1 counts to link 1; the part of P_2 that the coupling P_4 does not feel is that of rotor 2.
    """

    def build(values: Values, ratio: Sequence[float], ripples: Sequence[Wave]) -> StickSlip:
        rotors = (0.0, (values["P_2"] - values["P_4"]) / ratio[1] ** 2)
        drives = [
            _drive(values, f"m{i + 1}", ratio[i], rotors[i], ripples[i], held=held == i + 1) for i in (0, 1)
        ]
        return StickSlip(Machine(drives, TwoLinks(values["P_1"], values["P_4"], values["P_3"])))

    return build


def _friction(joint: int, motor: str = "") -> tuple[str, str, dict[str, str]]:
    """The motor friction of one joint in a model file."""
    return f"joint{joint}/motor_friction", "asymmetric_stribeck", {name: name + motor for name in FRICTION}


def _itself(*names: str) -> dict[str, str]:
    return {name: name for name in names}


ONE_LINK = Kind(
    "one_link", ("J", *MOTOR, *FRICTION), ("",), ("q_m1", "v_m1"), _one_link, components=(_friction(1),)
)
ONE_LINK_FLEXIBLE = Kind(
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


def two_link(held: int | None = None) -> Kind:
    """The arm, one of its joints held where `held` says which."""
    return Kind(
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


def start_state(kind: Kind, angles: np.ndarray, gear_ratio: Sequence[float]) -> np.ndarray:
    """State at rest (n_x, B) with the motors at these angles (n_motors, B) [rad] and no spring deflected."""
    state = np.zeros((len(kind.rows), angles.shape[1]))
    for i, (angle, ratio) in enumerate(zip(angles, gear_ratio, strict=True), start=1):
        for row, per_turn in ((f"q_m{i}", 1.0), (f"q_a{i}", ratio)):
            if row in kind.rows:
                state[kind.rows.index(row)] = angle / per_turn
    return state


Number = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """Base of the sections: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Encoder(Section):
    """Counts per turn, and std of the white noise before rounding to counts [rad]."""

    counts: PositiveInt
    noise: NotNegative

    @property
    def quantum(self) -> float:
        """Angle of one count [rad]."""
        return 2 * np.pi / self.counts

    @property
    def angle_noise(self) -> float:
        """Std of noise and rounding together [rad]."""
        return float(np.hypot(self.noise, self.quantum / np.sqrt(12)))


class Ripple(Section):
    """Torque ripple of each motor: amplitude as a fraction of its f_11, and periods per turn."""

    share: NotNegative
    periods: PositiveInt


class Disturbances(Section):
    """Sizes of all that the identification's model does not know.

    Attributes:
        friction_drift: half-width of the uniform factors, one for each friction level and f_3, drawn once a run.
        torque_noise: std of the white random torque, held over a sample, as a fraction of the motor's f_11.
        torque_ripple: none where it is left out.
        encoder_counts: counts per motor turn.
        encoder_noise: std of the white noise before rounding to counts [rad].
        link_encoder: at the link of a flexible drive; none where it is left out.
        start_angle: half-width of the uniform start angle [rad, motor].
    """

    friction_drift: Annotated[float, Field(ge=0, lt=1)]
    torque_noise: NotNegative
    torque_ripple: Ripple | None = None
    encoder_counts: PositiveInt
    encoder_noise: NotNegative
    link_encoder: Encoder | None = None
    start_angle: NotNegative

    @property
    def encoder(self) -> Encoder:
        """The encoder of every motor."""
        return Encoder(counts=self.encoder_counts, noise=self.encoder_noise)


class Sines(Section):
    """A multisine: band [Hz], number of tones, peak voltage [V] and seed of its phases."""

    band: tuple[PositiveFloat, PositiveFloat]
    tones: PositiveInt
    peak: PositiveFloat
    seed: int = 0

    def __str__(self) -> str:
        return f"multisine {self.band[0]:g}-{self.band[1]:g} Hz, {self.peak:g} V"


class Experiment(Sines):
    """The multisine of a machine with one motor, and the role of its record."""

    role: Literal["train", "test"] = "train"

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self,)

    @property
    def pose(self) -> tuple[float, ...]:
        """Joint angles at the start [rad], before the random start angle."""
        return (0.0,)


class ArmExperiment(Section):
    """The multisines of both motors (none: no voltage), the joint angles at the start [rad], the role."""

    u1: Sines | None = None
    u2: Sines | None = None
    pose: tuple[Number, Number] = (0.0, 0.0)
    role: Literal["train", "test"] = "train"

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self.u1, self.u2)

    def __str__(self) -> str:
        return "; ".join(f"u{i} {sines}" for i, sines in enumerate(self.voltages, start=1) if sines)


class Excitation(Section):
    """The experiments, and from how many phase sets the least crest factor is searched."""

    starts: PositiveInt
    experiments: Annotated[list[Experiment], Field(min_length=1)]


class ArmExcitation(Section):
    """The same for two motors."""

    starts: PositiveInt
    experiments: Annotated[list[ArmExperiment], Field(min_length=1)]


class Knowledge(Section):
    """What the user's model file says of one parameter; without a nominal it starts off the truth.

    With `estimate` false it is held, but in the variant with priors only where it has no `prior_std`.
    """

    lower: float
    upper: float
    unit: str
    nominal: float | None = None
    estimate: bool = True
    prior_std: PositiveFloat | None = None


class Model(Section):
    """The model file that goes with the records."""

    start_error: Annotated[float, Field(ge=0, lt=1)]
    parameters: dict[str, Knowledge]


#: Parameters of the rigid link with asymmetric Stribeck friction, in the order of the paper's Table 2.
PARAMETERS = ONE_LINK.parameters

#: What messages call the settings.
SOURCE = "settings of the twin"


class Twin(Section):
    """All settings of a twin; times in s, `rest` is part of `duration`."""

    name: str
    machine: str = "one_link"
    sample_time: PositiveFloat
    rest: NotNegative
    duration: PositiveFloat
    substeps: PositiveInt
    gear_ratio: Any
    truth: dict[str, Number]
    disturbances: Disturbances
    excitation: Any
    model: Model

    kind: ClassVar[Kind]

    @property
    def simulated(self) -> Kind:
        """The machine that makes the records."""
        return self.kind

    @property
    def gear_ratios(self) -> tuple[float, ...]:
        """One for each motor."""
        return tuple(np.atleast_1d(self.gear_ratio).tolist())

    @field_validator("duration")
    @classmethod
    def _leaves_time_to_move(cls, duration: float, info: ValidationInfo) -> float:
        if duration < info.data.get("rest", 0.0) + 10 * info.data.get("sample_time", 0.0):
            raise ValueError("must be longer than rest by ten samples or more")
        return duration

    @field_validator("truth")
    @classmethod
    def _can_be(cls, truth: dict[str, float]) -> dict[str, float]:
        _check_names("truth", truth, cls.kind.parameters)
        for name, value in truth.items():
            symbol = cls.kind.symbol(name)
            if (value < 0 and symbol not in PEAK_SPEEDS) or (value == 0 and symbol in POSITIVE):
                least = "must be positive" if symbol in POSITIVE else "must not be negative"
                raise InputError(f"{SOURCE}: key 'truth.{name}' is {value:g} and {least}; correct it")
        return truth

    @field_validator("model")
    @classmethod
    def _knows_all(cls, model: Model) -> Model:
        _check_names("model.parameters", model.parameters, cls.kind.parameters)
        return model

    @field_validator("disturbances")
    @classmethod
    def _has_a_link_to_measure(cls, disturbances: Disturbances) -> Disturbances:
        if disturbances.link_encoder and "q_a1" not in cls.kind.rows:
            raise InputError(
                f"{SOURCE}: key 'disturbances.link_encoder' needs a link that moves apart from its motor; remove it, "
                "or let machine be one_link_flexible"
            )
        return disturbances


class LinkTwin(Twin):
    """One rigid link."""

    kind = ONE_LINK
    gear_ratio: PositiveFloat
    excitation: Excitation


class FlexibleTwin(LinkTwin):
    """One link behind a gear with play and flexibility."""

    kind = ONE_LINK_FLEXIBLE


class ArmTwin(Twin):
    """Two links, one of whose joints may be held."""

    kind = two_link()
    gear_ratio: tuple[PositiveFloat, PositiveFloat]
    held: Literal[1, 2] | None = None
    excitation: ArmExcitation

    @property
    def simulated(self) -> Kind:
        """The machine that makes the records."""
        return two_link(self.held)

    @field_validator("truth")
    @classmethod
    def _has_mass(cls, truth: dict[str, float]) -> dict[str, float]:
        p_1, p_2, p_3, p_4 = (truth[f"P_{i}"] for i in (1, 2, 3, 4))
        # the determinant of the mass matrix is concave in cos q_2: its least value lies at an end
        if min((p_1 + 2 * c * p_3) * p_2 - (p_4 + c * p_3) ** 2 for c in (-1.0, 1.0)) <= 0:
            raise InputError(
                f"{SOURCE}: keys 'truth.P_1' to 'truth.P_4' give a mass matrix that is not positive definite at "
                "some q_2; lower P_3 or P_4, or raise P_1 or P_2"
            )
        return truth


TWINS: dict[str, type[Twin]] = {twin.kind.system: twin for twin in (LinkTwin, FlexibleTwin, ArmTwin)}


def read_settings(config: Mapping[str, Any]) -> Twin:
    """Check the settings of a twin; the first fault is an InputError that names its key."""
    machine = config.get("machine", "one_link")
    if not isinstance(machine, str) or machine not in TWINS:
        raise InputError(f"{SOURCE}: key 'machine' is {machine!r}; use one of {', '.join(TWINS)}")
    return validate(TWINS[machine], config, SOURCE)


def _check_names(section: str, given: Iterable[str], names: tuple[str, ...]) -> None:
    """Refuse a section that does not name each parameter of the machine, and nothing else."""
    given = list(given)
    for name in given:
        if name not in names:
            close = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean '{close[0]}'?" if close else "remove it"
            raise InputError(f"{SOURCE}: key '{section}.{name}' is unknown; {hint}")
    for name in names:
        if name not in given:
            raise InputError(f"{SOURCE}: key '{section}.{name}' is missing; add it")

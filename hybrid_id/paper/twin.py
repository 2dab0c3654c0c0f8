"""Digital twins: machines whose truth is known, for the paper's campaign, the demo, and controllers to drive.

Their dry friction is set-valued and their switches between stick and slip are located inside the step
(`machines.physics.stick_slip`), so that no smoothing of the identification can be mistaken for physics. For the same
reason nothing here may know the models.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, PositiveInt, create_model

from hybrid_id.errors import InputError
from hybrid_id.machines.physics.friction import AsymmetricStribeck, AsymmetricTanh, Viscous
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink, TwoLinks
from hybrid_id.machines.physics.motor import Cogging, Motor
from hybrid_id.machines.physics.stick_slip import StickSlip, integrate
from hybrid_id.machines.physics.transmission import BacklashFlexibility, Gear
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import validate, write_yaml

Truth = dict[str, float]
"""Parameters of one run, and the start angle of each motor [rad], `q_0` (two motors: `q_0m1`, `q_0m2`)."""

MOTOR = ("P_m1", "P_m2")
LEVELS = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24")
SPRING, LINK_FRICTION = ("k", "alpha", "beta"), ("f_a1", "f_a2")


_RIGID = (*MOTOR, *LEVELS, "f_3")
PARAMETERS = {
    "one_link": ("J", *_RIGID),
    "one_link_flexible": ("J_m", "J_a", *MOTOR, *LINK_FRICTION, *SPRING, *LEVELS, "f_3"),
    "two_link": (*(name + motor for motor in ("m1", "m2") for name in _RIGID), "P_1", "P_2", "P_3", "P_4"),
}
"""Parameters of each machine, by its name here and in model files, in the order of the paper's table."""
DRIFTING = ("f_11", "f_12", "f_21", "f_22", "f_3")
"""What wears, warms and settles from run to run, beside the friction of a link."""
SIGNED = ("f_13", "f_23")
"""Speeds at which friction peaks, which may have either sign; no other parameter is ever below zero."""
POSITIVE = ("J", "J_m", "J_a", "P_m1", "f_14", "f_24", "k", "alpha", "beta", "P_1", "P_2")
"""What divides, or would leave no machine at zero."""


class Section(BaseModel):
    """A section of the settings: an unknown key is an error, and so is a number that is not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Ripple(Section):
    """Torque ripple of each motor, A sin(n q): A as a fraction of its f_11, n periods per turn."""

    share: NonNegativeFloat
    periods: PositiveInt


class Disturbances(Section):
    """Sizes of all that the identification's model does not know.

    Attributes:
        friction_drift: half-width of the uniform factors, one for each friction level and f_3, drawn once a run.
        torque_noise: std of the white random torque, held over a sample, as a fraction of the motor's f_11.
        torque_ripple: none where it is left out.
        encoder_counts: counts per motor turn.
        encoder_noise: std of the white noise before rounding to counts [rad].
        start_angle: half-width of the uniform start angle [rad, motor].
    """

    friction_drift: Annotated[float, Field(ge=0, lt=1)]
    torque_noise: NonNegativeFloat
    torque_ripple: Ripple | None = None
    encoder_counts: PositiveInt
    encoder_noise: NonNegativeFloat
    start_angle: NonNegativeFloat

    @property
    def quantum(self) -> float:
        """Angle of one count [rad]."""
        return 2 * np.pi / self.encoder_counts

    def read(self, angle: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Reading of an encoder [rad]: white noise, then rounding to the nearest count."""
        noise = random.normal(scale=self.encoder_noise, size=angle.shape)
        return self.quantum * np.round((angle + noise) / self.quantum)


class Sines(Section):
    """A multisine: band [Hz], number of tones, peak voltage [V] and seed of its phases."""

    band: tuple[PositiveFloat, PositiveFloat]
    tones: PositiveInt
    peak: PositiveFloat
    seed: int = 0

    def __str__(self) -> str:
        return f"multisine {self.band[0]:g}-{self.band[1]:g} Hz, {self.peak:g} V"


class Experiment(Sines):
    """The multisine of a machine with one motor, which starts at zero, and the role of its record."""

    role: Literal["train", "test"] = "train"
    pose: ClassVar = (0.0,)

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self,)


class ArmExperiment(Section):
    """The multisines of both motors (none: no voltage), the joint angles at the start [rad], the role."""

    u1: Sines | None = None
    u2: Sines | None = None
    pose: tuple[float, float] = (0.0, 0.0)
    role: Literal["train", "test"] = "train"

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self.u1, self.u2)

    def __str__(self) -> str:
        return "; ".join(f"u{i} {sines}" for i, sines in enumerate(self.voltages, start=1) if sines)


Planned = TypeVar("Planned", Experiment, ArmExperiment)
Ratio = TypeVar("Ratio")


class Excitation(Section, Generic[Planned]):
    """The experiments, and from how many phase sets the least crest factor is searched."""

    starts: PositiveInt
    experiments: Annotated[list[Planned], Field(min_length=1)]


class Knowledge(Section):
    """What the model file that goes with the records says of each parameter.

    Without a nominal value it starts off the truth; with `prior_std` it is held, or has a prior in the variant with
    priors.
    """

    start_error: Annotated[float, Field(ge=0, lt=1)]
    parameters: dict[str, dict[str, Any]]


class Twin(Section, Generic[Ratio, Planned]):
    """All settings of a twin, and the machine that they make; times in s, `rest` is part of `duration`.

    `truth` holds every parameter of the machine.
    """

    name: str
    machine: str = "one_link"
    sample_time: PositiveFloat
    rest: NonNegativeFloat
    duration: PositiveFloat
    substeps: PositiveInt
    gear_ratio: Ratio
    truth: dict[str, float]
    disturbances: Disturbances
    excitation: Excitation[Planned]
    model: Knowledge

    @property
    def motors(self) -> tuple[str, ...]:
        """What is appended to the names of each motor's own parameters."""
        return ("m1", "m2") if self.machine == "two_link" else ("",)

    @property
    def gear_ratios(self) -> tuple[float, ...]:
        """One for each motor."""
        return tuple(np.atleast_1d(np.asarray(self.gear_ratio)).tolist())

    def begin(self, truths: Sequence[Mapping[str, float]], *, ripple: bool) -> tuple[StickSlip, np.ndarray]:
        """The machines of B runs, and their states (n_x, B) at rest at their start angles, no spring deflected.

        A motor is eq. (3) in the units of the reading notes, its friction eq. (15) and (16). The flexible drive is eq.
        (4)-(5), (9) and (12). It differs from the source by leaving out x_3 = q_m / r - q_a, which the other states
        hold, and by set-valued dry friction: the rotor sticks while the spring moves the link, and breaks away when
        spring and motor exceed its level. The arm is eq. (13)-(14), in the horizontal plane. Its P_1 and P_2 are what
        the joints see, rotors included: rotor 1 counts to link 1, and the part of P_2 that the coupling P_4 does not
        feel is that of rotor 2.

        Args:
            truths: parameters and start angles (0 where absent) of each run.
            ripple: whether the motors have their torque ripple.
        """
        p = {name: np.array([truth[name] for truth in truths]) for name in PARAMETERS[self.machine]}
        wave = self.disturbances.torque_ripple if ripple else None
        drives = []
        for motor, ratio in zip(self.motors, self.gear_ratios, strict=True):
            drive = Drive(Gear(ratio), 0.0, Motor(p["P_m1" + motor], p["P_m2" + motor]))
            dry = AsymmetricStribeck(**{name: p[name + motor] for name in LEVELS})
            drive.rotor_laws = [dry, Viscous(p["f_3" + motor])]
            if wave and wave.share:
                amplitude = wave.share * self.truth["f_11" + motor]
                drive.rotor_laws.append(Cogging([-amplitude], [wave.periods], [0.0]))
            drives.append(drive)
        if self.machine == "two_link":
            drives[1].rotor = (p["P_2"] - p["P_4"]) / self.gear_ratios[1] ** 2
            links = TwoLinks(p["P_1"], p["P_4"], p["P_3"])
        elif self.machine == "one_link_flexible":
            drives[0].rotor = p["J_m"]
            drives[0].spring = BacklashFlexibility(p["k"], p["alpha"], p["beta"])
            drives[0].link_laws = [AsymmetricTanh(p["f_a1"], p["f_a2"])]
            links = OneLink(p["J_a"])
        else:
            drives[0].rotor, links = p["J"], OneLink(0.0)
        start = np.zeros((2 if self.machine == "one_link" else 4, len(truths)))
        for i, motor in enumerate(self.motors):
            start[2 * i] = [truth.get(f"q_0{motor}", 0.0) for truth in truths]
        if self.machine == "one_link_flexible":
            start[2] = start[0] / self.gear_ratio
        return StickSlip(Machine(drives, links)), start

    def draw_truth(self, pose: Sequence[float], random: np.random.Generator) -> Truth:
        """Parameters of one run, drifted, and the start angle of each motor."""
        truth = dict(self.truth)
        drift, limit = self.disturbances.friction_drift, self.disturbances.start_angle
        of_motors = [name + motor for motor in self.motors for name in DRIFTING]
        for name in (*of_motors, *(name for name in LINK_FRICTION if name in truth)):
            truth[name] *= random.uniform(1 - drift, 1 + drift)
        for motor, angle, ratio in zip(self.motors, pose, self.gear_ratios, strict=True):
            truth[f"q_0{motor}"] = ratio * angle + random.uniform(-limit, limit)
        return truth

    def draw_torques(self, n_samples: int, random: np.random.Generator) -> np.ndarray:
        """Random torques (n_motors, T) of one run [N m]."""
        levels = np.array([[self.truth["f_11" + motor]] for motor in self.motors])
        scale = self.disturbances.torque_noise * levels
        return random.normal(scale=scale, size=(len(levels), n_samples))


def read_settings(config: Mapping[str, Any]) -> Twin[Any, Any]:
    """Check the settings of a twin; the first fault is an InputError that names its key."""
    machine, source = config.get("machine", "one_link"), "settings of the twin"
    if not isinstance(machine, str) or machine not in PARAMETERS:
        raise InputError(f"{source}: key 'machine' is {machine!r}; use one of {', '.join(PARAMETERS)}")
    arm, one = Twin[tuple[PositiveFloat, PositiveFloat], ArmExperiment], Twin[PositiveFloat, Experiment]
    twin = validate(arm if machine == "two_link" else one, config, source)
    if twin.duration < twin.rest + 10 * twin.sample_time:
        raise InputError(f"{source}: key 'duration' must be longer than rest by ten samples or more")
    names = PARAMETERS[machine]
    sizes: dict[str, Any] = {name: (NonNegativeFloat, ...) for name in names}
    for name in names:
        symbol = name.removesuffix("m1").removesuffix("m2") if machine == "two_link" else name
        if symbol in SIGNED or symbol in POSITIVE:
            sizes[name] = (float if symbol in SIGNED else PositiveFloat, ...)
    known: dict[str, Any] = {name: (dict[str, Any], ...) for name in names}
    model = create_model("Model", parameters=(create_model("Known", __base__=Section, **known), ...))
    named = create_model(
        "Named", truth=(create_model("Truth", __base__=Section, **sizes), ...), model=(model, ...)
    )
    given = {"truth": twin.truth, "model": {"parameters": twin.model.parameters}}
    truth = validate(named, given, source).model_dump()["truth"]
    if machine == "two_link":
        p_1, p_2, p_3, p_4 = (truth[f"P_{i}"] for i in (1, 2, 3, 4))
        # the determinant of the mass matrix is concave in cos q_2: its least value lies at an end
        if min((p_1 + 2 * c * p_3) * p_2 - (p_4 + c * p_3) ** 2 for c in (-1.0, 1.0)) <= 0:
            raise InputError(
                f"{source}: key 'truth': the mass matrix of P_1 to P_4 is not positive definite at some q_2; lower "
                "P_3 or P_4, or raise P_1 or P_2"
            )
    return twin.model_copy(update={"truth": truth})


def model_description(config: Mapping[str, Any], seed: int, *, priors: bool = False) -> dict[str, Any]:
    """Content of the model file that the identification starts from.

    Args:
        config: the settings of the twin.
        seed: of the errors of the start values.
        priors: add `prior_std` (centre: the nominal) where the settings give one; it replaces being held.
    """
    twin = read_settings(config)
    size, random = twin.model.start_error, np.random.default_rng([seed, len(twin.excitation.experiments)])
    truth, entries = dict(twin.truth), dict[str, Any]()
    for name, factor in zip(truth, random.uniform(1 - size, 1 + size, len(truth)), strict=True):
        known = twin.model.parameters[name]
        entries[name] = entry = {"nominal": float(f"{truth[name] * factor:.6g}"), **known}
        entry.pop("estimate" if priors and "prior_std" in known else "prior_std", None)
    friction = ("asymmetric_stribeck", (*LEVELS, "f_3"))
    places: list[tuple[str, str, tuple[str, ...], str]] = [
        (f"joint{i}/motor_friction", *friction, motor) for i, motor in enumerate(twin.motors, start=1)
    ]
    if twin.machine == "one_link_flexible":
        places.append(("joint1/transmission", "backlash_flexibility", SPRING, ""))
        places.append(("joint1/link_friction", "asymmetric_tanh", LINK_FRICTION, ""))
    components = [
        {"place": place, "kind": kind, "parameters": {n: entries.pop(n + motor) for n in names}}
        for place, kind, names, motor in places
    ]
    return {
        "system": twin.machine,
        "gear_ratio": list(twin.gear_ratios),
        "gravity": "none",
        "parameters": entries,
        "components": components,
    }


def make_campaign(config: Mapping[str, Any], seed: int) -> tuple[Dataset, list[Truth]]:
    """Simulate all experiments of a twin once.

    Args:
        config: the settings, see `configs/twin_*.yaml`.
        seed: of drift, random torques, encoder noise and start angles; the voltages are the same for every seed.

    Returns:
        The dataset (u1, u2 in V; q_m1, q_m2 in rad; records run_00, run_01, ...), and for each record its own truth.
    """
    twin = read_settings(config)
    plans, count = twin.excitation.experiments, len(twin.motors)
    n_rest, n_samples = round(twin.rest / twin.sample_time), round(twin.duration / twin.sample_time)
    inputs = np.zeros((len(plans), 2 * count, n_samples))  # voltages, then random torques
    generators = [np.random.default_rng([seed, i]) for i in range(len(plans))]
    truths = [twin.draw_truth(plan.pose, random) for plan, random in zip(plans, generators, strict=True)]
    for run, plan, random in zip(inputs, plans, generators, strict=True):
        run[count:] = twin.draw_torques(n_samples, random)
        for voltage, sines in zip(run, plan.voltages, strict=False):
            if sines is not None:  # rest, then one period
                voltage[n_rest:] = design_multisine(
                    sines.band,
                    sample_time=twin.sample_time,
                    duration=twin.duration - twin.rest,
                    amplitude_limits=sines.peak,
                    tones=sines.tones,
                    starts=twin.excitation.starts,
                    seed=sines.seed,
                ).signal
    time = twin.sample_time * np.arange(n_samples)
    mechanism, start = twin.begin(truths, ripple=True)
    states = integrate(mechanism, start, inputs.transpose(2, 1, 0), time, substeps=twin.substeps)
    records = []
    for i, (plan, random) in enumerate(zip(plans, generators, strict=True)):
        voltages = {f"u{motor}": voltage for motor, voltage in enumerate(inputs[i, :count], start=1)}
        angles = {f"q_m{k + 1}": twin.disturbances.read(states[:, 2 * k, i], random) for k in range(count)}
        records.append(Record(f"run_{i:02d}", time, voltages, angles, role=plan.role, note=str(plan)))
    noise = float(f"{np.hypot(twin.disturbances.encoder_noise, twin.disturbances.quantum / np.sqrt(12)):.4g}")
    dataset = Dataset(
        name=twin.name,
        inputs=tuple(Channel(name, "V") for name in records[0].inputs),
        outputs=tuple(Channel(name, "rad", noise) for name in records[0].outputs),
        records=tuple(records),
        sample_time=twin.sample_time,
    )
    return dataset, truths


def replay(
    config: Mapping[str, Any], records: Sequence[Record], truths: Sequence[Mapping[str, float]]
) -> list[dict[str, np.ndarray]]:
    """Simulate logged voltages with given parameters, without noise, ripple and random torques.

    Args:
        config: settings that the records were made with.
        records: over the same time stamps, with the input u1, for two motors u2 too [V].
        truths: for each record the parameters and start angles (0 where absent), as `make_campaign` returns them.

    Returns:
        For each record the noise-free states: angles q_m1, ... [rad] and speeds v_m1, ... [rad/s], each (T,).
    """
    twin = read_settings(config)
    voltages = np.array([[r.inputs[f"u{i + 1}"] for i in range(len(twin.motors))] for r in records])
    inputs = np.concatenate((voltages, np.zeros_like(voltages)), axis=1).transpose(2, 1, 0)
    mechanism, start = twin.begin(truths, ripple=False)
    states = integrate(mechanism, start, inputs, records[0].time, substeps=twin.substeps)
    rows = ("q_m1", "v_m1", *(("q_m2", "v_m2") if len(twin.motors) > 1 else ("q_a1", "v_a1")))
    return [dict(zip(rows, run, strict=False)) for run in states.transpose(2, 1, 0)]


def write_campaign(folder: str | Path, config: Mapping[str, Any], seed: int) -> tuple[Dataset, list[Truth]]:
    """Simulate the twin into a dataset folder, with its model files and its truth.

    Beside the dataset go `model.yaml`, `model_priors.yaml` (the same with data-sheet priors) and `truth.yaml`
    (settings, seed, and the parameters of each run), which no identification reads.

    Returns:
        What `make_campaign` returns, the dataset as it was made.
    """
    folder = Path(folder)
    dataset, truths = make_campaign(config, seed)
    dataset.save(folder)
    write_yaml(folder / "model.yaml", model_description(config, seed))
    write_yaml(folder / "model_priors.yaml", model_description(config, seed, priors=True))
    runs = {record.name: truth for record, truth in zip(dataset.records, truths, strict=True)}
    settings = read_settings(config).model_dump(mode="json", exclude_none=True)
    write_yaml(folder / "truth.yaml", {"seed": seed, "records": runs, "settings": settings})
    return dataset, truths

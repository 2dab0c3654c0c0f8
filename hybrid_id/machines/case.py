"""One case: a machine with something at work in it, its records, and the nominal model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.effects import Effect
from hybrid_id.machines.experiments import SAMPLE_TIME, Campaign, noise_std
from hybrid_id.machines.physics.bench import Encoders, Plant, Program, replay, run
from hybrid_id.machines.physics.mujoco import MujocoMachine, Unsupported
from hybrid_id.machines.robots import Robot
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record

NOISE = (0.002, 0.03)
"""Encoders' noise relative to the motion in the test records."""
SUBSTEPS = 4
"""Steps a sample of the in-house engine: 0.5 ms."""


@dataclass(frozen=True, eq=False)
class Case:
    """What a case is made of.

    Attributes:
        name: of its folder.
        robot: the machine without effects.
        effects: none, one or two.
        campaign: planned records.
        model: the nominal model, as the content of a model file.
        engine: in_house or mujoco.
    """

    name: str
    robot: Robot
    effects: tuple[Effect, ...]
    campaign: Campaign
    model: Mapping[str, Any]
    engine: str = "in_house"

    def with_effects(self, effects: Sequence[Effect]) -> "Case":
        """The same case with other effects."""
        return replace(self, effects=tuple(effects))

    def truth(self) -> Robot:
        """The robot with what its effects are as parameters, and what the nominal model lacks of them."""
        robot = self.robot
        for effect in self.effects:
            robot = effect.alter(robot)
        return robot

    def plant(self) -> Plant:
        """The machine with its effects."""
        return build(self.robot, self.effects, self.engine)


@dataclass(frozen=True, eq=False)
class Records:
    """What came out of a case's experiments.

    Attributes:
        dataset: as it was measured.
        volts: (T, n_joints, B) of all records, zero beyond the end of each.
        measured: (T, n_outputs, B) [rad], likewise.
        noise_floor: normalised RMSE on the test records of the true machine, replayed without noise and random torques.
    """

    dataset: Dataset
    volts: np.ndarray
    measured: np.ndarray
    noise_floor: float


def build(
    robot: Robot, effects: Sequence[Effect], engine: str = "in_house", *, substeps: int = SUBSTEPS
) -> Plant:
    """A robot with effects in one of the engines.

    Raises:
        Unsupported: MuJoCo has no counterpart of one of its laws.
    """
    for effect in effects:
        robot = effect.alter(robot)
    machine = robot.assemble(substeps=substeps)
    for effect in effects:
        effect.install(machine, robot)
    return MujocoMachine(machine) if engine == "mujoco" else machine


def runs_in_mujoco(robot: Robot, effects: Sequence[Effect]) -> bool:
    """Whether MuJoCo is installed and has a counterpart of every law."""
    try:
        build(robot, effects, "mujoco")
    except (ImportError, Unsupported):
        return False
    return True


def record(case: Case) -> Records:
    """Make all experiments of a case, and replay them without noise."""
    return record_sizes(case, np.ones(1))[0]


def record_sizes(case: Case, factors: np.ndarray) -> list[Records]:
    """Records of a case with its effects scaled by each of the factors (K,), all runs side by side."""
    count, runs = len(factors), len(case.campaign.lengths)
    if count > 1:
        grown = [effect.scaled(np.repeat(factors, runs)) for effect in case.effects]
        case = replace(case.with_effects(grown), campaign=case.campaign.repeated(count))
    campaign = case.campaign
    volts, measured = run(case.plant(), campaign.program, campaign.encoders, sample_time=SAMPLE_TIME)
    clean = replay(case.plant(), volts, sample_time=SAMPLE_TIME, link=campaign.encoders.link)
    lanes = np.arange(count * runs).reshape(count, runs)
    return [logged(case, volts[..., own], measured[..., own], clean[..., own]) for own in lanes]


def tuned(case: Case, share: float, *, substeps: int = SUBSTEPS) -> Case:
    """The case with encoders that suit its motion, and random torques that move the outputs by a share of their noise.

    Encoders are made coarser or finer by powers of two until their noise is within `NOISE` of the test records' motion.
    The share holds for four records of five, of the output that feels the torques most, on the machine without effects.
    """
    campaign = case.campaign
    sound = build(case.robot, (), substeps=substeps)
    volts, measured = run(sound, campaign.program, campaign.encoders, sample_time=SAMPLE_TIME)
    clean = replay(sound, volts, sample_time=SAMPLE_TIME, link=campaign.encoders.link)
    errors, spread, noise = [], [], noise_std(campaign.encoders)
    for b, length in enumerate(campaign.lengths):
        own = measured[:length, :, b]
        errors.append(np.mean((clean[:length, :, b] - own) ** 2, axis=0))
        if campaign.roles[b] == "test":
            spread.append(np.std(own, axis=0))
    floor = np.mean(noise / np.array(spread), axis=0)
    finer = 2.0 ** np.round(np.log2(np.clip(floor, *NOISE) / floor))
    encoders = replace(
        campaign.encoders,
        quantum=finer * campaign.encoders.quantum,
        jitter=finer[:, None] * campaign.encoders.jitter,
    )
    felt = np.sqrt(np.maximum(np.array(errors) - noise**2, 1e-4 * noise**2)) / (finer * noise)
    factor = share / float(np.quantile(felt, 0.8, axis=0).max())
    program = replace(campaign.program, disturbance=factor * campaign.program.disturbance)
    return replace(case, campaign=replace(campaign, program=program, encoders=encoders))


def logged(case: Case, volts: np.ndarray, measured: np.ndarray, clean: np.ndarray) -> Records:
    """What was logged in the records of one size of the effects, (T, channels, records) each."""
    campaign = case.campaign
    outputs = [f"q_m{i + 1}" for i in range(case.robot.joints)] + ["q_a1"] * campaign.encoders.link
    inputs = [f"u{i + 1}" for i in range(case.robot.joints)]
    records, errors = [], []
    for b, length in enumerate(campaign.lengths[: volts.shape[-1]]):
        angles = np.round(measured[:length, :, b], 7)
        records.append(
            Record(
                name=f"rec_{b:02d}",
                time=np.round(SAMPLE_TIME * np.arange(length), 6),
                inputs={name: volts[:length, i, b] for i, name in enumerate(inputs)},
                outputs={name: angles[:, i] for i, name in enumerate(outputs)},
                role="train" if campaign.roles[b] == "train" else "test",
                note=campaign.notes[b],
            )
        )
        if campaign.roles[b] == "test":
            errors.append(nrmse(clean[:length, :, b], angles))
    noise = noise_std(campaign.encoders)
    dataset = Dataset(
        name=case.name,
        inputs=tuple(Channel(name, "V") for name in inputs),
        outputs=tuple(
            Channel(name, "rad", float(f"{std:.3g}")) for name, std in zip(outputs, noise, strict=True)
        ),
        records=tuple(records),
        sample_time=SAMPLE_TIME,
    )
    return Records(dataset, volts, measured, float(np.mean(errors)))


def nrmse(simulated: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """RMS error over the standard deviation of the measured signal, (n_outputs,) of (T, n_outputs)."""
    return np.sqrt(np.mean((simulated - measured) ** 2, axis=0)) / np.std(measured, axis=0)


NAME = "further"


def further_record(
    case: Case, joint: int, command: Sequence[float], sample_time: float, *, seed: int, name: str = NAME
) -> Record:
    """Measure the machine of a case under an open-loop voltage.

    Noise is new, of the case's size; the small random torques are those of its first record.

    Args:
        case: by `draw.same_case`.
        joint: whose motor gets the voltage, from 1; the others get none.
        command: voltage (T,) [V]; the supply limits it.
        sample_time: [s]; has to be that of the case.
        seed: of the noise.
        name: of the record.
    """
    if abs(sample_time - SAMPLE_TIME) > 1e-9:
        raise InputError(f"a further record of {case.name} needs the sample time {SAMPLE_TIME} s of its case")
    campaign, joints, samples = case.campaign, case.robot.joints, len(command)
    rng = np.random.default_rng([seed, 2])
    feed = np.zeros((samples, joints, 1))
    feed[:, joint - 1, 0] = command
    still, limit = np.zeros((joints, 1)), np.full((joints, 1), case.robot.supply)
    pushed = campaign.program.disturbance[:, :, 0]
    torque = np.stack([np.resize(pushed[:, i], samples) for i in range(joints)], axis=1)[..., None]
    std = campaign.encoders.jitter.std(axis=(0, 2))
    jitter = rng.standard_normal((samples, len(std), 1)) * std[:, None]
    encoders = Encoders(campaign.encoders.quantum, jitter, campaign.encoders.link)
    program = Program(feed, np.zeros_like(feed), still, still, still, limit, torque)
    volts, measured = run(case.plant(), program, encoders, sample_time=SAMPLE_TIME)
    outputs = [f"q_m{i + 1}" for i in range(joints)] + ["q_a1"] * encoders.link
    return Record(
        name=name,
        time=np.round(SAMPLE_TIME * np.arange(samples), 6),
        inputs={f"u{i + 1}": volts[:, i, 0] for i in range(joints)},
        outputs={name: np.round(measured[:, i, 0], 7) for i, name in enumerate(outputs)},
        role="train",
        note="further experiment",
    )

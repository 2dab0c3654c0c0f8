"""The digital twin of the paper's link 1: records whose truth is known, and the model that a user would start from."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import validate, write_yaml
from hybrid_id.twin.automaton import integrate
from hybrid_id.twin.drive import RigidDrive
from hybrid_id.twin.friction import AsymmetricStribeck
from hybrid_id.twin.settings import PARAMETERS, Disturbances, LinkTwin

#: What wears, warms and settles from run to run.
DRIFTING = ("f_11", "f_12", "f_21", "f_22", "f_3")
BASE = ("J", "P_m1", "P_m2")


def make_link1(config: Mapping[str, Any], seed: int) -> tuple[Dataset, list[dict[str, float]]]:
    """Simulate all experiments of the twin once.

    Args:
        config: the settings, see `configs/twin_link1.yaml`.
        seed: of drift, random torques, encoder noise and start angles; the voltages are the same for every seed.

    Returns:
        The dataset (u1 in V, q_m1 in rad), and for each record its own truth: the twelve parameters of that run
        and `q_0`, the start angle at the motor.
    """
    return make_link1_seeds(config, [seed])[0]


def make_link1_seeds(
    config: Mapping[str, Any], seeds: Iterable[int]
) -> list[tuple[Dataset, list[dict[str, float]]]]:
    """Simulate the whole campaign for many seeds in one go; each result is that of `make_link1`."""
    twin = _settings(config)
    seeds = list(seeds)
    voltages = _voltages(twin)
    n_experiments, n_samples = voltages.shape
    time = twin.sample_time * np.arange(n_samples)
    generators = [np.random.default_rng([seed, i]) for seed in seeds for i in range(n_experiments)]
    truths = [_draw_truth(twin, random) for random in generators]
    torques = np.array(
        [
            random.normal(scale=twin.disturbances.torque_noise * twin.truth.f_11, size=n_samples)
            for random in generators
        ]
    )
    angles, _ = _simulate(truths, np.tile(voltages, (len(seeds), 1)), torques, time, twin.substeps)
    measured = [
        encoder(angle, twin.disturbances, random) for angle, random in zip(angles, generators, strict=True)
    ]
    results = []
    for start in range(0, len(truths), n_experiments):
        runs = slice(start, start + n_experiments)
        results.append((_dataset(twin, time, voltages, measured[runs]), truths[runs]))
    return results


def replay(
    records: Iterable[Record], truths: Iterable[Mapping[str, float]], *, substeps: int = 10
) -> list[dict[str, np.ndarray]]:
    """Simulate the logged voltages with given parameters, without noise and random torques.

    Args:
        records: with the input u1 [V].
        truths: for each record the twelve parameters and `q_0` [rad] (0 where absent), as `make_link1` returns them.
        substeps: Runge-Kutta steps per sample.

    Returns:
        For each record the noise-free outputs q_m1 [rad] and v_m1 [rad/s], each (T,).
    """
    outputs = []
    pairs = list(zip(records, truths, strict=True))
    for _, group in groupby(pairs, key=lambda pair: pair[0].time.tobytes()):
        runs = list(group)  # runs over the same time stamps are simulated side by side
        voltages = np.array([record.inputs["u1"] for record, _ in runs])
        angles, speeds = _simulate(
            [truth for _, truth in runs], voltages, np.zeros_like(voltages), runs[0][0].time, substeps
        )
        outputs += [{"q_m1": q, "v_m1": v} for q, v in zip(angles, speeds, strict=True)]
    return outputs


def model_description(config: Mapping[str, Any], seed: int, *, priors: bool = False) -> dict[str, Any]:
    """Content of the model file that the identification starts from.

    Args:
        config: the settings of the twin.
        seed: of the errors of the start values.
        priors: add `prior_std` (centre: the nominal) where the settings give one.
    """
    twin = _settings(config)
    size = twin.model.start_error
    factors = np.random.default_rng([seed, len(twin.excitation.experiments)]).uniform(
        1 - size, 1 + size, len(PARAMETERS)
    )

    def entry(name: str, factor: float) -> dict[str, Any]:
        known = twin.model.parameters[name]
        off_truth = float(f"{getattr(twin.truth, name) * factor:.6g}")
        values: dict[str, Any] = {
            "nominal": off_truth if known.nominal is None else known.nominal,
            "lower": known.lower,
            "upper": known.upper,
            "unit": known.unit,
        }
        if priors and known.prior_std is not None:
            values["prior_std"] = known.prior_std
        return values

    entries = {name: entry(name, factor) for name, factor in zip(PARAMETERS, factors, strict=True)}
    friction = {name: value for name, value in entries.items() if name not in BASE}
    return {
        "system": "one_link",
        "gear_ratio": [twin.gear_ratio],
        "gravity": "none",
        "parameters": {name: entries[name] for name in BASE},
        "components": [
            {"place": "joint1/motor_friction", "kind": "asymmetric_stribeck", "parameters": friction}
        ],
    }


def write_link1(
    folder: str | Path, config: Mapping[str, Any], seed: int
) -> tuple[Dataset, list[dict[str, float]]]:
    """Simulate the twin into a dataset folder, with its model files and its truth.

    Beside the dataset go `model.yaml`, `model_priors.yaml` (the same with data-sheet priors) and `truth.yaml`
    (settings, seed, and the parameters of each run), which no identification reads.

    Returns:
        What `make_link1` returns, the dataset as it was made.
    """
    folder = Path(folder)
    dataset, truths = make_link1(config, seed)
    dataset.save(folder)
    write_yaml(folder / "model.yaml", model_description(config, seed))
    write_yaml(folder / "model_priors.yaml", model_description(config, seed, priors=True))
    runs = {record.name: truth for record, truth in zip(dataset.records, truths, strict=True)}
    settings = _settings(config).model_dump(mode="json", exclude_none=True)
    write_yaml(folder / "truth.yaml", {"seed": seed, "records": runs, "settings": settings})
    return dataset, truths


def encoder(angle: np.ndarray, disturbances: Disturbances, random: np.random.Generator) -> np.ndarray:
    """Reading of the motor's encoder [rad]: white noise, then rounding to the nearest count."""
    quantum = disturbances.encoder_quantum
    noisy = angle + random.normal(scale=disturbances.encoder_noise, size=angle.shape)
    return quantum * np.round(noisy / quantum)


def _settings(config: Mapping[str, Any]) -> LinkTwin:
    """Check the settings; the first fault is an InputError that names its key."""
    return validate(LinkTwin, config, "settings of the twin")


def _voltages(twin: LinkTwin) -> np.ndarray:
    """Voltage (n_experiments, T) of each experiment: rest, then one period of its multisine."""
    at_rest = np.zeros(round(twin.rest / twin.sample_time))
    designs = [
        design_multisine(
            experiment.band,
            sample_time=twin.sample_time,
            duration=twin.duration - twin.rest,
            amplitude_limits=experiment.peak,
            tones=experiment.tones,
            starts=twin.excitation.starts,
            seed=experiment.seed,
        )
        for experiment in twin.excitation.experiments
    ]
    return np.array([np.concatenate((at_rest, design.signal)) for design in designs])


def _draw_truth(twin: LinkTwin, random: np.random.Generator) -> dict[str, float]:
    """Parameters of one run: Table 2 with the drift of that run, and the start angle."""
    truth = twin.truth.model_dump()
    drift = twin.disturbances.friction_drift
    for name in DRIFTING:
        truth[name] *= random.uniform(1 - drift, 1 + drift)
    limit = twin.disturbances.start_angle
    return {**truth, "q_0": random.uniform(-limit, limit)}


def _simulate(
    truths: Sequence[Mapping[str, float]],
    voltages: np.ndarray,
    torques: np.ndarray,
    time: np.ndarray,
    substeps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles and speeds (B, T) of B runs with voltages and random torques (B, T)."""
    values = {name: np.array([truth[name] for truth in truths]) for name in PARAMETERS}
    dry = AsymmetricStribeck(**{name: values.pop(name) for name in PARAMETERS[3:-1]})
    start = np.array([[truth.get("q_0", 0.0) for truth in truths], np.zeros(len(truths))])
    inputs = np.stack((voltages.T, torques.T), axis=1)
    states = integrate(RigidDrive(dry=dry, **values), start, inputs, time, substeps=substeps)
    return states[:, 0].T, states[:, 1].T


def _dataset(
    twin: LinkTwin, time: np.ndarray, voltages: np.ndarray, measured: Sequence[np.ndarray]
) -> Dataset:
    """The records of one campaign, named run_00, run_01, ..."""
    records = [
        Record(
            name=f"run_{number:02d}",
            time=time,
            inputs={"u1": voltage},
            outputs={"q_m1": angle},
            role=plan.role,
            note=f"multisine {plan.band[0]:g}-{plan.band[1]:g} Hz, {plan.peak:g} V",
        )
        for number, (plan, voltage, angle) in enumerate(
            zip(twin.excitation.experiments, voltages, measured, strict=True)
        )
    ]
    return Dataset(
        name=twin.name,
        inputs=(Channel("u1", "V"),),
        outputs=(Channel("q_m1", "rad", float(f"{twin.disturbances.angle_noise:.4g}")),),
        records=tuple(records),
        sample_time=twin.sample_time,
    )

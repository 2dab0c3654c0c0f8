"""Records of a digital twin, whose truth is known."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.machines.physics.stick_slip import integrate
from hybrid_id.machines.twin.settings import (
    NO_RIPPLE,
    ONE_LINK,
    Encoder,
    Kind,
    Sines,
    Twin,
    Wave,
    read_settings,
    start_state,
)
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import write_yaml

Truth = dict[str, float]


def levels(twin: Twin) -> np.ndarray:
    """True f_11 of each motor (n_motors,), by which torques of disturbances are measured."""
    return np.array([twin.truth["f_11" + motor] for motor in twin.kind.motors])


def ripples(twin: Twin) -> list[Wave]:
    """The torque ripple of each motor."""
    ripple = twin.disturbances.torque_ripple
    return [(ripple.share * level, ripple.periods) if ripple else NO_RIPPLE for level in levels(twin)]


def draw_torques(twin: Twin, n_samples: int, random: np.random.Generator) -> np.ndarray:
    """Random torques (n_motors, T) of one run [N m]."""
    noise = twin.disturbances.torque_noise * levels(twin)[:, None]
    return random.normal(scale=noise, size=(len(noise), n_samples))


def encoders(twin: Twin) -> dict[str, Encoder]:
    """The encoder of each measured angle."""
    encoders = {f"q_m{i + 1}": twin.disturbances.encoder for i in range(len(twin.kind.motors))}
    link = twin.disturbances.link_encoder
    return encoders | ({"q_a1": link} if link else {})


def draw_truth(twin: Twin, pose: Sequence[float], random: np.random.Generator) -> Truth:
    """Parameters of one run, drifted, and the start angle of each motor."""
    truth = {name: twin.truth[name] for name in twin.kind.parameters}
    drift = twin.disturbances.friction_drift
    for name in twin.kind.drifting:
        truth[name] *= random.uniform(1 - drift, 1 + drift)
    limit = twin.disturbances.start_angle
    for motor, angle, ratio in zip(twin.kind.motors, pose, twin.gear_ratios, strict=True):
        truth[f"q_0{motor}"] = ratio * angle + random.uniform(-limit, limit)
    return truth


def read_encoder(angle: np.ndarray, encoder: Encoder, random: np.random.Generator) -> np.ndarray:
    """Reading of an encoder [rad]: white noise, then rounding to the nearest count."""
    noisy = angle + random.normal(scale=encoder.noise, size=angle.shape)
    return encoder.quantum * np.round(noisy / encoder.quantum)


def model_description(config: Mapping[str, Any], seed: int, *, priors: bool = False) -> dict[str, Any]:
    """Content of the model file that the identification starts from.

    Args:
        config: the settings of the twin.
        seed: of the errors of the start values.
        priors: add `prior_std` (centre: the nominal) where the settings give one; it replaces being held.
    """
    twin = read_settings(config)
    names = twin.kind.parameters
    size = twin.model.start_error
    random = np.random.default_rng([seed, len(twin.excitation.experiments)])
    factors = random.uniform(1 - size, 1 + size, len(names))

    def entry(name: str, factor: float) -> dict[str, Any]:
        known = twin.model.parameters[name]
        off_truth = float(f"{twin.truth[name] * factor:.6g}")
        values: dict[str, Any] = {
            "nominal": off_truth if known.nominal is None else known.nominal,
            "lower": known.lower,
            "upper": known.upper,
            "unit": known.unit,
        }
        if priors and known.prior_std is not None:
            values["prior_std"] = known.prior_std
        elif not known.estimate:
            values["estimate"] = False
        return values

    entries = {name: entry(name, factor) for name, factor in zip(names, factors, strict=True)}
    components = [
        {
            "place": place,
            "kind": kind,
            "parameters": {symbol: entries.pop(name) for symbol, name in here.items()},
        }
        for place, kind, here in twin.kind.components
    ]
    return {
        "system": twin.kind.system,
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
        The dataset (u1, u2 in V; q_m1, q_m2, q_a1 in rad, as the machine has them), and for each record its own
        truth: the parameters of that run, and `q_0` (two motors: `q_0m1`, `q_0m2`), the start angle at the motor.
    """
    return make_campaigns(config, [seed])[0]


def make_campaigns(config: Mapping[str, Any], seeds: Iterable[int]) -> list[tuple[Dataset, list[Truth]]]:
    """Simulate the whole campaign for many seeds in one go; each result is that of `make_campaign`."""
    twin = read_settings(config)
    seeds = list(seeds)
    voltages = _voltages(twin)
    n_experiments, _, n_samples = voltages.shape
    time = twin.sample_time * np.arange(n_samples)
    generators = [np.random.default_rng([seed, i]) for seed in seeds for i in range(n_experiments)]
    truths = [
        draw_truth(twin, experiment.pose, random)
        for experiment, random in zip(twin.excitation.experiments * len(seeds), generators, strict=True)
    ]
    torques = np.array([draw_torques(twin, n_samples, random) for random in generators])
    states = _simulate(
        twin.simulated,
        twin.gear_ratios,
        truths,
        np.concatenate((np.tile(voltages, (len(seeds), 1, 1)), torques), axis=1),
        time,
        substeps=twin.substeps,
        ripples=ripples(twin),
    )
    measured = [
        {
            name: read_encoder(run[twin.simulated.rows.index(name)], encoder, random)
            for name, encoder in encoders(twin).items()
        }
        for run, random in zip(states, generators, strict=True)
    ]
    results = []
    for start in range(0, len(truths), n_experiments):
        runs = slice(start, start + n_experiments)
        results.append((_dataset(twin, time, voltages, measured[runs]), truths[runs]))
    return results


def replay(
    records: Iterable[Record],
    truths: Iterable[Mapping[str, float]],
    *,
    config: Mapping[str, Any] | None = None,
    substeps: int = 10,
) -> list[dict[str, np.ndarray]]:
    """Simulate the logged voltages with given parameters, without noise, ripple and random torques.

    Args:
        records: with the input u1, for two motors u2 too [V].
        truths: for each record the parameters and start angles (0 where absent), as `make_campaign` returns them.
        config: settings that the records were made with; may be left out for one rigid link.
        substeps: Runge-Kutta steps per sample.

    Returns:
        For each record the noise-free states: angles q_m1, ... [rad] and speeds v_m1, ... [rad/s], each (T,).
    """
    twin = None if config is None else read_settings(config)
    kind, gear_ratio = (twin.simulated, twin.gear_ratios) if twin else (ONE_LINK, (1.0,))
    outputs = []
    pairs = list(zip(records, truths, strict=True))
    for _, group in groupby(pairs, key=lambda pair: pair[0].time.tobytes()):
        runs = list(group)  # runs over the same time stamps are simulated side by side
        voltages = np.array(
            [[record.inputs[f"u{i + 1}"] for i in range(len(gear_ratio))] for record, _ in runs]
        )
        states = _simulate(
            kind,
            gear_ratio,
            [truth for _, truth in runs],
            np.concatenate((voltages, np.zeros_like(voltages)), axis=1),
            runs[0][0].time,
            substeps=substeps,
        )
        outputs += [dict(zip(kind.rows, run, strict=True)) for run in states]
    return outputs


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


def _voltages(twin: Twin) -> np.ndarray:
    """Voltages (n_experiments, n_motors, T) of each experiment: rest, then one period of each multisine."""
    n_rest, n_samples = round(twin.rest / twin.sample_time), round(twin.duration / twin.sample_time)
    plans = twin.excitation.experiments
    voltages = np.zeros((len(plans), len(twin.kind.motors), n_samples))
    for i, plan in enumerate(plans):
        for motor, sines in enumerate(plan.voltages):
            if sines is not None:
                voltages[i, motor, n_rest:] = _signal(twin, sines)
    return voltages


def _signal(twin: Twin, sines: Sines) -> np.ndarray:
    """One multisine of least crest factor [V]."""
    return design_multisine(
        sines.band,
        sample_time=twin.sample_time,
        duration=twin.duration - twin.rest,
        amplitude_limits=sines.peak,
        tones=sines.tones,
        starts=twin.excitation.starts,
        seed=sines.seed,
    ).signal


def _simulate(
    kind: Kind,
    gear_ratio: Sequence[float],
    truths: Sequence[Mapping[str, float]],
    inputs: np.ndarray,
    time: np.ndarray,
    *,
    substeps: int,
    ripples: Sequence[Wave] = (NO_RIPPLE, NO_RIPPLE),
) -> np.ndarray:
    """States (B, n_x, T) of B runs with inputs (B, n_inputs, T), voltages before random torques."""
    values = {name: np.array([truth[name] for truth in truths]) for name in kind.parameters}
    angles = np.array([[truth.get(f"q_0{motor}", 0.0) for truth in truths] for motor in kind.motors])
    system = kind.build(values, gear_ratio, ripples)
    start = start_state(kind, angles, gear_ratio)
    return integrate(system, start, inputs.transpose(2, 1, 0), time, substeps=substeps).transpose(2, 1, 0)


def _dataset(
    twin: Twin, time: np.ndarray, voltages: np.ndarray, measured: Sequence[Mapping[str, np.ndarray]]
) -> Dataset:
    """The records of one campaign, named run_00, run_01, ..."""
    records = [
        Record(
            name=f"run_{number:02d}",
            time=time,
            inputs={f"u{i}": voltage for i, voltage in enumerate(run, start=1)},
            outputs=angles,
            role=plan.role,
            note=str(plan),
        )
        for number, (plan, run, angles) in enumerate(
            zip(twin.excitation.experiments, voltages, measured, strict=True)
        )
    ]
    return Dataset(
        name=twin.name,
        inputs=tuple(Channel(f"u{i + 1}", "V") for i in range(len(twin.kind.motors))),
        outputs=tuple(
            Channel(name, "rad", float(f"{encoder.angle_noise:.4g}"))
            for name, encoder in encoders(twin).items()
        ),
        records=tuple(records),
        sample_time=twin.sample_time,
    )

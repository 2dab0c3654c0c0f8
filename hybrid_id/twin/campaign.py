"""Records of a digital twin, whose truth is known."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.twin.automaton import integrate
from hybrid_id.twin.draws import Truth, draw_torques, draw_truth, encoders, read_encoder, ripples
from hybrid_id.twin.machines import ONE_LINK, Machine, start_state
from hybrid_id.twin.model import model_description
from hybrid_id.twin.rotor import NO_RIPPLE, TorqueRipple
from hybrid_id.twin.sections import Sines
from hybrid_id.twin.settings import Twin, read_settings


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
    machine, gear_ratio = (twin.simulated, twin.gear_ratios) if twin else (ONE_LINK, (1.0,))
    outputs = []
    pairs = list(zip(records, truths, strict=True))
    for _, group in groupby(pairs, key=lambda pair: pair[0].time.tobytes()):
        runs = list(group)  # runs over the same time stamps are simulated side by side
        voltages = np.array(
            [[record.inputs[f"u{i + 1}"] for i in range(len(gear_ratio))] for record, _ in runs]
        )
        states = _simulate(
            machine,
            gear_ratio,
            [truth for _, truth in runs],
            np.concatenate((voltages, np.zeros_like(voltages)), axis=1),
            runs[0][0].time,
            substeps=substeps,
        )
        outputs += [dict(zip(machine.rows, run, strict=True)) for run in states]
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
    machine: Machine,
    gear_ratio: Sequence[float],
    truths: Sequence[Mapping[str, float]],
    inputs: np.ndarray,
    time: np.ndarray,
    *,
    substeps: int,
    ripples: Sequence[TorqueRipple] = (NO_RIPPLE, NO_RIPPLE),
) -> np.ndarray:
    """States (B, n_x, T) of B runs with inputs (B, n_inputs, T), voltages before random torques."""
    values = {name: np.array([truth[name] for truth in truths]) for name in machine.parameters}
    angles = np.array([[truth.get(f"q_0{motor}", 0.0) for truth in truths] for motor in machine.motors])
    mechanism = machine.build(values, gear_ratio, ripples)
    start = start_state(machine, angles, gear_ratio)
    return integrate(mechanism, start, inputs.transpose(2, 1, 0), time, substeps=substeps).transpose(2, 1, 0)


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

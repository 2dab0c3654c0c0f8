"""Drives on the bench: free runs of a system under given channels, and records made by them with noise.

For tests of the chain, the simulation and the identification. `batch_of` needs no measurement, so that a run starts
exactly where a test says; `make_record` turns a run into a record as a user would have logged it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.rollout import Simulation, rollout, simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible

STEP = 0.002
Signal = float | np.ndarray


def batch_of(
    system: System,
    channels: Mapping[str, Signal],
    *,
    samples: int = 0,
    step: float | np.ndarray = STEP,
    start: Mapping[str, float] | None = None,
    outputs: Sequence[str] = ("q_m1",),
    rows: int = 1,
) -> Batch:
    """A batch to simulate, without measurements.

    Args:
        system: what will be simulated.
        channels: values of each channel, a number, (T,) or (R, T).
        samples: T, where no channel tells it.
        step: sample time [s], a number or (T - 1,).
        start: state at the first sample by state name; 0 where it is not named.
        outputs: outputs to compute.
        rows: R.
    """
    samples = samples or max(np.shape(c)[-1] for c in channels.values() if np.ndim(c))
    u = {n: torch.tensor(np.broadcast_to(c, (rows, samples)).copy()) for n, c in channels.items()}
    u = {name: channel.to(torch.float64) for name, channel in u.items()}
    dt = torch.zeros(rows, samples, dtype=torch.float64)
    dt[:, :-1] = torch.as_tensor(step, dtype=torch.float64)
    x = torch.zeros(rows, samples, len(system.state_names), dtype=torch.float64)
    for name, value in (start or {}).items():
        x[:, :, system.state_names.index(name)] = value
    y = torch.zeros(rows, samples, len(outputs), dtype=torch.float64)
    names = tuple(f"row{i}" for i in range(rows))
    return Batch(u, dt, y, torch.zeros_like(y), x, torch.zeros_like(x[:, 0]), tuple(outputs), names)


def only(system: System, *free: str) -> System:
    """The system with just these parameters to estimate."""
    return system.with_specs({i.name: replace(i.spec, estimate=i.name in free) for i in system.table})


def stored(system: System, rows: int = 1) -> Tensor:
    """The system's own values for each row, (n_p, R)."""
    return system.theta().detach()[:, None].repeat(1, rows)


def run(
    system: System, channels: Mapping[str, Signal], *, engine: Engine | None = None, **settings
) -> dict[str, np.ndarray]:
    """States of the loop's free run of one row by state name, (T,) each; settings as for `batch_of`."""
    batch = batch_of(system, channels, **settings)
    x = rollout(system, engine or compiled_for(system, Engine()), batch, stored(system))[0]
    return dict(zip(system.state_names, x.T.numpy(), strict=True))


def measure(
    system: System, channels: Mapping[str, Signal], *, engine: Engine | None = None, **settings
) -> dict[str, np.ndarray]:
    """Outputs of a simulation, compiled where it can be, by output name, (T,) each; settings as for `batch_of`."""
    batch = batch_of(system, channels, **settings)
    simulation: Simulation = simulate(system, compiled_for(system, engine or Engine()), batch)
    assert simulation.status == ("ok",)
    return dict(zip(batch.outputs, simulation.y[0].T.numpy(), strict=True))


def multisine(
    seed: int, *, samples: int = 1500, amplitude: float = 10.0, rest: int = 50, step: float = STEP
) -> np.ndarray:
    """Voltage (T,) of eight tones from 0.3 to 8 Hz with random phases, after a rest."""
    generator = np.random.default_rng(seed)
    time = step * np.arange(samples - rest)
    tones = np.geomspace(0.3, 8.0, 8)[:, None]
    wave = np.sin(2 * np.pi * tones * time + generator.uniform(0, 2 * np.pi, (8, 1))).sum(0)
    return np.concatenate([np.zeros(rest), amplitude * wave / np.abs(wave).max()])


def make_record(system: System, voltage: np.ndarray, *, seed: int, name: str = "run", **settings) -> Record:
    """A record of a system driven by a voltage from rest; settings as for `make_records`."""
    return replace(make_records(system, [voltage], seeds=(seed,), **settings)[0], name=name)


def make_records(
    system: System,
    voltages: Sequence[np.ndarray],
    *,
    noise: Mapping[str, float],
    seeds: Sequence[int] | None = None,
    outputs: Sequence[str] = ("q_m1",),
    engine: Engine | None = None,
    step: float = STEP,
) -> list[Record]:
    """Records run_0, run_1, … of a system driven by voltages of one length from rest, white noise (by output) added.

    They are simulated side by side, since the loop of one row takes as long as that of many. The noise of record k is
    drawn from seed k unless told otherwise.
    """
    batch = batch_of(system, {"u1": np.stack(voltages)}, outputs=outputs, step=step, rows=len(voltages))
    engine = compiled_for(system, engine or Engine(substeps=4))  # data, however it is made
    found = simulate(system, engine, batch)
    assert set(found.status) == {"ok"}
    records = []
    for k, (seed, voltage) in enumerate(zip(seeds or range(len(voltages)), voltages, strict=True)):
        generator = np.random.default_rng(seed)
        y = dict(zip(outputs, found.y[k].T.numpy(), strict=True))
        noisy = {n: v + noise.get(n, 0.0) * generator.standard_normal(len(v)) for n, v in y.items()}
        records.append(Record(f"run_{k}", step * np.arange(len(voltage)), {"u1": voltage}, noisy))
    return records


def rigid_drive(friction: Component | None = None, *, vertical: bool = False, ratio: float = 156.0) -> System:
    """The paper's first link, rounded, with Coulomb and viscous friction unless told otherwise."""
    values = {"J": 2e-5, "P_m1": 0.019, "P_m2": 0.0254}
    values |= {} if friction else {"F_c": 0.01, "F_v": 5e-5}
    values |= {"G_l": 2.0} if vertical else {}
    return one_link(ratio, friction=friction, vertical=vertical).with_values(values)


def flexible_drive() -> System:
    """A rotor and a link behind a spring, about 9 Hz with the rotor held."""
    values = {"J_m": 1.3e-5, "J_a": 0.09, "k": 300.0, "d": 0.5, "P_m1": 0.019, "P_m2": 0.0254}
    return one_link_flexible(156.0).with_values(values | {"F_cm": 0.01, "F_vm": 5e-5, "F_va": 0.3})

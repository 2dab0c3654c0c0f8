"""From records to tensors: channels, sample times, measurements, weights, and a first guess of the states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.records.measures import rest_samples
from hybrid_id.records.record import Record
from hybrid_id.records.smoothing import noise_level, smooth_derivatives
from hybrid_id.systems.chain import System

SIGNAL_SHARE = 0.004
"""Standard deviation added to each measurement's noise, as a share of the record's: what a good model still misses."""


@dataclass(frozen=True)
class Batch:
    """Records (or windows of records) as rows of one batch, padded at their end with sample time 0 and weight 0.

    Attributes:
        u: channels, ``(R, T)`` each, held between samples.
        dt: sample times [s], ``(R, T)``; 0 in each row's last sample and after it.
        y: measured outputs, ``(R, T, n_y)``.
        weight: 1 / standard deviation of each measurement, ``(R, T, n_y)``; 0 where there is none.
        x: first guess of the states at all samples, ``(R, T, n_x)``.
        x0_std: prior standard deviation of each row's first state around ``x[:, 0]``, ``(R, n_x)``; 0 holds it.
        outputs: names of the outputs.
        names: names of the rows.
    """

    u: Mapping[str, Tensor]
    dt: Tensor
    y: Tensor
    weight: Tensor
    x: Tensor
    x0_std: Tensor
    outputs: tuple[str, ...]
    names: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.y.shape[0]

    def take(self, rows: Tensor) -> Batch:
        """The batch of some rows (indices may repeat); itself where they are all of them in order."""
        if len(rows) == self.rows and bool((rows == torch.arange(self.rows, device=rows.device)).all()):
            return self
        names = tuple(self.names[i] for i in rows.tolist())
        picked = {field: getattr(self, field)[rows] for field in ("dt", "y", "weight", "x", "x0_std")}
        return replace(self, u={name: c[rows] for name, c in self.u.items()}, names=names, **picked)

    def to(self, device: torch.device | str) -> Batch:
        """The batch on another device."""
        moved = {field: getattr(self, field).to(device) for field in ("dt", "y", "weight", "x", "x0_std")}
        return replace(self, u={name: c.to(device) for name, c in self.u.items()}, **moved)

    def windows(self, length: int, stride: int, x0_std: Tensor) -> tuple[Batch, Tensor]:
        """Short windows of the rows, each with a first state of its own, and the row that each comes from.

        Args:
            length: samples in a window.
            stride: samples from one window's start to the next one's.
            x0_std: prior standard deviation of the first states around the guess, ``(R, n_x)``.
        """
        samples, device = self.dt.shape[1], self.dt.device
        starts = torch.arange(0, max(samples - length, 0) + 1, stride, device=device)
        index = (starts[:, None] + torch.arange(length, device=device)).clamp_max(samples - 1)
        row = torch.arange(self.rows, device=device).repeat_interleave(len(starts))
        cut = {field: getattr(self, field)[:, index].flatten(0, 1) for field in ("dt", "y", "weight", "x")}
        cut["dt"][:, -1] = 0.0
        batch = replace(
            self,
            u={name: c[:, index].flatten(0, 1) for name, c in self.u.items()},
            x0_std=x0_std[row],
            names=tuple(self.names[i] for i in row.tolist()),
            **cut,
        )
        useful = (batch.weight > 0).any(2).any(1).nonzero().flatten()
        return batch.take(useful), row[useful]


def make_batch(
    system: System,
    records: Sequence[Record],
    *,
    outputs: Sequence[str] | None = None,
    noise_std: Mapping[str, float | None] | None = None,
    signal_share: float = SIGNAL_SHARE,
    estimate_start: bool = True,
) -> Batch:
    """Prepare records for simulation and fitting.

    The start angle is the mean of the samples at rest; a record that starts in motion starts from a local
    polynomial. Link angles start at rest on the motor's, bristles unloaded.

    Args:
        system: tells channels and states.
        records: at least one; lengths and sample times may differ.
        outputs: outputs to compare (default: all that the first record has).
        noise_std: standard deviation of the noise by output; estimated from the record where it is None.
        signal_share: added to the noise as a share of the signal's standard deviation.
        estimate_start: whether a fit may move the start state within its uncertainty.

    Raises:
        InputError: no record, or a channel that the system needs is missing.
    """
    if not records:
        raise InputError("There is no record to simulate; give at least one.")
    outputs = tuple(outputs if outputs is not None else records[0].outputs)
    for record in records:
        for name in (*system.input_names, *outputs):
            if name not in record.inputs and name not in record.outputs:
                raise InputError(
                    f"{record.title} has no channel '{name}', which the model needs; "
                    "add it to the dataset or change the model's input."
                )
    samples = max(record.n_samples for record in records)
    switches = [
        n for n in (f"enable{j.number}" for j in system.joints) if all(n in r.inputs for r in records)
    ]
    u = {
        name: _padded([record.signal(name) for record in records], samples)
        for name in (*system.input_names, *switches)
    }
    dt = _padded([np.append(np.diff(record.time), 0.0) for record in records], samples, hold=False)
    y = torch.stack([_padded([record.outputs[name] for record in records], samples) for name in outputs], -1)
    weight, guess, spread = torch.zeros_like(y), [], []
    for row, record in enumerate(records):
        noise = {name: _noise(record, name, noise_std) for name in record.outputs}
        for column, name in enumerate(outputs):
            std = np.hypot(noise[name], signal_share * np.std(record.outputs[name]))
            weight[row, : record.n_samples, column] = 1.0 / max(std, 1e-12)
        states, stds = _states(system, record, noise, estimate_start)
        guess.append(states)
        spread.append(stds)
    x = torch.stack([_padded([g[:, i] for g in guess], samples) for i in range(len(system.state_names))], -1)
    x0_std = torch.tensor(np.array(spread), dtype=torch.float64)
    return Batch(u, dt, y, weight, x, x0_std, outputs, tuple(record.name for record in records))


def _padded(rows: Sequence[np.ndarray], samples: int, hold: bool = True) -> Tensor:
    """Rows of different length as one tensor; the end repeats the last value (or is 0)."""
    mode = "edge" if hold else "constant"
    return torch.tensor(np.stack([np.pad(row, (0, samples - len(row)), mode=mode) for row in rows]))


def _noise(record: Record, name: str, noise_std: Mapping[str, float | None] | None) -> float:
    given = (noise_std or {}).get(name)
    return float(noise_level(record.outputs[name])) if given is None else float(given)


def _states(
    system: System, record: Record, noise: Mapping[str, float], estimate_start: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Guess of all states (T, n_x) of one record, and the uncertainty of its first row (n_x,)."""
    states = np.zeros((record.n_samples, len(system.state_names)))
    stds = np.zeros(len(system.state_names))
    resting = rest_samples(record)
    for joint in system.joints:
        n, r = joint.number, joint.gear_ratio
        scale = {f"q_m{n}": 1.0, f"q_a{n}": r}
        measured = [name for name in scale if name in record.outputs]
        speeds = [name for name in (f"v_m{n}", f"v_a{n}") if name in record.outputs]
        if measured:
            name = measured[0]
            steps = record.sample_time if record.is_uniform else record.time
            angle, speed, _ = smooth_derivatives(record.outputs[name], steps, noise[name])
            angle, speed, std = angle * scale[name], speed * scale[name], noise[name] * scale[name]
        elif speeds:
            name = speeds[0]
            factor = 1.0 if name.startswith("v_m") else r
            speed = smooth_derivatives(record.outputs[name], record.time, noise[name])[0] * factor
            angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(record.time))])
            std = 0.0
        else:
            raise InputError(
                f"{record.title} measures neither angle nor speed of joint {n}; add q_m{n}, q_a{n}, v_m{n} or v_a{n}."
            )
        rest = resting if len(joint.positions) else 0
        if measured and rest >= 5:
            angle[:rest] = np.mean(record.outputs[measured[0]][:rest]) * scale[measured[0]]
            speed[:rest] = 0.0
            start_std = (std / np.sqrt(rest), 0.0)
        else:
            start_std = (
                std,
                4.0 * std / max(20 * record.sample_time, 1e-9) if measured else noise[speeds[0]],
            )
        row = joint.positions[0]
        states[:, row], states[:, row + 1] = angle, speed
        stds[row : row + 2] = start_std
        if not joint.rigid:
            link = joint.positions[1]
            states[:, link], states[:, link + 1] = angle / r, speed / r
            if f"q_a{n}" in record.outputs and f"q_m{n}" in record.outputs:
                steps = record.sample_time if record.is_uniform else record.time
                states[:, link], states[:, link + 1], _ = smooth_derivatives(
                    record.outputs[f"q_a{n}"], steps, noise[f"q_a{n}"]
                )
                if rest >= 5:
                    states[:rest, link], states[:rest, link + 1] = (
                        np.mean(record.outputs[f"q_a{n}"][:rest]),
                        0.0,
                    )
            stds[link] = stds[row] / r
    return states, stds if estimate_start else np.zeros_like(stds)

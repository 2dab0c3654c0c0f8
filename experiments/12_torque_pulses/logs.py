"""Logs of the closed-loop runs, the pulses that were planned in them, and the score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybrid_id.diagnosis.impulses import Pulse
from hybrid_id.records.readers.csv_text import read_csv
from hybrid_id.records.record import Record
from hybrid_id.records.resample import resample_record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.systems.chain import System

INPUTS = {"tau1": "tau_con1", "tau2": "tau_con2"}
OUTPUTS = {"q_m1": "pos_meas1", "q_m2": "pos_meas2", "v_m1": "vel_meas1", "v_m2": "vel_meas2"}
SEEN = 0.1
"""Planned torque [N m] above which a pulse is told from the next one."""


def read_runs(config: Mapping[str, Any], folder: Path) -> list[Record]:
    """Runs of one folder in order of their names: commanded torques and measured motion, nothing else, on one grid."""
    found = []
    for path in sorted(folder.glob("*.csv.gz")):
        columns = read_csv(path, ["time", *INPUTS.values(), *OUTPUTS.values()]).columns
        inputs, outputs = (
            {name: np.asarray(columns[c]) for name, c in names.items()} for names in (INPUTS, OUTPUTS)
        )
        record = Record(path.name.split(".")[0], np.asarray(columns["time"]), inputs, outputs)
        found.append(resample_record(record, config["sample_time"], max_gap=config["max_gap"])[0])
    return found


def batch_of(system: System, records: Sequence[Record], noise: float) -> Batch:
    """Records with their measured angles and speeds as states."""
    batch = make_batch(
        system, records, outputs=("q_m1", "q_m2"), noise_std=dict.fromkeys(OUTPUTS, noise), signal_share=0.0
    )
    states = batch.x.clone()
    for row, record in enumerate(records):
        for name in OUTPUTS:
            states[row, : record.n_samples, system.state_names.index(name)] = torch.tensor(
                record.outputs[name]
            )
    return replace(batch, x=states)


def planned(folder: Path) -> list[tuple[str, str, float, float]]:
    """Record, joint, time of the middle [s] and size [N m] of the pulses that were added on purpose."""
    found = []
    for path in sorted(folder.glob("*.csv.gz")):
        columns = read_csv(path, ["time", "tau_pert1", "tau_pert2"]).columns
        time = np.asarray(columns["time"])
        for joint in ("joint1", "joint2"):
            torque = np.asarray(columns[f"tau_pert{joint[-1]}"])
            edges = np.flatnonzero(np.diff((np.abs(torque) > SEEN).astype(int), prepend=0, append=0))
            for start, end in zip(edges[::2], edges[1::2], strict=True):
                k = start + int(np.abs(torque[start:end]).argmax())
                found.append((path.name.split(".")[0], joint, float(time[k]), float(torque[k])))
    return found


def in_words(pulse: Pulse) -> str:
    """A claim in words."""
    return f"{pulse.record} at {pulse.time:.3f} s, {pulse.joint}: {pulse.size:+.2f} +- {pulse.std:.2f} N m"


@dataclass(frozen=True)
class Score:
    """Claims against plans at one joint, each plan met by at most one claim.

    Attributes:
        lines: one for each plan and each false claim.
        hits, plans, claims: their numbers.
    """

    lines: tuple[str, ...]
    hits: int
    plans: int
    claims: int

    @classmethod
    def of(
        cls, claims: Sequence[Pulse], plans: Sequence[tuple[str, str, float, float]], joint: str, near: float
    ) -> Score:
        """Match claims to plans of one joint within ``near`` seconds."""
        left = [claim for claim in claims if claim.joint == joint]
        count, lines, hits = len(left), [], 0
        wanted = [plan for plan in plans if plan[1] == joint]
        for record, _, time, size in wanted:
            fits = [c for c in left if c.record == record and abs(c.time - time) <= near]
            line = f"{record} at {time:.3f} s, {size:+.2f} N m: "
            if fits:
                best = min(fits, key=lambda c: abs(c.time - time))
                left.remove(best)
                hits += 1
                line += f"found at {best.time:.3f} s, {best.size:+.2f} +- {best.std:.2f} N m"
            lines.append(line if fits else f"{line}missed")
        lines += [f"false: {in_words(claim)}" for claim in left]
        return cls(tuple(lines), hits, len(wanted), count)

    def __str__(self) -> str:
        head = f"recall {self.hits} of {self.plans}, precision {self.hits} of {self.claims}"
        return "\n    ".join([head, *self.lines])

"""The arm's records, the publisher's model of it, and ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybrid_id.components import Delay, ResidualNetwork, TorqueCommand, TorqueMotor
from hybrid_id.records.readers.csv_text import read_csv
from hybrid_id.records.record import Record
from hybrid_id.records.resample import resample_record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.systems import two_link
from hybrid_id.systems.chain import System

NAMES = {  # channel: column of the later logs, column of the earlier ones
    "tau1": ("tau_con1", "tau1"),
    "tau2": ("tau_con2", "tau2"),
    "q_m1": ("pos_meas1", "pos1"),
    "q_m2": ("pos_meas2", "pos2"),
    "v_m1": ("vel_meas1", "vel1"),
    "v_m2": ("vel_meas2", "vel2"),
}


def read_day(config: Mapping[str, Any], folder: Path) -> list[Record]:
    """Records of one day in order of their names, commanded torques and measured motion on one grid."""
    found = []
    for path in sorted(folder.glob("*.csv.gz")):
        late = path.name.startswith(("trajectory", "2023"))
        columns = {name: pair[0 if late else 1] for name, pair in NAMES.items()}
        table = read_csv(path, ["time", *columns.values()])
        values = {name: np.asarray(table.columns[column]) for name, column in columns.items()}
        inputs, outputs = ({n: v for n, v in values.items() if n.startswith(k)} for k in ("tau", ("q", "v")))
        record = Record(path.name.split(".")[0], np.asarray(table.columns["time"]), inputs, outputs)
        found.append(resample_record(record, config["sample_time"])[0])
    return found


def split(
    config: Mapping[str, Any], folder: Path, how: Mapping[str, Any]
) -> tuple[list[Record], list[Record], list[Record], list[Record]]:
    """Records of a design to train on, to choose by and to test on, and all of the scored day."""
    days = {day: read_day(config, folder / day) for day in how["days"]}
    day = days[how["scored"]]
    test, looked = [day[k] for k in config["tests"]], [day[config["validates"]]]
    held = {id(record) for record in [*test, *looked]}
    train = [record for records in days.values() for record in records if id(record) not in held]
    return train, looked, test, day


def told(name: str, angles: np.ndarray | torch.Tensor, windows: Batch) -> None:
    """Print the RMS error of both angles over all windows [rad]."""
    q_1, q_2 = (torch.as_tensor(angles) - windows.y).square().mean((0, 1)).sqrt().tolist()
    print(f"{name}: q1 {q_1:.4f}, q2 {q_2:.4f} rad", flush=True)


def pieces(config: Mapping[str, Any], system: System, records: Sequence[Record], stride: float) -> Batch:
    """Windows that start at measured states and measure angles; a new one every `stride` seconds."""
    noise: dict[str, float | None] = dict.fromkeys(("q_m1", "q_m2", "v_m1", "v_m2"), config["noise"])
    outputs = ("q_m1", "q_m2")
    batch = make_batch(system, records, outputs=outputs, noise_std=noise, signal_share=0.0)
    states = batch.x.clone()
    for row, record in enumerate(records):
        for name in ("q_m1", "v_m1", "q_m2", "v_m2"):
            measured = torch.tensor(record.outputs[name])
            states[row, : len(measured), system.state_names.index(name)] = measured
    batch = replace(batch, x=states)
    length, step = (round(seconds / config["sample_time"]) for seconds in (config["window"], stride))
    cut = batch.windows(length + 1, step, 0.0 * batch.x0_std)[0]
    return cut.take((cut.weight > 0).all(2).all(1).nonzero().flatten())


def build(config: Mapping[str, Any], published: Mapping[str, float], memory: int) -> System:
    """Two links with gravity, dry and viscous friction and a dead time of each drive, at the publisher's values."""
    p, g = published, config["gravity"]
    rotor = p["gr"] ** 2 * p["Ir"]
    system = two_link(vertical=True)
    for k in (1, 2):
        system = system.with_component(f"joint{k}/input", TorqueCommand())
        system = system.with_component(f"joint{k}/motor", TorqueMotor())
        system = system.with_component(f"joint{k}/input", Delay(T_d=0.005))
    system = system.with_values(
        {
            "P_1": p["I1"] + p["I2"] + p["m2"] * p["l1"] ** 2 + rotor + p["Ir"],
            "P_2": p["I2"] + rotor,
            "P_3": p["m2"] * p["l1"] * p["r2"],
            "P_4": p["I2"] - p["gr"] * p["Ir"],
            "G_l1": g * (p["m1"] * p["r1"] + p["m2"] * p["l1"]),
            "G_l2": g * p["m2"] * p["r2"],
            **{f"F_cm{k}": p[f"cf{k}"] * math.pi / 2 for k in (1, 2)},
            **{f"F_vm{k}": p[f"b{k}"] for k in (1, 2)},
        }
    )
    for where, how in config["networks"].items():
        system = system.with_component(where, ResidualNetwork(**how, memory=memory))
    return system


@dataclass(frozen=True)
class Publisher:
    """The publisher's model: inertias about the joints, friction ``b v + cf atan(100 v)``, rotors behind a gear."""

    p: Mapping[str, float]
    gravity: float

    def rates(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Time derivative of ``(q_1, q_2, v_1, v_2)``, ``(4, B)``, under torques ``(2, B)``."""
        p, (q_1, q_2, v_1, v_2) = self.p, x
        arm, rotor = p["m2"] * p["l1"] * p["r2"], p["gr"] ** 2 * p["Ir"]
        m_11 = p["I1"] + p["I2"] + p["m2"] * p["l1"] ** 2 + 2 * arm * np.cos(q_2) + rotor + p["Ir"]
        m_12, m_22 = p["I2"] + arm * np.cos(q_2) - p["gr"] * p["Ir"], p["I2"] + rotor
        weight = self.gravity * p["m2"] * p["r2"] * np.sin(q_1 + q_2)
        carried = self.gravity * (p["m1"] * p["r1"] + p["m2"] * p["l1"]) * np.sin(q_1)
        f_1 = tau[0] + arm * np.sin(q_2) * (2 * v_1 + v_2) * v_2 - carried - weight
        f_2 = tau[1] - arm * np.sin(q_2) * v_1**2 - weight
        f_1 = f_1 - p["b1"] * v_1 - p["cf1"] * np.arctan(100 * v_1)
        f_2 = f_2 - p["b2"] * v_2 - p["cf2"] * np.arctan(100 * v_2)
        det = m_11 * m_22 - m_12**2
        return np.stack([v_1, v_2, (m_22 * f_1 - m_12 * f_2) / det, (m_11 * f_2 - m_12 * f_1) / det])

    def angles(self, system: System, batch: Batch, steps: int = 5) -> np.ndarray:
        """Simulated angles of windows prepared for a system, ``(R, T, 2)``; Runge-Kutta, `steps` steps a sample."""
        rows = [system.state_names.index(name) for name in ("q_m1", "q_m2", "v_m1", "v_m2")]
        x = batch.x[:, 0].numpy().T[rows]
        tau = np.stack([batch.u["tau1"].numpy(), batch.u["tau2"].numpy()])
        h, found = batch.dt[0, 0].item() / steps, [x[:2]]
        for k in range(batch.dt.shape[1] - 1):
            for _ in range(steps):
                a = self.rates(x, tau[:, :, k])
                b = self.rates(x + 0.5 * h * a, tau[:, :, k])
                c = self.rates(x + 0.5 * h * b, tau[:, :, k])
                d = self.rates(x + h * c, tau[:, :, k])
                x = x + h / 6 * (a + 2 * b + 2 * c + d)
            found.append(x[:2])
        return np.stack(found).transpose(2, 0, 1)

"""The machines: their records at a sensible step, and the model of each that a user would start from."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import emps
import numpy as np
import torch

from hybrid_id import Dataset, Engine, Record, System, load_model, make_batch, simulate, two_link
from hybrid_id.components import TorqueCommand, TorqueMotor
from hybrid_id.records.dataset import Channel
from hybrid_id.records.readers.csv_text import read_csv
from hybrid_id.records.resample import resample_record
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.systems.model_file import ModelFile, build_model

HERE = Path(__file__).parent
CONFIG = read_yaml(HERE / "config.yaml")


@dataclass(frozen=True, eq=False)
class Machine:
    """Records of one machine and the nominal model of it."""

    dataset: Dataset
    system: System


def changed(machine: Machine, change: Callable[[Record], Record]) -> Machine:
    """The machine with each record changed."""
    records = tuple(change(record) for record in machine.dataset)
    return replace(machine, dataset=replace(machine.dataset, records=records))


def with_tests(machine: Machine, tests: Collection[int]) -> Machine:
    """The machine with the records of these numbers as tests; the others train."""
    names = {machine.dataset.records[k].name for k in tests}
    return changed(machine, lambda r: replace(r, role="test" if r.name in names else "train"))


def xl330(data: Path, model: str = "model") -> Machine:
    """Twelve logs of the servo: duty, supply and switch to the angle; all train; as stamped without a sample time."""
    how, names = CONFIG["xl330"], ("duty1", "supply1", "enable1")
    records = []
    logs = Path(__file__).parents[1] / "02_xl330" / "servo.yaml"
    for record in Dataset.load(logs, folder=data / how["folder"]):
        if how["sample_time"] is not None:
            record = resample_record(record, how["sample_time"])[0]
        inputs = {name: record.signal(name) for name in names}
        meta = {**record.meta, "gain1": float(record.signal("gain1")[0])}
        records.append(replace(record, inputs=inputs, outputs={"q_m1": record.signal("q_m1")}, meta=meta))
    inputs = tuple(Channel(name, "V" if name == "supply1" else "1") for name in names)
    outputs = (Channel("q_m1", "rad", how["encoder_step"]),)
    dataset = Dataset("xl330", inputs, outputs, tuple(records), how["sample_time"])
    return Machine(dataset, build_model(ModelFile.model_validate(how[model])))


def dfki(data: Path, design: str) -> Machine:
    """Seven records of the arm: commanded torques to measured angles and speeds; all train."""
    how = CONFIG["dfki"]
    folder, files = data / how["folder"], how["designs"][design]
    columns = {
        **{f"tau{n}": f"tau_con{n}" for n in (1, 2)},
        **{f"q_m{n}": f"pos_meas{n}" for n in (1, 2)},
        **{f"v_m{n}": f"vel_meas{n}" for n in (1, 2)},
    }
    records = [
        _record(path, columns, 2, how["sample_time"])
        for path in sorted((folder / files["records"]).glob("*.csv.gz"))
    ]
    inputs = tuple(Channel(name, "N m") for name in columns if name.startswith("tau"))
    outputs = tuple(Channel(n, "rad" if n.startswith("q") else "rad/s") for n in columns if n[0] in "qv")
    dataset = Dataset(f"arm {design}", inputs, outputs, tuple(records), how["sample_time"])
    return Machine(dataset, published_arm(read_yaml(folder / files["parameters"]), how["gravity"]))


def published_arm(p: Mapping[str, float], gravity: float) -> System:
    """The publisher's model as two links: inertias about the joints, rotors behind gears, dry friction cf pi/2."""
    rotor, system = p["gr"] ** 2 * p["Ir"], two_link(vertical=True)
    for k in (1, 2):
        system = system.with_component(f"joint{k}/input", TorqueCommand())
        system = system.with_component(f"joint{k}/motor", TorqueMotor())
    return system.with_values(
        {
            "P_1": p["I1"] + p["I2"] + p["m2"] * p["l1"] ** 2 + rotor + p["Ir"],
            "P_2": p["I2"] + rotor,
            "P_3": p["m2"] * p["l1"] * p["r2"],
            "P_4": p["I2"] - p["gr"] * p["Ir"],
            "G_l1": gravity * (p["m1"] * p["r1"] + p["m2"] * p["l1"]),
            "G_l2": gravity * p["m2"] * p["r2"],
            **{f"F_cm{k}": p[f"cf{k}"] * math.pi / 2 for k in (1, 2)},
            **{f"F_vm{k}": p[f"b{k}"] for k in (1, 2)},
        }
    )


def qube(data: Path) -> Machine:
    """Eight records of a Furuta pendulum's arm: voltage and the pendulum's pull to the arm's angle; all train.

    The pendulum obeys ``a'' = -k cos(a) q'' + w sin(a)``, so that its pull on the arm is an inertia, counted into J,
    and ``c_w sin(a) cos(a)``; see 03_qube.
    """
    how, beside = CONFIG["qube"], HERE.parent / "03_qube"
    dataset = Dataset.load(beside / "dataset.yaml", folder=data / how["folder"])
    records = []
    for record in dataset:
        pull = 0.5 * np.sin(2.0 * record.inputs["w1"])
        record = replace(record, inputs={**record.inputs, "w1": pull})
        records.append(resample_record(record, how["sample_time"])[0])
    inputs = tuple(Channel(c.name, "1") if c.name == "w1" else c for c in dataset.inputs)
    system = load_model(beside / "model.yaml")
    for kind in how["without"]:
        system = system.without_component("joint1/load", kind)
    held = {n: replace(system.parameter(n).spec, value=v, estimate=False) for n, v in how["hold"].items()}
    made = Dataset("qube arm", inputs, dataset.outputs, tuple(records), how["sample_time"])
    return Machine(made, system.with_specs(held))


def pendulum(data: Path, values: Mapping[str, float] | None = None) -> Machine:
    """Three swing-ups of a pendulum: the torque that the drive reports to angle and speed."""
    how = CONFIG["pendulum"]
    columns = {"tau1": "torque", "q_m1": "position", "v_m1": "velocity"}
    records = []
    for name, role in how["records"].items():
        path = data / how["folder"] / f"{name}_measured.csv.gz"
        between = how["between"].get(name)
        records.append(replace(_record(path, columns, 1, how["sample_time"], between), name=name, role=role))
    outputs = (Channel("q_m1", "rad"), Channel("v_m1", "rad/s"))
    dataset = Dataset("pendulum", (Channel("tau1", "N m"),), outputs, tuple(records), how["sample_time"])
    system = build_model(ModelFile.model_validate(how["model"]))
    return Machine(dataset, system.with_values(values or {}))


def emps_twin(data: Path, *, cut: bool) -> Machine:
    """The twin of EMPS: whole records, or one record a stroke."""
    how = CONFIG["emps"]
    runs = [
        replace(record, role="test" if k in how["tests"] else "train")
        for k, record in enumerate(emps.records(how, how["sample_time"]))
    ]
    records = [stroke for run in runs for stroke in emps.cut(run)] if cut else runs
    outputs = (Channel("q_m1", "m", how["encoder_step"]),)
    dataset = Dataset("linear axis", (Channel("tau1", "N"),), outputs, tuple(records), how["sample_time"])
    return Machine(dataset, build_model(ModelFile.model_validate(how["model"])))


def window_errors(system: System, records: Sequence[Record], seconds: float) -> dict[str, float]:
    """RMS error of each angle [rad] over half overlapping free runs of some seconds from measured states."""
    angles = [name for name in records[0].outputs if name.startswith("q")]
    batch = make_batch(system, records, outputs=angles)
    states = batch.x.clone()
    for row, record in enumerate(records):
        for name, values in record.outputs.items():
            states[row, : record.n_samples, system.state_names.index(name)] = torch.tensor(values)
    length = round(seconds / batch.sample_time)
    cut, _ = replace(batch, x=states).windows(length + 1, length // 2, 0.0 * batch.x0_std)
    cut = cut.take((cut.weight > 0).all(2).all(1).nonzero().flatten())
    miss = (simulate(system, Engine(), cut).y - cut.y).square().mean((0, 1)).sqrt()
    return dict(zip(angles, miss.tolist(), strict=True))


def _record(
    path: Path,
    columns: Mapping[str, str],
    joints: int,
    sample_time: float,
    between: Sequence[float] | None = None,
) -> Record:
    """One CSV file on a uniform grid; its first ``joints`` columns are inputs."""
    table = read_csv(path, ["time", *columns.values()])
    values = {name: np.asarray(table.columns[column]) for name, column in columns.items()}
    inputs, outputs = dict(list(values.items())[:joints]), dict(list(values.items())[joints:])
    record = Record(path.name.split(".")[0], np.asarray(table.columns["time"]), inputs, outputs)
    record = record.between(*between) if between else record
    return resample_record(record, sample_time, max_gap=10.0)[0]

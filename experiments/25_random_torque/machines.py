"""Machines whose truth is known, as plain input of a diagnosis: machines.py OUT [NAME ...], all by default.

Each folder OUT/NAME holds ``dataset.yaml`` with its records, ``model.yaml``, the robot's file where the model has one,
and ``truth.yaml``: what is known, in plain words, for a judge. A diagnosis reads the first two alone. Folders that are
there stay.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import torch
from scipy.io import loadmat

from hybrid_id import Dataset, Record, load_model, make_batch
from hybrid_id.records.dataset import Channel
from hybrid_id.records.yaml_file import read_yaml, write_yaml
from hybrid_id.systems.model_file import save_model

Truth = dict[str, Any]
HERE = Path(__file__).parent


def of(experiment: str, module: str) -> ModuleType:
    """A module of another experiment, which finds its neighbours by their bare names."""
    sys.modules.pop("run", None)  # several experiments have one
    sys.path.insert(0, str(HERE.parent / experiment))
    try:
        return import_module(module)
    finally:
        sys.path.pop(0)


real_cases, real_machines = of("16_real_records", "cases"), of("16_real_records", "real_machines")
interventions, so101 = of("18_so101", "interventions"), of("18_so101", "so101")
gear, windows = of("19_tx40", "gear"), of("19_tx40", "windows")
real_machines.CONFIG["xl330"]["sample_time"] = (
    None  # as stamped: angles between two of a log's are correlated
)

SEED = 2026
SPLIT, SWITCH, EDGE, PIECES = 15_000, 500, 100, 3
"""Row at which the cogging motor's compensation is switched, rows left out around it and at the ends, pieces a half."""
COGGING = """\
system: one_link
gear_ratio: [1.0]
components:
  - {place: joint1/input, kind: current_command}
  - {place: joint1/motor, kind: current_motor, parameters: {k_t: {nominal: 0.025, estimate: false}}}
parameters:
  J: {nominal: 1.0e-5, lower: 1.0e-7, upper: 1.0e-3}
  F_c: {nominal: 1.0e-3, lower: 0.0, upper: 5.0e-2}
  F_v: {nominal: 1.0e-5, lower: 0.0, upper: 1.0e-2}
"""
FLEXIBLE = """\
system: one_link
gear_ratio: [1.0]
components:
  - {{place: joint1/input, kind: current_command}}
  - {{place: joint1/motor, kind: current_motor, parameters: {{k_t: {{nominal: {k_t}, estimate: false}}}}}}
parameters:
  J: {{nominal: {J}, lower: 1.0e-4, upper: 3.0}}
  rotor_share: {{nominal: {share}, estimate: false}}
  F_c: {{nominal: {friction}, lower: 0.0, upper: 5.0}}
  F_v: {{nominal: {friction}, lower: 0.0, upper: 10.0}}
"""
RIG = {1: (8.925, 0.0635, 0.170, 39.96), 2: (0.870, 0.0030, 0.0064, 6.86)}
"""By joint: torque of one ampere [N m/A], inertia before and behind the spring [kg m^2], stiffness [N m/rad]."""
SETS, AMONG = 4, 9
"""Sets of each change to the SO-101's records, and how many of the widest train motions a set's are drawn from."""
WRIST = ("joint_5", "joint_6")
"""Motor 6 turns with its own joint and once with each turn of joint 5."""


def cogging(data: Path, folder: Path, *, smooth: bool) -> Truth:
    """A brushless motor, current in, angle out; in the smooth half a table compensates its cogging."""
    table = pd.read_csv(data / "laas_cogging/speed_test1.txt", skipinitialspace=True)
    first, end = (SPLIT + SWITCH, len(table) - EDGE) if smooth else (EDGE, SPLIT - SWITCH)
    angle, current, step = np.unwrap(table["Position"].to_numpy()), table["Iq"].to_numpy(), 1e-3
    records = []
    for k, rows in enumerate(np.array_split(np.arange(first, end), PIECES)):
        turns = 2 * np.pi * np.floor(angle[rows[0]] / (2 * np.pi))  # each piece starts within the first turn
        values = {"i1": current[rows]}, {"q_m1": angle[rows] - turns}
        records.append(Record(f"piece_{k}", step * np.arange(len(rows)), *values))
    channels = (Channel("i1", "A"),), (Channel("q_m1", "rad"),)
    Dataset("cogging motor", *channels, tuple(records), step).save(folder)
    (folder / "model.yaml").write_text(COGGING)
    return {
        "first": "cogging",
        "place": "joint1/motor",
        "frequency": 72,
        "smaller_waves": [12, 18, 36, 84, 144],
        "amplitude_in_amperes": [0.07, 0.19] if smooth else [0.08, 0.19],
        "current_late_by_seconds": [0.0, 0.002],
        "note": "The other half names the same, with overlapping intervals of the amplitude; the inertia is positive.",
    }


def flexible(data: Path, folder: Path, *, joint: int, both: bool) -> Truth:
    """A joint of the Quanser rig: current to the motor's angle, and to that of the link's end where asked.

    The strain gauges' deflection counts from motor to link: the link's end stands at the sum of both angles, as the
    deflection falls behind where the motor accelerates.
    """
    step, records = 2e-3, []
    for experiment in ("fsf", "psf"):
        parts = (f"Im{joint}", f"th{joint}1", f"th{joint}2")
        found = (loadmat(data / f"quanser_flexible/data_{experiment}_{p}.mat")[f"data_{p}"] for p in parts)
        current, motor, twist = (table[:, -1] for table in found)  # time, goal, measured
        angles = {"q_m1": np.deg2rad(motor)} | ({"q_a1": np.deg2rad(motor + twist)} if both else {})
        records.append(Record(experiment, step * np.arange(len(current)), {"i1": current}, angles))
    outputs = tuple(Channel(name, "rad") for name in records[0].outputs)
    Dataset("flexible link", (Channel("i1", "A"),), outputs, tuple(records), step).save(folder)
    k_t, before, behind, stiffness = RIG[joint]
    J = before + behind
    text = FLEXIBLE.format(k_t=k_t, J=round(J, 6), share=round(before / J, 4), friction=round(0.05 * k_t, 5))
    (folder / "model.yaml").write_text(text)
    return {
        "first": "joint_flexibility",
        "place": "joint1/transmission",
        "stiffness": stiffness,
        "within": 0.2,
        "not": ["voltage saturation", "temperature", "gravity"],
    }


def as_before(data: Path, folder: Path, *, case: str, truth: Truth) -> Truth:
    """A case of 16_real_records."""
    machine = real_cases.CASES[case].build(data)
    machine.dataset.save(folder)
    save_model(machine.system, folder / "model.yaml")
    return truth


def arm_half(data: Path, folder: Path, *, half: int) -> Truth:
    """The SO-101 by its description: every other train motion; the five that were kept away test."""
    source = data / "so101"
    train, kept = (so101.load(source, role)[role] for role in ("train", "aside"))
    tests = (replace(record, role="test") for record in kept)
    replace(train, records=(*train.records[half::2], *tests)).save(folder)
    shutil.copyfile(source / interventions.MJCF, folder / interventions.MJCF)
    save_model(interventions.nominal(folder, table=False), folder / "model.yaml")
    return {
        "first": "unknown; the other half names the same first value and first law at 4 of 5 joints",
        "known": "The gripper touches a table at a height of -35 mm, which the description does not have.",
        "test": "Corrected errs less than re-fitted on the test motions.",
    }


def arm_changed(data: Path, folder: Path, *, kind: str, number: int) -> Truth:
    """The SO-101 by the model that was fitted to untouched motions, with one thing changed at one joint.

    Each set has motions of its own; the joint is the next of those at which the change is meaningful.
    """
    source = data / "so101"
    values = interventions.identified(source, folder.parent / ".so101_fit.json")
    train, kept = (so101.load(source, role)[role] for role in ("train", "aside"))
    chosen = np.random.default_rng([SEED, number]).permutation(AMONG)[: interventions.TRAIN]
    widest = interventions.widest(train, AMONG)
    tests = (replace(r, role="test") for r in interventions.widest(kept, interventions.TEST))
    motions = replace(train, records=(*(widest[k] for k in sorted(chosen)), *tests))
    able = interventions.joints_for(kind, motions)
    joint = able[number % len(able)] if able else ""
    interventions.write(folder, source, motions, values, kind, joint)
    said: dict[str, Truth] = {
        "payload": {"model_over_machine": interventions.HEAVIER, "note": "Mass, inertia of gripper and jaw."},
        "delay": {"seconds": interventions.LATE, "model_has": round(values.get(f"T_d_{joint}", 0.0), 5)},
        "zero": {
            "radians": round(float(interventions.TURNED), 5),
            "note": "The encoder shows so much too much.",
        },
        "gain": {"model_over_machine": interventions.STIFFER, "note": "k_p is too large in the model."},
    }
    return {"first": kind, "place": joint or interventions.CARRIED[0], **said[kind]}


def fault(data: Path, folder: Path, *, source: str, truth: Truth) -> Truth:
    """A fault as a user reported it."""
    folder.mkdir()
    for file in sorted((data.parent / "faults" / source).iterdir()):
        if file.name not in ("README", "truth_model.yaml"):
            shutil.copyfile(file, folder / file.name)
    return truth


def wrist(data: Path, folder: Path, *, half: int | None) -> Truth:
    """The TX40 by joints, its drives fitted to free windows, by a model that does not know its wrist's coupling."""
    source, kept = data / "staubli_tx40", folder.parent / ".tx40_drives"
    if not (kept / "model.yaml").exists():
        save_model(drives(source, kept), kept / "model.yaml")
    dataset = gear.by_joint(gear.pieces(source))
    role = {k: "train" if half is None or k % 2 == half else "test" for k in range(len(dataset))}
    replace(dataset, records=tuple(replace(r, role=role[k]) for k, r in enumerate(dataset))).save(folder)
    content = dict(read_yaml(kept / "model.yaml"))
    robot = source / Path(content["robot"]["file"]).name
    shutil.copyfile(robot, folder / robot.name)
    del content["couplings"]
    write_yaml(folder / "model.yaml", content | {"robot": {"file": robot.name}})
    halves = "At joints 1 to 3 the other half names the same first cause."
    return {"first": "coupled gear of the wrist", "place": list(WRIST), "turns": 1.0, "note": halves}


def drives(source: Path, out: Path) -> Any:
    """Friction, offsets and rotors fitted to free windows of the first two thirds, started by inverse dynamics."""
    inverse = windows.inverse
    angles, torque = inverse.read(source)
    split = round(inverse.SPLIT * len(angles))
    motors = np.linalg.solve(inverse.MOTORS.T, torque[:split].T).T / windows.RATIO * windows.SIGN
    part = windows.record_of(angles[:split], motors)
    (values,) = windows.inverse_dynamics(source, angles[:split], torque[:split], [np.ones(split, bool)])
    system = windows.model(source, out, values, ())
    off = 1e-3 * windows.rms(windows.errors(system, windows.windows(system, part, np.ones(6))))
    return windows.fitted(system, windows.windows(system, part, off * np.sqrt(windows.LENGTH)))


LOADED = {"first": "load_dependent_friction", "place": "joint1/motor_friction", "halves_of_ten": 9}
SHAKEN = {"first": "unknown; the other half names the same first cause or the same honest remainder"}
GAIN = {"first": "gains of the position loop", "place": "shoulder/input", "factor": 4.0, "k_p": 40.0}
LOST = {"first": "derivative gain and torque limit", "place": "Rotation/input", "k_d": 5.13, "tau_max": 3.5}
CHANGES: Mapping[str, Truth] = {
    "load_plus_30": {"first": "payload", "model_over_machine": 1.3, "note": "Weight and the link's inertia."},
    "delay_30ms": {"first": "delay", "place": "joint1/input", "seconds": 0.03},
    "bias": {"first": "offset of the command", "place": "joint1/input"},
}
BIAS = {"xl330": {"duty": 0.08, "volts": 0.6}, "pendulum": {"newton_metres": 0.4}}
"""By which the logged command is larger than the one that acted."""


def cases() -> dict[str, Callable[[Path, Path], Truth]]:
    """What writes each folder, by its name: from the folder of the data into the new one, returning the truth."""
    found: dict[str, Callable[[Path, Path], Truth]] = {
        "laas_rough": partial(cogging, smooth=False),
        "laas_smooth": partial(cogging, smooth=True),
        "fault_gain_4x": partial(fault, source="gain_4x_headline", truth=GAIN),
        "fault_kd_and_limit": partial(fault, source="so100_kd_and_limit_named_rate_limit", truth=LOST),
    }
    for k in range(10):
        found[f"xl330_half_{k}"] = partial(as_before, case=f"xl330_half_{k}", truth=LOADED)
    for machine in ("xl330", "pendulum"):
        for change, truth in CHANGES.items():
            known = truth | (BIAS[machine] if change == "bias" else {})
            case = f"{machine}_{change}"
            found[f"{machine}_{change.split('_')[0]}"] = partial(as_before, case=case, truth=known)
    for half in (0, 1):
        found[f"so101_half_{half}"] = partial(arm_half, half=half)
    for kind in interventions.KINDS:
        for number in range(SETS):
            found[f"so101_{kind}_{number}"] = partial(arm_changed, kind=kind, number=number)
    for both in (False, True):
        for joint in RIG:
            found[f"quanser_{joint}{'_both' * both}"] = partial(flexible, joint=joint, both=both)
    for design in ("A0", "C1"):
        for half in (0, 1):
            found[f"dfki_{design}_{half}"] = partial(
                as_before, case=f"dfki_{design}_{half + 1}", truth=SHAKEN
            )
    for half in (0, 1, None):
        found["tx40" if half is None else f"tx40_{half}"] = partial(wrist, half=half)
    return found


def checked(folder: Path) -> str:
    """One line on a folder that a diagnosis can read."""
    dataset, system = Dataset.load(folder), load_model(folder / "model.yaml")
    batch = make_batch(system, dataset.train or dataset.records, signal_share=0.0)
    return f"{dataset!r}, {batch.rows} x {batch.y.shape[1]} samples, {len(system.estimated)} values estimated"


def main() -> None:
    """Write the folders that are asked for, or all, and load each as a diagnosis does."""
    known = cases()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="faults lie beside it")
    wish = parser.parse_args()
    if wrong := set(wish.names) - set(known):
        parser.error(f"there is no machine {', '.join(sorted(wrong))}")
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    for name in wish.names or known:
        folder = wish.out.resolve() / name
        if not (folder / "truth.yaml").exists():
            shutil.rmtree(folder, ignore_errors=True)  # one that was not finished
            write_yaml(folder / "truth.yaml", known[name](wish.data.resolve(), folder))
        print(f"{name}: {checked(folder)}", flush=True)


if __name__ == "__main__":
    main()

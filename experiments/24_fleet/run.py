"""Makes a fleet of drives and compares what `fleet` says of it with what was drawn.

    run.py make FOLDER [--robots 200] [--seed 2901]   # FOLDER/robots: a dataset folder a robot; FOLDER/truth.json apart
    hybrid-id fleet FOLDER/robots --model FOLDER/model.yaml --out FOLDER/result
    run.py check FOLDER

Robots differ by their spread, their friction drifts from record to record, and a few are out of order, each in one way.
The records come from the physics of `hybrid_id.machines`, which shares no code with the models.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from hybrid_id.machines.physics.bench import Encoders, Program, run
from hybrid_id.machines.physics.friction import Coulomb, Viscous
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink
from hybrid_id.machines.physics.motor import Cogging, Motor
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import design_multisine
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import write_yaml

RATIO, STEP, SECONDS, RECORDS, REST = 100.0, 0.002, 5.0, 5, 0.1
TYPICAL = {"J": 2.4e-5, "P_m1": 0.022, "P_m2": 0.031, "F_c": 0.012, "F_v": 6e-5}
SPREAD = {"J": 0.04, "P_m1": 0.01, "P_m2": 0.01, "F_c": 0.12, "F_v": 0.15}
DRIFT = {"F_c": 0.04, "F_v": 0.04}
NOISE, COUNTS = 0.002, 1024
FAULTS = (
    ("payload", {"J": 1.4}),
    ("payload", {"J": 1.4}),
    ("tight bearing", {"F_c": 1.8}),
    ("tight bearing", {"F_c": 1.8}),
    ("stiff grease", {"F_v": 3.5}),
    ("weak magnets", {"P_m1": 0.8, "P_m2": 0.8}),
    ("cogging", {}),
    ("cogging", {}),
)
COGGING, PERIODS = 0.5, 5.0
"""Amplitude as a share of the Coulomb friction, and waves a turn, of the robots with cogging, which the model lacks."""


def draw(robots: int, seed: int) -> tuple[dict[str, np.ndarray], dict[int, str]]:
    """Parameters of each robot (n,), and which are out of order."""
    random = np.random.default_rng(seed)
    truth = {k: v * np.exp(SPREAD[k] * random.standard_normal(robots)) for k, v in TYPICAL.items()}
    truth["cogging"] = np.zeros(robots)
    share = FAULTS[: max(1, round(len(FAULTS) * min(robots / 200, 1.0)))]
    sick = random.choice(robots, len(share), replace=False)
    for i, (name, factors) in zip(sick, share, strict=True):
        for parameter, factor in factors.items():
            truth[parameter][i] = TYPICAL[parameter] * factor
        if name == "cogging":
            truth["cogging"][i] = COGGING * truth["F_c"][i]
    return truth, {int(i): name for i, (name, _) in zip(sick, share, strict=True)}


def relative(truth: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The parameters of a model whose motor constants are the typical ones, which has the same motion."""
    gain = TYPICAL["P_m1"] / truth["P_m1"]
    braking = gain * (truth["F_v"] + truth["P_m1"] * truth["P_m2"])
    return {
        "J": gain * truth["J"],
        "F_c": gain * truth["F_c"],
        "F_v": braking - TYPICAL["P_m1"] * TYPICAL["P_m2"],
    }


def make(folder: Path, robots: int, seed: int) -> None:
    """Records of all robots, all at once."""
    truth, sick = draw(robots, seed)
    random = np.random.default_rng([seed, 1])
    lanes, samples, resting = robots * RECORDS, round(SECONDS / STEP), round(REST / STEP)
    every = {name: np.repeat(values, RECORDS) for name, values in truth.items()}
    for name, share in DRIFT.items():
        every[name] = every[name] * np.exp(share * random.standard_normal(lanes))
    feed = np.zeros((samples, 1, lanes))
    for k in range(RECORDS):
        signal = design_multisine(
            (0.4, 8.0),
            sample_time=STEP,
            duration=SECONDS - REST,
            amplitude_limits=7.0 + k,
            tones=8,
            starts=3,
            seed=k,
        ).signal
        feed[resting:, 0, k::RECORDS] = signal[: samples - resting, None]
    still = np.zeros((1, lanes))
    program = Program(feed, np.zeros_like(feed), still, still, still, still + 24.0, np.zeros_like(feed))
    drive = Drive(
        Gear(RATIO),
        every["J"],
        Motor(every["P_m1"], every["P_m2"]),
        rotor_laws=[
            Coulomb(every["F_c"]),
            Viscous(every["F_v"]),
            Cogging([every["cogging"]], [PERIODS], [0.3]),
        ],
    )
    encoders = Encoders(np.array([2 * np.pi / COUNTS]), NOISE * random.standard_normal((samples, 1, lanes)))
    volts, angles = run(Machine([drive], OneLink(0.0)), program, encoders, sample_time=STEP, rest=REST)
    time = STEP * np.arange(samples)
    for i in range(robots):
        records = [
            Record(f"rec_{k}", time, {"u1": volts[:, 0, j]}, {"q_m1": angles[:, 0, j]})
            for k, j in enumerate(range(i * RECORDS, (i + 1) * RECORDS))
        ]
        noise = float(np.hypot(NOISE, 2 * np.pi / COUNTS / np.sqrt(12)))
        channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", noise_std=noise),)
        name = f"robot_{i + 1:03d}"
        Dataset(name, *channels, tuple(records), sample_time=STEP).save(folder / "robots" / name)
    write_yaml(folder / "model.yaml", model())
    said = {"seed": seed, "sick": {f"robot_{i + 1:03d}": name for i, name in sick.items()}}
    said["truth"] = {name: values.tolist() for name, values in relative(truth).items()}
    (folder / "truth.json").write_text(json.dumps(said))
    print(f"{robots} robots in {folder / 'robots'}")


def model() -> dict:
    """The model of all: Coulomb and viscous friction, motor constants from the data sheet, start values 30 % off."""
    start = {"J": 1.7e-5, "F_c": 0.016, "F_v": 8e-5}
    units = {"J": "kg m^2", "F_c": "N m", "F_v": "N m s/rad", "P_m1": "N m/V", "P_m2": "V s/rad"}
    entries = {name: {"nominal": value, "unit": units[name]} for name, value in start.items()}
    entries |= {
        name: {"nominal": TYPICAL[name], "prior_std": 0.03 * TYPICAL[name], "unit": units[name]}
        for name in ("P_m1", "P_m2")
    }
    frictions = [
        {
            "place": "joint1/motor_friction",
            "kind": "coulomb_friction",
            "parameters": {"F_c": entries.pop("F_c")},
        },
        {
            "place": "joint1/motor_friction",
            "kind": "viscous_friction",
            "parameters": {"F_v": entries.pop("F_v")},
        },
    ]
    return {
        "system": "one_link", "gear_ratio": [RATIO], "gravity": "none", "parameters": entries, "components": frictions,
    }  # fmt: skip


def check(folder: Path) -> None:
    """Mean, spread and odd robots beside what was drawn."""
    said = json.loads((folder / "truth.json").read_text())
    found = json.loads((folder / "result" / "fleet.json").read_text())
    whole = [name not in said["sick"] for name in found["robots"]]
    for name, truth in said["truth"].items():
        one, values = found["parameters"][name], np.array(truth)[whole]
        inside = [
            low <= value <= (np.inf if high is None else high)
            for value, (low, high) in (
                (values.mean(), one["mean_interval"]),
                (values.std(ddof=1), one["spread_interval"]),
            )
        ]
        own = np.array(
            [
                abs(found["by_robot"][robot]["values"][name] - value)
                <= 1.96 * found["by_robot"][robot]["std_errors"][name]
                for robot, value in zip(found["robots"], truth, strict=True)
            ]
        )
        print(
            f"{name}: mean {one['mean']:.4g}, drawn {values.mean():.4g}, in the interval: {inside[0]}; spread "
            f"{one['spread']:.3g}, drawn {values.std(ddof=1):.3g}, in the interval: {inside[1]}; intervals of "
            f"robots that hold the truth: {own.sum()} of {len(own)}"
        )
    odd = {one["robot"]: one for one in found["odd"]}
    for robot, name in said["sick"].items():
        print(f"{robot} ({name}): {'; '.join(odd[robot]['why']) if robot in odd else 'NOT FOUND'}")
    print(f"false alarms: {sorted(set(odd) - set(said['sick']))} of {sum(whole)}")


def main() -> None:
    """Make or check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("make", "check"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2901)
    asked = parser.parse_args()
    if asked.what == "make":
        make(asked.folder, asked.robots, asked.seed)
    else:
        check(asked.folder)


if __name__ == "__main__":
    main()

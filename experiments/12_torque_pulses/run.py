"""Torque pulses on DFKI's two-link arm, found from commanded torque and measured motion (README.md beside this)."""

import sys
from pathlib import Path

import torch
from logs import Score, batch_of, in_words, planned, read_runs

sys.path.insert(1, str(Path(__file__).parents[1] / "08_double_pendulum"))
from arm import build  # pyright: ignore[reportMissingImports]

from hybrid_id.diagnosis.impulses import calibrate
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.simulation.solvers import OdeEngine

torch.set_num_threads(1)
config = read_yaml(Path(__file__).with_name("config.yaml"))
data = Path(sys.argv[1] if len(sys.argv) > 1 else config["data"])
system = build(config, read_yaml(data / "parameters" / config["parameters"]), 0)
engine = OdeEngine(fine=4, width=config["width"])

for task in config["tasks"]:
    quiet = read_runs(config, data / "closed_loop" / f"{task}_nominal")
    pushed = read_runs(config, data / "closed_loop" / f"{task}_perturbed")
    truth = planned(data / "closed_loop" / f"{task}_perturbed")
    for name, first, rest in (("", quiet[:2], quiet[2:]), (", halves swapped", quiet[2:], quiet[:2])):
        batch = batch_of(system, first, config["noise"])
        detector = calibrate(system, engine, batch, widths=config["widths"], rate=config["rate"])
        print(f"{task}{name}: thresholds {', '.join(f'{h:.2f}' for h in detector.threshold)} standard errors")
        claims = detector.find(batch_of(system, rest, config["noise"]))
        print(
            f"  unperturbed repeats: {len(claims)} claimed in {len(rest)} records",
            *map(in_words, claims),
            sep="\n    ",
        )
        claims = detector.find(batch_of(system, pushed, config["noise"]))
        for joint in ("joint1", "joint2"):
            print(f"  {joint}: {Score.of(claims, truth, joint, config['near'])}")

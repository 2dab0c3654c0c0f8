"""A drive with an effect that the model lacks, and physics with a network on its records (README.md beside this).

Usage: ``python run.py [cogging|load|none] [seed]``.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from machine import make
from score import off_truth, outcome, spread

from hybrid_id.identification.hybrid import HybridOptions, HybridResult
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.study.hybrid import hybridise

kind = sys.argv[1] if len(sys.argv) > 1 else "cogging"
seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
torch.set_num_threads(1)
config = read_yaml(Path(__file__).with_name("config.yaml"))
machine = make(config, kind, seed)
wish: dict[str, Any] = dict(config["machines"][kind]["training"])
if "windows" in wish:
    wish["windows"] = tuple(map(tuple, wish["windows"]))
options = HybridOptions(**wish)
engine = OdeEngine(fine=8, width=config["width"])


study = hybridise(machine.dataset, machine.model, engine=engine, options=options)
print(*outcome(machine, study), *spread(machine, study), sep="\n", flush=True)
print(*(f"! {warning}" for warning in study.warnings), sep="\n", flush=True)
if kind in config["unpriced"]:
    free = replace(options, price=0.0)
    result: HybridResult = hybridise(machine.dataset, machine.model, engine=engine, options=free).result
    print("  without any price:", off_truth(machine, result.models[-1]))

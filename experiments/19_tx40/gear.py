"""Staubli TX40 by a model that does not know its wrist's coupling: gear.py --data FOLDER --model FILE."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import run as inverse
import torch
from diagnose import pieces
from rich.console import Console
from windows import RATIO

from hybrid_id import diagnose_arm
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.reporting.arm_diagnosis import arm_page
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model


def uncoupled(file: Path, out: Path) -> System:
    """The drives as windows.py has left them, each motor at one joint alone."""
    said = dict(read_yaml(file))
    del said["couplings"]
    said["robot"] = {"file": str((file.parent / said["robot"]["file"]).resolve())}
    (out / "uncoupled.yaml").write_text(json.dumps(said))  # which is YAML
    return load_model(out / "uncoupled.yaml")


def by_joint(dataset: Dataset) -> Dataset:
    """The records with the joints' angles [rad], as a controller logs them, instead of the motors'."""
    records = []
    for record in dataset.records:
        angles = [record.outputs[f"q_m{k + 1}"] / RATIO[k] for k in range(6)]
        angles[5] = angles[5] - angles[4]
        records.append(replace(record, outputs={f"q_a{k + 1}": q for k, q in enumerate(angles)}))
    outputs = tuple(Channel(f"q_a{k + 1}", "rad") for k in range(6))
    return replace(dataset, outputs=outputs, records=tuple(records))


def main() -> None:
    """Diagnose all six joints; which gear is missing, and the rest."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--model", type=Path, default=Path("runs/19_tx40_drives/model.yaml"), help="the drives")
    ask.add_argument("--out", type=Path, default=Path("runs/19_tx40_gear"))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    began = time.process_time()
    found = diagnose_arm(
        by_joint(pieces(wish.data)), uncoupled(wish.model, wish.out), horizon=Horizon.of(inverse.WINDOW)
    )
    (wish.out / "diagnosis.json").write_text(json.dumps(found.as_dict()))
    Console(width=160).print(arm_page(found, {}, {}).screen())
    print(f"{found.gears}\n{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()

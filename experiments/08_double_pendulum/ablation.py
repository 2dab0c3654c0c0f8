"""Which joint wants a network, and does it have to know the other joint? Windows of DFKI's arm, see README.md."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from arm import build, split
from rich.console import Console

from hybrid_id.identification.hybrid import HybridOptions
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.reporting.ablation import arms_table, parameters_table
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.study.ablation import ALL, NONE, STATIC, Arm, Cell, Task, run_cell, split_records
from hybrid_id.study.ablation_result import gather, verdict

INPUTS = ("angle", "speed", "direction", "command")
JOINTS = ("joint1/motor", "joint2/motor")
SEEDS = (0, 1, 2)
Role = Literal["train", "test"]


def windows(config: dict[str, Any], records: Sequence[Record], role: Role) -> list[Record]:
    """Parts of records as records of their own, one in `every` of their lengths."""
    length = round(config["window"] / config["sample_time"]) + 1
    found = []
    for record in records:
        for first in range(0, len(record.time) - length, config["every"] * (length - 1)):
            inputs, outputs = (
                {name: np.asarray(values)[first : first + length] for name, values in channels.items()}
                for channels in (record.inputs, record.outputs)
            )
            time = config["sample_time"] * np.arange(length)
            found.append(Record(f"{record.name}_{first}", time, inputs, outputs, role=role))
    return found


def main(folder: Path, design: str) -> None:
    """Print the table of one design."""
    torch.set_num_threads(1)
    config = read_yaml(Path(__file__).with_name("config.yaml"))
    how = config["designs"][design]
    train, looked, test, _ = split(config, folder / "sys_id", how)
    published = read_yaml(folder / "parameters" / how["parameters"])
    system = build(config | {"networks": {}}, published, 0)
    parts = [*windows(config, [*train, *looked], "train"), *windows(config, test, "test")]
    outputs = tuple(
        Channel(f"{kind}{k}", unit, config["noise"])
        for k in (1, 2)
        for kind, unit in (("q_m", "rad"), ("v_m", "rad/s"))
    )
    inputs = tuple(Channel(f"tau{k}", "N m") for k in (1, 2))
    dataset = Dataset(f"dfki_{design}", inputs, outputs, tuple(parts), signal_share=0.0)
    wish = config["training"] | {"windows": tuple(config["training"]["windows"])}
    task = Task(
        dataset, system, OdeEngine(fine=4, width=config["width"]), HybridOptions(**wish), INPUTS,
        horizon=config["window"] / 2,
    )  # fmt: skip
    hybrid = Arm(STATIC, JOINTS, 6)
    arms = [
        Arm(NONE),
        *(replace(hybrid, places=(place,)) for place in JOINTS),
        hybrid,
        replace(hybrid, reads=ALL),
    ]
    cells = [Cell(arm, seed, split_records(dataset, seed)) for seed in SEEDS for arm in arms]
    results = []
    for cell in cells:
        result = run_cell(task, cell)
        results.append(result)
        error = result.best.error(cell.split.test)
        print(f"{cell.name} {error:.4g} {result.seconds:.0f} s", flush=True)
    result = gather(results)
    Console(width=160).print(*verdict(result), arms_table(result), parameters_table(result), sep="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:] or ["C.1"])

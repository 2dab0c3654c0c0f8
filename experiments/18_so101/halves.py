"""SO-101: what each of five joints lacks, by one of two halves of the train motions: halves.py --data FOLDER HALF."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import so101
import torch
from sets import CARRIES_NOTHING, CLIPPED, TABLE

from hybrid_id import diagnose
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.by_joint import alone, joint_number, moving_records, with_others_measured
from hybrid_id.systems.chain import System


def nominal(folder: Path, *, table: bool = True) -> System:
    """The user's description and the servo's data sheet; what single motions cannot identify is held.

    Args:
        folder: holds ``so101_new_calib.xml``.
        table: whether the model knows the table under the arm, which no description has.
    """
    system = so101.model(folder, floor=table)
    known = {info.symbol: info.name for info in system.table}
    fixed = CLIPPED | {f"k_p_{joint}": value for joint, value in CARRIES_NOTHING.items()}
    fixed |= {known[symbol]: value for symbol, value in TABLE.items()} if table else {}
    return system.with_specs(
        {n: replace(system.parameter(n).spec.at(v), estimate=False) for n, v in fixed.items()}
    )


def diagnosed(motions: Dataset, system: System, joint: str) -> Diagnosis:
    """One joint by itself, as :func:`hybrid_id.diagnose_arm` does it before it simulates all joints together."""
    k = joint_number(system, joint)
    return diagnose(with_others_measured(moving_records(motions, k), system, k), alone(system, k))


def main() -> None:
    """Diagnose each joint of one half; a file a joint and half, those that are there stay."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--out", type=Path, default=Path("runs/so101_diagnosis"))
    ask.add_argument("--table", action="store_true", help="the model knows the table under the arm")
    ask.add_argument("half", type=int, choices=(0, 1))
    ask.add_argument("joints", nargs="*", default=[])
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    motions = so101.load(wish.data, "train")["train"]
    motions = replace(motions, records=motions.records[wish.half :: 2])
    for joint in wish.joints or so101.JOINTS:
        file, began = wish.out / f"{joint}_{wish.half}.json", time.process_time()
        if file.exists():
            continue
        found = diagnosed(motions, nominal(wish.data, table=wish.table), joint)
        seconds = time.process_time() - began
        file.write_text(json.dumps(found.as_dict() | {"seconds": seconds}))
        print(f"{joint}, half {wish.half}, {seconds:.0f} s\n{found.summary()}", flush=True)


if __name__ == "__main__":
    main()

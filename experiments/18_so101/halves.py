"""SO-101: what each joint lacks, by one of two halves of the train motions: halves.py --data FOLDER HALF."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import so101
import torch
from sets import CARRIES_NOTHING, CLIPPED, TABLE

from hybrid_id import diagnose_arm
from hybrid_id.diagnosis.arm import ArmDiagnosis
from hybrid_id.identification.keep import Kept
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.provenance import program
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


def diagnosed(motions: Dataset, system: System, out: Path, file: str) -> ArmDiagnosis:
    """The arm diagnosed by some motions, which writes a file into a folder; fits that are there stay.

    Args:
        motions: the train motions.
        system: the nominal model.
        out: the folder.
        file: name of the file of the answer.
    """
    fits, began = out / "fits", time.process_time()
    fits.mkdir(parents=True, exist_ok=True)
    found = diagnose_arm(motions, system, kept=Kept(fits, program()))
    seconds = time.process_time() - began
    (out / file).write_text(json.dumps(found.as_dict() | {"seconds": seconds}))
    for joint, one in found.joints.items():
        print(f"{joint}: {one.summary()}\n")
    print(f"{seconds:.0f} s of processor time", flush=True)
    return found


def main() -> None:
    """Diagnose the arm by the motions of one half."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--out", type=Path, default=Path("runs/so101_diagnosis"))
    ask.add_argument("--table", action="store_true", help="the model knows the table under the arm")
    ask.add_argument("half", type=int, choices=(0, 1))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    motions = so101.load(wish.data, "train")["train"]
    motions = replace(motions, records=motions.records[wish.half :: 2])
    diagnosed(motions, nominal(wish.data, table=wish.table), wish.out, f"half_{wish.half}.json")


if __name__ == "__main__":
    main()

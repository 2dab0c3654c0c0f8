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
from hybrid_id.identification.keep import Kept
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


def main() -> None:
    """Diagnose the arm by the motions of one half; fits that are there stay, so that it can be stopped."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--out", type=Path, default=Path("runs/so101_diagnosis"))
    ask.add_argument("--table", action="store_true", help="the model knows the table under the arm")
    ask.add_argument("half", type=int, choices=(0, 1))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    fits = wish.out / "fits"
    fits.mkdir(parents=True, exist_ok=True)
    motions = so101.load(wish.data, "train")["train"]
    motions = replace(motions, records=motions.records[wish.half :: 2])
    began = time.process_time()
    found = diagnose_arm(motions, nominal(wish.data, table=wish.table), kept=Kept(fits, "so101"))
    seconds = time.process_time() - began
    content = found.as_dict() | {"seconds": seconds}
    (wish.out / f"half_{wish.half}.json").write_text(json.dumps(content))
    for joint, one in found.joints.items():
        print(f"{joint}: {one.summary()}\n")
    print(f"half {wish.half}, {seconds:.0f} s of processor time", flush=True)


if __name__ == "__main__":
    main()

"""Arms that lack one thing at one joint, diagnosed joint by joint: run.py SEED [--arms N] [--out FOLDER]."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import arms
import torch

from hybrid_id import Dataset, diagnose_arm, load_model
from hybrid_id.diagnosis.arm import ArmDiagnosis

KINDS = (*arms.LACKS, "nothing")
ALIKE = {"delay": {"delay", "electrical_lag"}}
"""Names that say the same of an arm's servo; the lag of a winding is its delay to first order."""


def judged(truth: arms.Arm, found: ArmDiagnosis) -> dict[str, object]:
    """What the diagnosis has right: the joint, the name, the name among those that it cannot distinguish."""
    first = found.selected[0] if found.selected else None
    said = None if first is None else first.where.rpartition("/")[0]
    tied = [] if first is None else [first.name, *(tie.split("@")[0] for tie in first.tied_with)]
    at = truth.names[truth.at] if truth.missing != "nothing" else None
    # all joints that carry a link see its mass
    places = set(truth.names[: truth.at + 1]) if truth.missing == "link_mass" else {at}
    return {
        "missing": truth.missing, "at": at, "size": truth.size, "joints": len(truth.joints), "verdict": found.verdict,
        "unknown": found.unknown, "named": [f"{e.name}@{e.where} {e.probability:.2f}" for e in found.selected],
        "joint": said in places if first else None, "name": bool(first) and first.name == truth.missing,
        "tied": truth.missing in tied, "parts": {k: round(v, 3) for k, v in found.parts.items()},
        "shrink": None if found.shrink is None else [found.shrink.share, *found.shrink.interval],
        "errors": None if found.shrink is None else [found.nominal_errors.nrmse if found.nominal_errors else None,
                                                     found.shrink.refit, found.shrink.with_effect],
    }  # fmt: skip


def main() -> None:
    """Make, diagnose and judge; what is there stays."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("seed", type=int)
    ask.add_argument("--arms", type=int, default=len(KINDS))
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--out", type=Path, default=Path("runs/arms"))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    for i in range(wish.first, wish.arms):
        folder, missing = wish.out / f"{wish.seed}_{i}", KINDS[i % len(KINDS)]
        file = folder / "judged.json"
        if file.exists():
            continue
        truth, began = arms.write(folder, wish.seed + i, missing), time.process_time()
        found = diagnose_arm(Dataset.load(folder / "records"), load_model(folder / "model.yaml"))
        said = judged(truth, found) | {"seconds": time.process_time() - began}
        (folder / "diagnosis.json").write_text(json.dumps(found.as_dict()))
        file.write_text(json.dumps(said))
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()

"""SO-101: a network at each of five joints for what the data sheet's physics leaves: networks.py --data FOLDER."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import so101
import torch
from halves import nominal

from hybrid_id.reporting.residual_torques import residuals_result
from hybrid_id.study.residual_torques import learn_residuals


def main() -> None:
    """Learn on the 15 train motions, test on the five that were kept away; the ten test motions stay closed."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--out", type=Path, default=Path("runs/so101_networks"))
    ask.add_argument("joints", nargs="*", default=[])
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    train, kept = (so101.load(wish.data, role)[role] for role in ("train", "aside"))
    records = (*train.records, *(replace(record, role="test") for record in kept.records))
    for joint in wish.joints or so101.JOINTS:
        file, began = wish.out / f"{joint}.json", time.process_time()
        if file.exists():
            continue
        found = learn_residuals(replace(train, records=records), nominal(wish.data), [joint])
        said, seconds = residuals_result(found), time.process_time() - began
        file.write_text(json.dumps(said | {"seconds": seconds}))
        print(joint, json.dumps(said["joints"][joint]), f"{seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()

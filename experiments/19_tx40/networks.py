"""Staubli TX40: a network at each joint for what the drives leave: networks.py --data FOLDER [JOINT]."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import run as inverse
import torch
from diagnose import pieces
from windows import FOLDS

from hybrid_id.identification.horizons import Horizon
from hybrid_id.reporting.residual_torques import residuals_result
from hybrid_id.statistics.variation import paired_difference
from hybrid_id.study.residual_torques import learn_residuals
from hybrid_id.systems.model_file import load_model

OVERLAP = 1.0 / (FOLDS - 1)


def main() -> None:
    """Learn on two of three thirds of the pieces, test on the other, each in turn; a file a joint and horizon."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--model", type=Path, default=Path("runs/19_tx40_drives/model.yaml"), help="the drives")
    ask.add_argument("--out", type=Path, default=Path("runs/19_tx40_networks"))
    ask.add_argument("--window", default=str(inverse.WINDOW), help="seconds, whole or auto")
    ask.add_argument("joints", nargs="*", default=[])
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    dataset, system = pieces(wish.data), load_model(wish.model)
    count = len(dataset)
    for joint in wish.joints or [f"joint_{k}" for k in range(1, 6)]:  # joint 6 is learnt with joint 5
        file, began = wish.out / f"{joint}_{wish.window}.json", time.process_time()
        if file.exists():
            continue
        thirds, tested = [], {}
        for fold in range(FOLDS):
            roles = ["test" if k * FOLDS // count == fold else "train" for k in range(count)]
            records = tuple(replace(r, role=role) for r, role in zip(dataset, roles, strict=True))
            given = replace(dataset, records=records)
            said = residuals_result(learn_residuals(given, system, [joint], horizon=Horizon.of(wish.window)))[
                "joints"
            ][joint]
            thirds.append(said)
            tested |= said["tested"]
        before, after = np.array([[one["physics"], one["hybrid"]] for one in tested.values()]).T
        gain = paired_difference(np.log(before), np.log(after), overlap=OVERLAP)
        found = {
            "stays": [one["network"] for one in thirds],
            "gain_left_out": [one["gain"] for one in thirds],
            "tested": {"physics": float(np.sqrt((before**2).mean())), "hybrid": float(np.sqrt((after**2).mean()))},
            "log_ratio": vars(gain),
            "largest_drift": [max(map(abs, one["drift_sigma"].values())) for one in thirds],
        }  # fmt: skip
        seconds = time.process_time() - began
        file.write_text(json.dumps(found | {"thirds": thirds, "seconds": seconds}))
        print(joint, wish.window, json.dumps(found), f"{seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()

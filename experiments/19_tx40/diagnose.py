"""Staubli TX40: what joints 1 to 4 and the coupled wrist lack beside the drives: diagnose.py --data FOLDER [PART]."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import run as inverse
import torch
from windows import RATIO, SIGN, record_of

from hybrid_id import diagnose
from hybrid_id.diagnosis.fits import engine
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.resample import resample_record
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.by_joint import some, with_others_measured
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

STEP, PIECE = 5e-3, 0.6
"""Of the records [s], and their length [s]: three free windows each; of 0.2 s alone the start's speed is not known."""
PARTS = {"1": (0,), "2": (1,), "3": (2,), "4": (3,), "wrist": (4, 5)}
"""Numbers of the joints, from 0, that are taken together: the motor of joint 6 turns with both of the wrist."""


def pieces(folder: Path) -> Dataset:
    """Motor angles [rad] and torques [N m] of the first two thirds of the recording, cut into train records."""
    angles, torque = inverse.read(folder)
    split = round(inverse.SPLIT * len(angles))
    motors = np.linalg.solve(inverse.MOTORS.T, torque[:split].T).T / RATIO * SIGN
    whole, _ = resample_record(record_of(angles[:split], motors)[0], STEP)
    length = round(PIECE / STEP)
    records = []
    for k in range(whole.n_samples // length):
        part = slice(k * length, (k + 1) * length)
        inputs, outputs = ({n: v[part] for n, v in of.items()} for of in (whole.inputs, whole.outputs))
        time = STEP * np.arange(length)
        records.append(replace(whole, name=f"piece_{k}", time=time, inputs=inputs, outputs=outputs))
    torques = tuple(Channel(name, "N m") for name in whole.inputs)
    return Dataset(
        "tx40", torques, tuple(Channel(name, "rad") for name in whole.outputs), tuple(records), STEP
    )


def diagnosed(
    dataset: Dataset, system: System, joints: tuple[int, ...], horizon: Horizon | None
) -> Diagnosis:
    """Some joints by themselves, the others as measured."""
    return diagnose(
        with_others_measured(dataset, system, *joints), some(system, list(joints)), horizon=horizon
    )


def errors(found: Diagnosis, model: FittedModel) -> dict[str, object]:
    """Of a fitted model: RMS of each motor's angle over its gear ratio in its own free runs [mrad], weighted RMS of the
    records left out, and what neighbouring samples of what it leaves have in common."""
    dataset = found.details.dataset
    batch = found.horizon.cut(model.system, engine(), batch_of(dataset, model.system, dataset.train))
    weights = [row[(row > 0).any(1)] for row in batch.weight.numpy()]
    left = np.concatenate([row / one for row, one in zip(model.result.residual, weights, strict=True)])
    own = 1e3 * np.sqrt((left**2).mean(0)) / np.array(model.system.gear_ratio)
    return {
        "mrad": own.round(2).tolist(),
        "left_out": model.validation.error**0.5,
        "autocorrelation": model.autocorrelation,
    }


def main() -> None:
    """Diagnose each part; a file a part and horizon, those that are there stay."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, required=True)
    ask.add_argument("--model", type=Path, default=Path("runs/19_tx40_drives/model.yaml"), help="the drives")
    ask.add_argument("--out", type=Path, default=Path("runs/19_tx40_diagnosis"))
    ask.add_argument("--window", default=str(inverse.WINDOW), help="seconds, whole or auto")
    ask.add_argument("--half", type=int, choices=(0, 1), help="every second piece alone, from this one on")
    ask.add_argument("parts", nargs="*", default=[])
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    dataset, system, which = pieces(wish.data), load_model(wish.model), wish.window
    if wish.half is not None:
        dataset = replace(dataset, records=dataset.records[wish.half :: 2])
        which = f"{which}_half_{wish.half}"
    for part in wish.parts or PARTS:
        file, began = wish.out / f"{part}_{which}.json", time.process_time()
        if file.exists():
            continue
        found = diagnosed(dataset, system, PARTS[part], Horizon.of(wish.window))
        seconds = time.process_time() - began
        models = {name: errors(found, one) for name, one in found.fitted.items()}
        file.write_text(json.dumps(found.as_dict() | {"models": models, "seconds": seconds}))
        print(f"{part}, {which}, {seconds:.0f} s, {models}\n{found.summary()}", flush=True)


if __name__ == "__main__":
    main()

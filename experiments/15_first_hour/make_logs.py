"""Eight logs of a geared motor as a German spreadsheet writes them, from the generator: make_logs.py FOLDER."""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from hybrid_id.cli.blind_runs import make_sealed
from hybrid_id.records.dataset import Dataset

SEED = 16
DRAWN = {"system": "one_link", "engine": "mujoco", "effect": "cogging", "level": "strong"}

folder = Path(sys.argv[1])
folder.mkdir(parents=True)
with tempfile.TemporaryDirectory() as place:
    make_sealed(Path(place) / "cases", None, 1, SEED, DRAWN, 1)  # type: ignore[arg-type]
    data = Dataset.load(Path(place) / "cases" / "c001")
    for number, record in enumerate(data, start=1):
        columns = {
            "time_ms": np.round(1e3 * record.time, 3),
            "motor_volts": np.round(record.inputs["u1"], 4),
            "encoder_deg": np.round(np.rad2deg(record.outputs["q_m1"]), 4),
        }
        log = folder / f"run{number}.csv"
        pd.DataFrame(columns).to_csv(log, sep=";", decimal=",", index=False)
    print((Path(place) / "cases" / "answers" / "c001.yaml").read_text())
print(f"{len(data)} logs in {folder}")

"""XL-330 servo: nested friction models pooled over 12 measured records (README.md beside this)."""

import argparse
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from ladder import climb, leave_one_out, mean_errors, prepare
from report import error_table, held_out_table, parameter_table

from hybrid_id import Dataset
from hybrid_id.records.resample import resample_record
from hybrid_id.records.yaml_file import read_yaml

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--config", default=str(Path(__file__).with_name("config.yaml")))
parser.add_argument("--data", help="folder of BAM logs (default: the config's)")
parser.add_argument("--jobs", type=int, default=2)
options = parser.parse_args()

config = read_yaml(options.config)
logs = Dataset.load(Path(__file__).with_name("servo.yaml"), folder=options.data or config["data"])
pairs = [resample_record(r, config["sample_time"]) for r in logs]
records = [record for record, _ in pairs]
print("\n".join(report.message for _, report in pairs))
run = Parallel(n_jobs=options.jobs)

groups = sorted({float(r.signal(config["held_out"])[0]) for r in records})
train = {g: [r for r in records if r.signal(config["held_out"])[0] != g] for g in groups}
tasks = [(drive, records) for drive in config["drives"].values()]
tasks += [(drive, train[g]) for drive in config["drives"].values() for g in groups]
ladders: list[Any] = list(run(delayed(climb)(config, drive, some) for drive, some in tasks))
pooled = dict(zip(config["drives"], ladders, strict=False))
print(error_table(pooled))

for drive, rotation in zip(config["drives"], (ladders[2:5], ladders[5:8]), strict=True):
    test = {g: [r for r in records if r.signal(config["held_out"])[0] == g] for g in groups}
    print(
        held_out_table(
            f"{drive}, held-out {config['held_out']}", rotation, test, config, prepare, mean_errors
        )
    )

for drive, ladder in pooled.items():
    left_out: list[Any] = list(run(delayed(leave_one_out)(config, rung, records) for rung in ladder.values()))
    print(parameter_table(drive, dict(zip(ladder, left_out, strict=True)), ladder))

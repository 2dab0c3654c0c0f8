"""XL-330 servo: physics with and without a network on gains that the training has not seen (README.md beside this)."""

import sys
from pathlib import Path

import numpy as np
import torch
from scipy.stats import t

sys.path.insert(1, str(Path(__file__).parents[1] / "02_xl330"))
from ladder import mean_errors, prepare  # pyright: ignore[reportMissingImports]
from servo import rotate

from hybrid_id import Dataset
from hybrid_id.records.resample import resample_record
from hybrid_id.records.yaml_file import read_yaml

torch.set_num_threads(1)
config = read_yaml(Path(__file__).with_name("config.yaml"))
SERVO = Path(__file__).parents[1] / "02_xl330" / "servo.yaml"
logs = Dataset.load(SERVO, folder=sys.argv[1] if len(sys.argv) > 1 else config["data"])
records = [resample_record(r, config["sample_time"])[0] for r in logs]
gains = sorted({float(r.signal(config["held_out"])[0]) for r in records})
pairs = []
for gain in gains:
    result = rotate(config, records, gain)
    batch = prepare(config, result.system, [r for r in records if r.signal(config["held_out"])[0] == gain])
    for k, model in enumerate(result.models):
        found, mark = mean_errors(model.system, result.engine, batch), "*" if k == result.chosen else " "
        print(
            f"{mark} gain {gain:g} {'hybrid ' if k else 'physics'} validation {model.validation:8.3f}  ",
            end="",
        )
        print(
            f"test {found.mean():.4f} rad ({', '.join(f'{e:.4f}' for e in found)})  {model.status}",
            flush=True,
        )
    alone, chosen = (
        mean_errors(r.system, result.engine, batch) for r in (result.models[0], result.models[result.chosen])
    )
    pairs += list(zip(alone, chosen, strict=True))
alone, hybrid = np.array(pairs).T
change = hybrid - alone
reach = t.ppf(0.975, len(change) - 1) * change.std(ddof=1) / len(change) ** 0.5
print(
    f"physics {alone.mean():.4f} rad, hybrid {hybrid.mean():.4f} rad on {len(change)} records of unseen gains: "
)
print(
    f"change {change.mean():+.4f} rad, 95 % interval {change.mean() - reach:+.4f} to {change.mean() + reach:+.4f}"
)

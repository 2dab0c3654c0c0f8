"""Qube-Servo: the arm axis of a Furuta pendulum from 8 measured records (README.md beside this)."""

import argparse
import sys
from pathlib import Path

import torch
from arm import HERE, build, delayed, identify_windows, load
from report import horizon_table, parameter_table, pictures, remarks, say_whole, spread_table

from hybrid_id import check_identifiability, identify, load_model
from hybrid_id.records.yaml_file import read_yaml

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--config", default=str(HERE / "config.yaml"))
parser.add_argument("--data", help="folder of the records (default: the config's)")
options = parser.parse_args()
config = read_yaml(options.config)
folder = Path(options.data or config["data"])
if not list(folder.glob("qube_*.csv.gz")):
    sys.exit(f"There is no record qube_*.csv.gz in {folder}; README.md says where to get them, give --data.")
torch.set_num_threads(1)

dataset, window, ladder = load(folder), config["window"], {}
print(f"before any fit\n{check_identifiability(dataset, load_model(HERE / 'model.yaml')).summary()}")
models = {name: build(rung, config["hold"]) for name, rung in config["ladder"].items()}
for name in ("with the pendulum", "with cable and bias"):
    say_whole(name, identify(dataset, models[name]))
for name, rung in config["ladder"].items():
    ladder[name] = identify_windows(dataset, models[name], window, start=ladder.get(rung.get("after")))
chosen, system = ladder["with cable and bias"], models["with cable and bias"]
print(spread_table("model", ladder), horizon_table(ladder, config["horizons"]), parameter_table(chosen))
print(remarks(chosen))
lengths = {f"{s:g} s": identify_windows(dataset, system, s) for s in config["windows"]}
print(spread_table("window", {f"{window:g} s": chosen} | lengths))
late = {
    f"{1e3 * s:g} ms": identify_windows(delayed(dataset, s), system, window) for s in config["dead_times"]
}
print(spread_table("dead time", {"0": chosen} | late), horizon_table(late, config["horizons"]))
pictures(chosen, Path(config["out"]), dataset.records[0].sample_time)

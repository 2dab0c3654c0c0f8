"""DFKI's two-link arm: publisher's parameters, physics re-fitted, and a hybrid (README.md beside this)."""

import sys
from pathlib import Path

import torch
from arm import Publisher, build, pieces, split, told

from hybrid_id.identification.hybrid import HybridOptions, train_hybrid
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine

torch.set_num_threads(1)
config = read_yaml(Path(__file__).with_name("config.yaml"))
data = Path(sys.argv[1] if len(sys.argv) > 1 else config["data"])
wish = config["training"] | {"windows": tuple(config["training"]["windows"])}
engine = OdeEngine(fine=4, width=config["width"])
half, sparse = 0.5 * config["window"], config["every"] * config["window"]

for design in sys.argv[2:] or config["designs"]:
    how = config["designs"][design]
    published = read_yaml(data / "parameters" / how["parameters"])
    system, model = build(config, published, how["memory"]), Publisher(published, config["gravity"])
    train, looked, test, day = split(config, data / "sys_id", how)
    for name, records in (("all records of the day", day), ("test records", test)):
        windows = pieces(config, system, records, half)
        told(f"{design} publisher, {name}, {windows.rows} windows", model.angles(system, windows), windows)
    batches = (pieces(config, system, records, sparse) for records in (train, looked))
    result = train_hybrid(system, *batches, engine=engine, options=HybridOptions(**wish))
    for k, trained in enumerate(result.models):
        name = f"{design} {'hybrid' if k else 'physics'}{' chosen' if k == result.chosen else ''}"
        told(name, simulate(trained.system, result.engine, windows).y, windows)

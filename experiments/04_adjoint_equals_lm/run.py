"""The twin of the paper's link 1, trained by the adjoint and fitted by Levenberg-Marquardt (README.md beside this)."""

import argparse
from pathlib import Path
from time import process_time

import torch
from compare import Comparison

from hybrid_id.identification.adjoint import train
from hybrid_id.identification.fit import fit
from hybrid_id.paper.twin import make_campaign, model_description
from hybrid_id.records.yaml_file import read_yaml, write_yaml
from hybrid_id.reporting.tensorboard import TrainingLog
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.model_file import ModelFile, build_model

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--config", default=Path(__file__).with_name("config.yaml"))
config = read_yaml(parser.parse_args().config)
torch.set_num_threads(1)
out, width, twin = Path(config["out"]), config["width"], read_yaml(config["twin"])
dataset, _ = make_campaign(twin, config["seed"])
report = {}
for name, priors in (("with data-sheet priors", True), ("without priors", False)):
    system = build_model(ModelFile.model_validate(model_description(twin, config["seed"], priors=priors)))
    batch = make_batch(system, dataset.train, noise_std={c.name: c.noise_std for c in dataset.outputs})
    begin = process_time()
    fitted = fit(system, batch, engine=Engine("smooth", width=width, **config["levenberg_marquardt"]))
    between = process_time()
    with TrainingLog(out / name.replace(" ", "_")) as log:
        trained = train(system, batch, engine=OdeEngine(width=width, **config["adjoint"]), writer=log)
    comparison = Comparison(fitted, trained, (between - begin, process_time() - between))
    print(f"\n{name}\n{comparison.table()}", flush=True)
    report[name] = comparison.summary()
out.mkdir(parents=True, exist_ok=True)
write_yaml(out / "result.yaml", report)

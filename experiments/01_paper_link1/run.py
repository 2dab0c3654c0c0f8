"""The twin of the paper's link 1, identified with and without data-sheet priors, over seeds (README.md beside this)."""

import argparse

import numpy as np
import torch
from score import CLAIMS, Campaign

from hybrid_id.paper.twin import make_campaign, model_description
from hybrid_id.records.yaml_file import read_yaml, write_yaml
from hybrid_id.study import check_identifiability, identify
from hybrid_id.systems.model_file import ModelFile, build_model

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--config", default="configs/twin_link1.yaml")
parser.add_argument("--seeds", type=int, default=20)
parser.add_argument("--out", default="runs/01_paper_link1.yaml")
options = parser.parse_args()
torch.set_num_threads(1)

config = read_yaml(options.config)


def redraw_priors(description, seed):
    """Centre every prior at the truth plus an error of its own width: a data sheet of its own for each seed."""
    random = np.random.default_rng([seed, 12])
    for name, values in description["parameters"].items():
        if "prior_std" in values:
            values["nominal"] = config["truth"][name] + values["prior_std"] * random.normal()


campaigns = {
    "without priors": Campaign(parameters=False),
    "with data-sheet priors": Campaign(parameters=True),
}
for seed in range(options.seeds):
    dataset, truths = make_campaign(config, seed)
    for name, campaign in campaigns.items():
        description = model_description(config, seed, priors=name.startswith("with "))
        redraw_priors(description, seed)
        system = build_model(ModelFile.model_validate(description))
        if seed == 0:
            found = check_identifiability(dataset, system).summary()
            print(f"\n{name}: what the records identify, before any fit\n{found}")
        campaign.add(config, identify(dataset, system, seed=seed), truths, dataset)
        print(f"seed {seed}, {name}: done", flush=True)
result = {name: campaign.report(name) for name, campaign in campaigns.items()}
print(
    CLAIMS.format(
        **{f"{k}_{key}": v for k, r in zip("ab", result.values(), strict=True) for key, v in r.items()}
    )
)
write_yaml(options.out, result)

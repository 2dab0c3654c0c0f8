"""What records say under a likelihood with a random torque: one machine, its estimate and its likeliest causes."""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from causes import causes
from posterior import Posterior
from random_torque import RandomTorque, estimate, sheet_prior

from hybrid_id.identification.fit import make_bounds
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

TOLERANCE, FRICTION = 0.3, 1.0
"""By what a data sheet misses a value, and a friction, as standard deviations of their logarithms."""


def diagnose(system: System, records: Sequence[Record]) -> None:
    """Print the base model's estimate, its random torque, and the likeliest sets of causes beside it."""

    def prepared(model: System) -> Batch:
        return make_batch(model, records, signal_share=0.0)

    begin, batch, theta = time.perf_counter(), prepared(system), system.theta().detach()
    engine = with_substeps(
        system, compiled_for(system, Engine()), batch, theta[:, None].expand(-1, batch.rows)
    )
    likelihood = RandomTorque(system, engine, batch, system.estimated)
    bounds = replace(make_bounds(system, system.estimated), prior_mean=theta[system.estimated])
    names = [system.table[i].name for i in system.estimated]
    tolerance = torch.tensor([FRICTION if name.startswith("F_") else TOLERANCE for name in names]).double()
    found = estimate(likelihood, theta, bounds, tolerance=tolerance)
    values = dict(zip(names, found.theta[system.estimated].tolist(), strict=True))
    print(
        f"{found.status} after {found.rounds} rounds: " + ", ".join(f"{n} {v:.4g}" for n, v in values.items())
    )
    print("; ".join(f"{name} {part.tolist()}" for name, part in vars(likelihood.noise).items()))
    fitted, lin = time.perf_counter(), likelihood.linearise(found.theta)
    missed, per_value = sheet_prior(found.theta[system.estimated], bounds, tolerance)
    loose = (per_value == 0) * (0.1 / bounds.scale).square()
    precision, pull = bounds.prior_precision + per_value.square() + loose, per_value * missed
    posterior = Posterior(likelihood, lin, causes(likelihood, lin, found.theta, prepared), precision, pull)
    sets = posterior.search()
    least = float(sets[0].evidence + sets[0].prior)
    for size_of_set in sets[1:]:
        if len(size_of_set.members) == 0:
            continue
        gain = float(size_of_set.evidence[0] + size_of_set.prior[0]) - least
        members = [posterior.causes[i] for i in size_of_set.members[0].tolist()]
        told = zip(members, size_of_set.sizes[0].tolist(), size_of_set.errors[0].tolist(), strict=True)
        print(
            f"{gain:9.1f} nats: " + ", ".join(f"{c.name} at {c.where} {s:.2f} +- {e:.2f}" for c, s, e in told)
        )
    ends = time.perf_counter()
    print(
        f"{len(posterior.causes)} candidates; {fitted - begin:.1f} s for the base, {ends - fitted:.1f} s for the causes"
    )


def main() -> None:
    """Parse, load, diagnose."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with dataset.yaml and model.yaml")
    parser.add_argument("--model", type=Path)
    wish = parser.parse_args(sys.argv[1:])
    dataset = Dataset.load(wish.folder)
    diagnose(load_model(wish.model or wish.folder / "model.yaml"), dataset.train or dataset.records)


if __name__ == "__main__":
    main()

"""The machines of the experiment, and their records; the model never sees what is withheld."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_id.components import REGISTRY, ResidualNetwork
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import one_link
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Machine:
    """One machine: the truth, the model of it without and with a network, and the records."""

    truth: System
    physics: System
    model: System
    dataset: Dataset
    noise: float


def make(config: Mapping[str, Any], kind: str, seed: int) -> Machine:
    """A machine of a kind with the records of a seed."""
    entry = config["machines"][kind]
    known = one_link(config["gear_ratio"], vertical="vertical" in entry)
    known = known.with_values(config["values"] | ({"G_l": entry["vertical"]} if "vertical" in entry else {}))
    known = known.with_specs({"P_m1": replace(known.parameter("P_m1").spec, estimate=False)})
    truth = known
    for place, parts in entry["withheld"].items():
        for name, values in parts.items():
            truth = truth.with_component(f"joint1/{place}", REGISTRY[name](**values))
    how = dict(entry["network"])
    network = ResidualNetwork(inputs=how["inputs"], hidden=how["hidden"], seed=seed)
    model = known.with_values(config["start"]).with_component(how["place"], network)
    records = tuple(_record(config, truth, entry, seed, k) for k in range(entry["records"]))
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", entry["noise"]),)
    dataset = Dataset(f"{kind} {seed}", *channels, records, config["sample_time"], signal_share=0.0)
    return Machine(truth, known, model, dataset, entry["noise"])


def _record(config: Mapping[str, Any], truth: System, entry: Mapping[str, Any], seed: int, k: int) -> Record:
    """One record: tones with random phases after a rest, the truth's free run, and noise."""
    generator, count = np.random.default_rng(100 * seed + k), config["samples"]
    time, tones = config["sample_time"] * np.arange(count), np.geomspace(0.3, 8.0, 8)[:, None]
    wave = np.sin(2 * np.pi * tones * time[:-20] + generator.uniform(0, 2 * np.pi, (8, 1))).sum(0)
    u = np.concatenate([np.zeros(20), config["amplitude"] * wave / np.abs(wave).max()])
    role = "test" if k >= entry["records"] - config["test"] else "train"
    blank = Record(f"run_{k:02d}", time, {"u1": u}, {"q_m1": 0.0 * time}, role=role)
    batch = make_batch(truth, [blank], noise_std={"q_m1": entry["noise"]})
    run = simulate(truth, Engine("smooth", 6, config["width"]), batch)
    noise = entry["noise"] * np.random.default_rng(1000 * seed + k).standard_normal(count)
    return replace(blank, outputs={"q_m1": run.y[0, :, 0].numpy() + noise})

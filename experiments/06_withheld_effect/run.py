"""A drive with an effect that the model lacks, and physics with a network on its records, price by price.

Usage: ``python run.py [cogging|none] [seed]``; README.md beside this.
"""

import math
import sys
from dataclasses import replace

import numpy as np
import torch

from hybrid_id.components import Cogging, ResidualNetwork
from hybrid_id.identification.hybrid import HybridOptions
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.study.hybrid import hybridise
from hybrid_id.study.network_role import network_roles
from hybrid_id.systems import one_link

STEP, NOISE, WIDTH = 0.004, 0.02, 1.0
kind = sys.argv[1] if len(sys.argv) > 1 else "cogging"
seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
physics = one_link(20.0).with_values({"J": 2e-5, "P_m1": 0.019, "P_m2": 0.0254, "F_c": 0.005, "F_v": 5e-5})
physics = physics.with_specs({"P_m1": replace(physics.parameter("P_m1").spec, estimate=False)})
cogging = Cogging(T_c=0.0, T_s=2.5e-3, n=3.0)
truth = physics.with_component("joint1/motor", cogging) if kind == "cogging" else physics


def record(k: int) -> Record:
    """One record of 2.4 s, eight tones from 0.3 to 8 Hz within 3 V, with noise; the last two are for the test."""
    generator = np.random.default_rng(100 * seed + k)
    time, tones = STEP * np.arange(600), np.geomspace(0.3, 8.0, 8)[:, None]
    wave = np.sin(2 * np.pi * tones * time[:-20] + generator.uniform(0, 2 * np.pi, (8, 1))).sum(0)
    u = np.concatenate([np.zeros(20), 3.0 * wave / np.abs(wave).max()])
    blank = Record(f"run_{k}", time, {"u1": u}, {"q_m1": 0.0 * time}, role="test" if k > 5 else "train")
    run = simulate(truth, Engine("smooth", 6, WIDTH), make_batch(truth, [blank], noise_std={"q_m1": NOISE}))
    noise = NOISE * np.random.default_rng(1000 * seed + k).standard_normal(600)
    return replace(blank, outputs={"q_m1": run.y[0, :, 0].numpy() + noise})


torch.set_num_threads(1)
channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", NOISE),)
dataset = Dataset(f"{kind} {seed}", *channels, tuple(record(k) for k in range(8)), STEP)
network = ResidualNetwork(inputs=("speed", "sin 3", "cos 3"), hidden=(8,), seed=seed)
start = physics.with_values({"J": 2.6e-5, "F_c": 0.006}).with_component("joint1/motor", network)
options = HybridOptions(prices=(10.0, 1.0, 0.1, 0.01, 0.0), windows=((0.1, 4), (0.3, 2)))
study = hybridise(dataset, start, engine=OdeEngine(fine=8, width=WIDTH), options=options, signal_share=0.0)
train, test = (
    make_batch(start, r, noise_std={"q_m1": NOISE}, signal_share=0.0)
    for r in (dataset.train[:5], dataset.test)
)


def missed(system) -> float:
    """RMS error of the free run on the test records in units of the noise."""
    run = simulate(system, study.result.engine, test)
    return math.sqrt(float(((run.y - test.y) * test.weight).square().mean()))


print(f"{dataset.name}: noise floor (the truth replayed) {missed(truth):.3f}")
for k, rung in enumerate(study.result.rungs):
    role, info = (
        network_roles(rung.system, study.result.engine, train)[0],
        [i for i in rung.system.table if i.spec.estimate],
    )
    off = [
        (i.name, i.spec.value, physics.parameter(i.name).spec.value, e)
        for i, e in zip(info, rung.errors, strict=True)
    ]
    words = "  ".join(f"{n} {100 * (a / b - 1):+.2f} % ({(a - b) / e:+.1f} s)" for n, a, b, e in off)
    mark = "*" if k == study.result.chosen else " "
    loss, ratio = math.sqrt(2 * rung.validation), missed(rung.system) / missed(truth)
    print(f"{mark} price {rung.price:<5g} validation {loss:6.3f}  test {ratio:6.3f} x floor  ", end="")
    print(f"share {100 * role.share:5.2f} %  overlap {role.overlap:.2f}  {words}", flush=True)
print(*(f"! {warning}" for warning in study.warnings), sep="\n")

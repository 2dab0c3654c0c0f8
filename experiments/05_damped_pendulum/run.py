"""APHYNITY's damped pendulum, ``q'' = -w0^2 sin q - alpha q'``, with the damping withheld from the model.

Setting of Y. Yin et al., ICLR 2021, Table 1, and its published code: w0 = 2 pi / 12, alpha = 0.2, 25 + 25 free swings
of 20 s, both states every 0.5 s, starts of radius 1.3 to 2.3 in any direction. Usage: ``python run.py [seeds]``.
"""

import math
import sys
from dataclasses import replace

import numpy as np
import torch
from scipy.integrate import solve_ivp

from hybrid_id.components import ResidualNetwork
from hybrid_id.identification.hybrid import HybridOptions, train_hybrid
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems import one_link

W0_SQUARED, ALPHA = (2 * math.pi / 12) ** 2, 0.2
EVERY, TIME = 4, np.arange(0.0, 19.51, 0.125)  # one node in four is measured


def swings(system, seed, count=25):
    """Free swings as a batch that knows its first states."""
    generator, records = np.random.default_rng(seed), []
    for k in range(count):
        way, radius = generator.uniform(-1.0, 1.0, 2), generator.uniform(1.3, 2.3)
        rates = lambda t, x: (x[1], -W0_SQUARED * math.sin(x[0]) - ALPHA * x[1])  # noqa: E731
        run = solve_ivp(
            rates, (0.0, 20.0), way / np.hypot(*way) * radius, "DOP853", TIME, rtol=1e-10, atol=1e-12
        )
        records.append(Record(f"swing_{k}", TIME, {"u1": 0.0 * TIME}, {"q_m1": run.y[0], "v_m1": run.y[1]}))
    batch = make_batch(system, records, noise_std={"q_m1": 1e-4, "v_m1": 1e-4}, signal_share=0.0)
    measured = (torch.arange(len(TIME)) % EVERY == 0).to(batch.y)[:, None]
    return replace(batch, x=batch.y.clone(), x0_std=0.0 * batch.x0_std, weight=batch.weight * measured)


def pendulum():
    """The physics: gravity alone, its size unknown."""
    system = one_link(vertical=True)
    for kind in ("coulomb_friction", "viscous_friction"):
        system = system.without_component("joint1/motor_friction", kind)
    system = system.with_values({"J": 1.0, "P_m2": 0.0, "G_l": 0.4, "P_m1": 1.0})
    return system.with_specs(
        {n: replace(system.parameter(n).spec, estimate=False) for n in ("J", "P_m1", "P_m2")}
    )


for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
    network = ResidualNetwork(inputs=("speed", "angle"), hidden=(8,), seed=seed)
    system = pendulum().with_component("joint1/motor_friction", network)
    train, validation, test = (swings(system, 10 * seed + k) for k in range(3))
    # over 20 s a pendulum without damping would turn over and over: pieces of 4 s from measured states
    pieces = train.windows(8 * EVERY + 1, 8 * EVERY, train.x0_std)[0]
    for price in (1e4, 1e2, 1.0, 0.0):
        options = HybridOptions(price=price, windows=(), max_iterations=120, worth=0.0)
        result = train_hybrid(
            system, pieces, validation, engine=OdeEngine(fine=1, width=1e-6), options=options
        )
        for k, model in enumerate(result.models):
            miss = (simulate(model.system, result.engine, test).y - test.y)[:, ::EVERY]
            error, off = (
                math.log10(miss.square().mean()),
                model.system.parameter("G_l").spec.value / W0_SQUARED - 1,
            )
            name, mark = f"price {price:g}" if k else "physics", "chosen" if k == result.chosen else ""
            print(f"seed {seed} {name:<12} log10 MSE {error:6.2f} w0^2 {100 * off:+.3f} % {mark}", flush=True)

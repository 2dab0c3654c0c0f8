"""Time of rollouts and tangents with dry friction, of one sample of one lane: python -m benchmarks.rollouts."""

import time

import numpy as np
import torch

from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import linearise
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible, two_link

LANES, SAMPLES, STEP, REPEATS = 72, 4000, 0.002, 5
SYSTEMS = {
    "one link": one_link(100.0, vertical=True).with_values({"G_l": 0.3}),
    "one flexible link": one_link_flexible(100.0).with_values({"J_m": 1e-5, "J_a": 0.25, "k": 300.0}),
    "two links": two_link((100.0, 100.0)),
}


def record(system: System) -> Record:
    """Waves that reverse, and a second at rest."""
    t = STEP * np.arange(SAMPLES)
    waves = {
        f"u{n}": 8.0
        * np.where(t < 1.0, 0.0, np.sin(2 * np.pi * (0.5 + 0.3 * n) * t) + 0.6 * np.sin(2 * np.pi * 3.1 * t))
        for n in range(1, 1 + len(system.joints))
    }
    still = {f"q_m{n}": np.zeros(SAMPLES) for n in range(1, 1 + len(system.joints))}
    return Record(name="waves", time=t, inputs=waves, outputs=still)


def seconds(system: System, engine: Engine, lanes: int, repeats: int) -> float:
    """Least time of a rollout [s]."""
    batch = make_batch(system, [record(system)]).take(torch.zeros(lanes, dtype=torch.long))
    theta = system.theta().detach()[:, None] * torch.linspace(0.98, 1.02, lanes, dtype=torch.float64)
    rollout(system, engine, batch, theta)  # compiles
    found = []
    for _ in range(repeats):
        begun = time.process_time()
        rollout(system, engine, batch, theta)
        found.append(time.process_time() - begun)
    return min(found)


def tangent_seconds(system: System, engine: Engine, rows: int = 6) -> float:
    """Least time of a linearisation by all states and parameters along a motion [s]."""
    batch = make_batch(system, [record(system)]).take(torch.zeros(rows, dtype=torch.long))
    theta = system.theta().detach()[:, None] * torch.linspace(0.98, 1.02, rows, dtype=torch.float64)
    arguments = rollout(system, engine, batch, theta), batch.u, batch.dt, theta, range(len(system.table))
    linearise(system, engine, *arguments)  # compiles
    found = []
    for _ in range(2 * REPEATS):
        begun = time.process_time()
        linearise(system, engine, *arguments)
        found.append(time.process_time() - begun)
    return min(found) / (rows * SAMPLES)


def main() -> None:
    """Print a line a system."""
    torch.set_num_threads(1)
    for name, system in SYSTEMS.items():
        compiled = seconds(system, Engine(compiled=True), LANES, REPEATS) / (LANES * SAMPLES)
        eager = seconds(system, Engine(), LANES, 1) / (LANES * SAMPLES)
        print(
            f"{name}: compiled {1e9 * compiled:.0f} ns, eager {1e9 * eager:.0f} ns, ratio {eager / compiled:.0f}; "
            f"with tangents {1e9 * tangent_seconds(system, Engine(compiled=True)):.0f} ns"
        )


if __name__ == "__main__":
    main()

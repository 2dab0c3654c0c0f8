"""Compiling ahead what the shipped systems need, so that a first run meets no compiler."""

from __future__ import annotations

from itertools import product

import numpy as np

from hybrid_id.components import AsymmetricStribeck, Stribeck
from hybrid_id.errors import InputError
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.records.record import Record
from hybrid_id.simulation.c_code import kept_ahead
from hybrid_id.simulation.compiled import compiled_for, compiler_works, forget
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible, two_link

SAMPLES = 12
"""Of the record at rest that every system is simulated on."""


def shipped() -> list[System]:
    """The systems of :mod:`hybrid_id.systems`, horizontal and vertical, with the friction laws that are tried first."""
    links = [
        build(friction=None if law is None else law(), vertical=vertical)
        for build, law, vertical in product(
            (one_link, one_link_flexible), (None, Stribeck, AsymmetricStribeck), (False, True)
        )
    ]
    return [*links, *(two_link(vertical=vertical) for vertical in (False, True))]


def compile_ahead() -> int:
    """Compile rollouts and fits of every shipped system for all who use this environment; how many systems.

    Raises:
        InputError: there is no compiler, or nothing can be kept in the environment.
    """
    systems = shipped()
    if not compiler_works():
        raise InputError("No C compiler works here; install gcc, or leave --ahead out.")
    with kept_ahead():
        forget()
        for system, friction in product(systems, ("dry", "smooth")):
            rest = np.zeros(SAMPLES)
            record = Record(
                name="rest",
                time=0.01 * np.arange(SAMPLES),
                inputs=dict.fromkeys(system.input_names, rest),
                outputs={f"q_m{joint.number}": rest for joint in system.joints},
            )
            batch = make_batch(system, [record], noise_std=dict.fromkeys(record.outputs, 1e-3))
            engine, theta = compiled_for(system, Engine(friction)), system.theta().detach()[:, None]
            simulate(system, engine, batch, theta)
            evaluate(system, engine, batch, batch.x, theta, system.estimated, loss=Loss(), chunk=1)
    return len(systems)

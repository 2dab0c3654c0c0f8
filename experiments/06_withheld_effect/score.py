"""What a hybrid training came to, against the truth that the generator alone knows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from machine import Machine

from hybrid_id.identification.fit import fit
from hybrid_id.identification.hybrid import Trained
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.study.hybrid import HybridStudy, network_roles
from hybrid_id.systems.chain import System


def batch_of(machine: Machine, records: Sequence[Record]) -> Batch:
    """Records in units of the encoder's noise."""
    return make_batch(machine.model, records, noise_std={"q_m1": machine.noise}, signal_share=0.0)


def missed(system: System, engine: OdeEngine, batch: Batch) -> float:
    """RMS error of free runs in units of the noise."""
    run = simulate(system, engine, batch)
    return math.sqrt(float(((run.y - batch.y) * batch.weight).square().mean()))


def off_truth(machine: Machine, model: Trained) -> str:
    """How far each estimated parameter lies from the truth, in per cent and in standard errors."""
    info = [i for i in model.system.table if i.spec.estimate]
    truths = [machine.physics.parameter(i.name).spec.value for i in info]
    rows = zip(info, truths, model.errors, strict=True)
    return ", ".join(
        f"{i.name} {100 * (i.spec.value / t - 1):+.2f} % ({(i.spec.value - t) / e:+.1f} s)"
        for i, t, e in rows
    )


def outcome(machine: Machine, study: HybridStudy) -> Iterator[str]:
    """A line for physics alone and one for the hybrid: test error, share, overlap, parameters."""
    engine = study.result.engine
    train, test = (batch_of(machine, r) for r in (machine.dataset.train, machine.dataset.test))
    floor = missed(machine.truth, engine, test)
    yield f"{machine.dataset.name}: noise floor on the test records (the truth replayed) {floor:.3f}"
    for k, model in enumerate(study.result.models):
        role, mark = network_roles(model.system, engine, train)[0], "*" if k == study.result.chosen else " "
        worth = ", ".join(f"{name} {value:+.2g}" for name, value in role.worth.items())
        yield (
            f"{mark} {'hybrid ' if k else 'physics'} train {math.sqrt(2 * model.train):6.3f}  validation "
            f"{math.sqrt(2 * model.validation):6.3f}  test / floor {missed(model.system, engine, test) / floor:6.3f}  "
            f"share {100 * role.share:5.2f} %  overlap {role.overlap:.2f}  {off_truth(machine, model)}  "
            f"network is worth {worth}"
        )


def spread(machine: Machine, study: HybridStudy) -> Iterator[str]:
    """std/mean of each parameter over experiments, fitted to one at a time, without the network and with it held."""
    batch = batch_of(machine, machine.dataset.train)
    pair = [model.system for model in study.result.models]
    found = []
    for system in pair:
        sets = fit(system, batch, engine=study.result.engine, warm=False)
        found.append(np.array([s.values for s in sets]))
    for name, alone, hybrid in zip(sets[0].names, *(f.T for f in found), strict=True):
        a, b = (100 * np.std(v, ddof=1) / abs(np.mean(v)) for v in (alone, hybrid))
        yield f"  std/mean over {batch.rows} experiments: {name} physics alone {a:.2f} %, with the network {b:.2f} %"

"""Which record would part models that the records at hand do not: simulated before it is proposed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from gapcase import small_case

from hybrid_id.components import Stribeck
from hybrid_id.gap.next_experiment import REST, next_experiment
from hybrid_id.gap.refit import engine
from hybrid_id.systems import System


def explanation(system: System) -> SimpleNamespace:
    """A model as a search ends with it."""
    return SimpleNamespace(system=system, result=SimpleNamespace(engine=engine()))


def test_the_experiment_that_parts_models_most_comes_first() -> None:
    dataset, today = small_case()
    falling = Stribeck(F_drop=0.005, v_s=20.0)
    other = today.with_component("joint1/motor_friction", falling)
    found = next_experiment(dataset, [explanation(today), explanation(other)])
    distances = [one.distance for one in found]
    assert len(found) == 6
    assert distances == sorted(distances, reverse=True)
    assert distances[0] > 0
    assert all(one.today == found[0].today > 0 for one in found)
    largest = max(np.abs(record.inputs["u1"]).max() for record in dataset.train)
    for one in found:
        assert one.joint == 1
        assert not one.command[one.time < REST].any()
        assert 0 < np.abs(one.command).max() <= largest * (1 + 1e-12)


def test_models_that_are_alike_are_parted_by_none() -> None:
    dataset, today = small_case()
    short = replace(dataset, records=dataset.records[:1])
    found = next_experiment(short, [explanation(today), explanation(today)])
    assert found
    assert not any(one.tells or one.distance for one in found)
    assert next_experiment(short, [explanation(today)]) == []

"""A fit ends at an optimum: whatever it starts at, and whatever ripple it has come to rest in."""

from dataclasses import replace

import pytest
from drives import make_record, multisine, rigid_drive

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.restarts import confirmed
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

ENGINE = Engine(compiled=compiler() is not None)
BIASED = rigid_drive().with_component("joint1/load", REGISTRY["constant_torque"](T_0=-1.0))


@pytest.fixture(scope="module")
def batch() -> Batch:
    record = make_record(BIASED, multisine(0, samples=600), seed=0, noise={"q_m1": 0.01})
    return make_batch(BIASED, [record])


@pytest.fixture(scope="module")
def start() -> System:
    held = replace(BIASED.parameter("J").spec, estimate=False)
    return BIASED.with_values({"T_0": 0.0, "F_c": 0.0, "F_v": 6e-5}).with_specs({"J": held})


def check_bias(values: dict[str, float]) -> None:
    assert values["T_0"] == pytest.approx(-1.0, rel=0.02)
    assert values["F_c"] == pytest.approx(0.01, rel=0.02)


def test_bias_and_friction_that_start_at_zero_are_found(batch: Batch, start: System) -> None:
    (found,) = fit(start, batch, engine=ENGINE, pooled=True, warm=False)
    assert found.ok
    check_bias(dict(zip(found.names, found.values, strict=True)))


@pytest.fixture(scope="module")
def lacking(batch: Batch) -> System:
    """A model without the bias that the records have."""
    return rigid_drive().with_specs({"J": replace(BIASED.parameter("J").spec, estimate=False)})


def test_a_fit_that_stopped_above_its_optimum_goes_on(batch: Batch, lacking: System) -> None:
    start = lacking.with_values({"F_c": 0.02, "P_m2": 0.03})
    best = min(
        (fit(s, batch, engine=ENGINE, pooled=True)[0] for s in (lacking, start)), key=lambda one: one.cost
    )
    (early,) = fit(start, batch, engine=ENGINE, pooled=True, warm=False, options=Options(tolerance=30.0))
    assert early.status == "converged"
    assert early.cost > 1.05 * best.cost
    found = confirmed(early, batch)
    assert found.cost < 1.01 * best.cost


def test_an_optimum_is_confirmed_as_it_is(batch: Batch, start: System, lacking: System) -> None:
    (sound,) = fit(start, batch, engine=ENGINE, pooled=True)
    assert confirmed(sound, batch) is sound  # it leaves noise: not simulated again
    (ended,) = fit(lacking, batch, engine=ENGINE, pooled=True)
    assert confirmed(ended, batch).cost <= ended.cost


def test_a_restart_that_would_be_unphysical_begins_nearer(
    batch: Batch, lacking: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, brief = lacking.with_values({"F_c": 0.02, "P_m2": 0.03}), Options(max_iterations=3)
    (stopped,) = fit(start, batch, engine=ENGINE, pooled=True, warm=False, options=brief)
    whole = System.with_values

    def refusing(self: System, values: dict[str, float]) -> System:
        if abs(values["F_c"] - stopped.system.parameter("F_c").spec.value) > limit:
            raise InputError("unphysical")
        return whole(self, values)

    limit = 1e-4
    monkeypatch.setattr(System, "with_values", refusing)
    assert confirmed(stopped, batch).cost <= stopped.cost
    limit = -1.0
    assert confirmed(stopped, batch) is stopped  # no restart is possible

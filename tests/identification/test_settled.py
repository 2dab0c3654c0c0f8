"""Pieces of records begin in hidden states as the fitted values say, wherever the fit began."""

import numpy as np
import pytest
import torch

from hybrid_id.components import Viscous
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.least_squares import Options
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.study.replay import cross_validate
from hybrid_id.study.run import identify
from hybrid_id.systems import one_link, one_link_flexible
from hybrid_id.systems.chain import System

NOISE, STEP = 1e-3, 0.01
TRUTH = one_link_flexible(50.0, vertical=True).with_values({"k": 30.0})
PIECES = Horizon("windows", 0.5)


def record(seed: int, side: str = "m", truth: System = TRUTH, noise: float = NOISE) -> Record:
    """A multisine at a drive whose soft gear turns a link that nobody sees, or a link that alone is seen."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(600)
    waves = zip((3.0, 3.0, 2.0, 2.0, 1.5), (0.3, 0.7, 1.3, 2.1, 3.3), rng.uniform(0, 6, 5), strict=True)
    u = sum(size * np.sin(2 * np.pi * f * time + phase) for size, f, phase in waves) * (time >= 0.2)
    angle = f"q_{side}1"
    blank = Record(f"run_{seed}", time, {"u1": u}, {angle: 0.0 * time})
    batch = make_batch(truth, [blank], noise_std={angle: noise})
    run = simulate(truth, with_substeps(truth, compiled_for(truth, Engine()), batch), batch)
    measured = run.y[0, :, 0].numpy() + noise * rng.standard_normal(len(time))
    return Record(blank.name, time, blank.inputs, {angle: measured})


def at_the_link(truth: System, noise: float) -> Dataset:
    """Records whose encoder sits at the link: the rotor turns unseen."""
    records = (record(1, "a", truth, noise), record(2, "a", truth, noise))
    return Dataset(
        "link", (Channel("u1", "V"),), (Channel("q_a1", "rad", noise),), records, STEP, signal_share=0.0
    )


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset(
        "soft",
        (Channel("u1", "V"),),
        (Channel("q_m1", "rad", NOISE),),
        (record(1), record(2)),
        STEP,
        signal_share=0.0,
    )


def stiffness(dataset: Dataset, start: System, *, pooled: bool = True, jobs: int = 1) -> list[float]:
    """Stiffness over the rotor's inertia of each set, whose scale nothing identifies."""
    study = identify(dataset, start, pooled=pooled, horizon=PIECES, jobs=jobs)
    found = [dict(zip(one.names, one.values, strict=True)) for one in study.sets]
    return [float(one["k"] / one["J_m"]) for one in found]


@pytest.mark.parametrize("start", [15.0, 60.0])
def test_the_start_value_of_a_soft_gear_is_no_estimate(dataset: Dataset, start: float) -> None:
    """Its twist was held to what the start values say, and the stiffness with it: four times too large."""
    true = TRUTH.parameter("k").spec.value / TRUTH.parameter("J_m").spec.value
    assert stiffness(dataset, TRUTH.with_values({"k": start}))[0] == pytest.approx(true, rel=0.1)


def test_a_rotor_that_nobody_sees_is_as_hidden_as_a_link() -> None:
    true = TRUTH.parameter("k").spec.value / TRUTH.parameter("J_m").spec.value
    found = stiffness(at_the_link(TRUTH, NOISE / 50.0), TRUTH.with_values({"k": 15.0}))
    assert found[0] == pytest.approx(true, rel=0.1)


def test_first_states_of_a_hidden_rotor_explain_nothing() -> None:
    """Free in every window, they gave a soft gear a third of what a stiff one leaves where dry friction lacks."""
    stiff = at_the_link(one_link(50.0, vertical=True), NOISE)
    lacking = [build(50.0, friction=Viscous(), vertical=True) for build in (one_link, one_link_flexible)]
    brief = {"pooled": True, "horizon": PIECES, "options": Options(max_iterations=40)}
    sets = [identify(stiff, one, **brief).sets[0] for one in lacking]
    assert sets[0].noise_scale > 3.0 and sets[1].noise_scale > 0.9 * sets[0].noise_scale


def test_each_record_settles_by_itself_in_any_process(dataset: Dataset) -> None:
    start = TRUTH.with_values({"k": 60.0})
    here, there = (stiffness(dataset, start, pooled=False, jobs=jobs) for jobs in (1, 2))
    true = TRUTH.parameter("k").spec.value / TRUTH.parameter("J_m").spec.value
    assert here == pytest.approx([true] * 2, rel=0.15) and there == pytest.approx(here, rel=1e-6)


def test_each_set_is_judged_from_its_own_hidden_states(dataset: Dataset) -> None:
    batch, engine = (
        make_batch(TRUTH, list(dataset.records), noise_std={"q_m1": NOISE}),
        compiled_for(TRUTH, Engine()),
    )
    sets = []
    for k, name in zip((15.0, 60.0), batch.names, strict=True):
        system, rows = TRUTH.with_values({"k": k}), batch.take(torch.tensor([batch.names.index(name)]))
        part = PIECES.cut(system, engine, rows)
        sets += fit(system, part, pooled=True, engine=engine, options=Options(max_iterations=0))
    both = cross_validate(sets, batch, PIECES, pooled=False).fits
    for one, seen in zip(sets, both, strict=True):
        own = cross_validate([one], batch, PIECES, pooled=False).fits[0]
        np.testing.assert_allclose(seen, own, rtol=1e-9)
    others = PIECES.cut(sets[0].system, engine, batch)
    assert np.abs(cross_validate(sets[1:], others, pooled=False).fits[0] - both[1]).max() > 1e-3


def test_pieces_of_a_record_are_one_record_to_its_covariance(dataset: Dataset) -> None:
    batch, engine = (
        make_batch(TRUTH, list(dataset.records), noise_std={"q_m1": NOISE}),
        compiled_for(TRUTH, Engine()),
    )
    part = PIECES.cut(TRUTH, engine, batch)
    (one,) = fit(TRUTH, part, pooled=True, engine=engine, options=Options(max_iterations=0))
    jacobian, residual = one.of_records()
    assert len(one.residual) == part.rows > len(residual) == len(jacobian) == 2
    np.testing.assert_array_equal(np.concatenate(residual), np.concatenate(one.residual))
    np.testing.assert_array_equal(np.concatenate(jacobian), np.concatenate(one.jacobian))

"""Bounds, robust losses, several starts, status and determinism of a fit; the development cases."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import make_record, make_records, multisine, only, rigid_drive
from gapcase import small_case
from scipy.optimize import least_squares

from hybrid_id.components import Backlash, Stribeck
from hybrid_id.components.load.spring import Spring
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit, fit_records, make_bounds, start_points
from hybrid_id.identification.least_squares import (
    PATIENCE,
    Options,
    comes_to_nothing,
)
from hybrid_id.identification.objective import Loss
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.uncertainty import robust_covariance
from hybrid_id.study.replay import batch_of
from hybrid_id.systems import System

NOISE = {"q_m1": 0.02}


TRUTH = only(rigid_drive(), "J", "F_c", "F_v")
EXACT = {"J": 2e-5, "F_c": 0.01, "F_v": 5e-5}


def record(seed: int, samples: int = 1000, noise: float = 0.02) -> Record:
    return make_record(
        TRUTH, multisine(seed, samples=samples), seed=seed, noise={"q_m1": noise}, name=f"r{seed}"
    )


@pytest.fixture(scope="module")
def batch() -> Batch:
    return make_batch(TRUTH, [record(k) for k in range(3)], noise_std=NOISE, signal_share=0.0)


def boxed(name: str, value: float, lower: float, upper: float) -> System:
    unit = TRUTH.parameter(name).spec.unit
    return TRUTH.with_specs({name: Bounded(value, lower, upper, unit)})


@pytest.mark.parametrize("lower, upper", [(2.4e-5, 5e-5), (1e-6, 1.7e-5)])
def test_truth_outside_the_box_ends_on_the_bound_and_is_told(
    batch: Batch, lower: float, upper: float
) -> None:
    (found,) = fit(boxed("J", 0.5 * (lower + upper), lower, upper), batch, pooled=True)
    assert found.at_bound == ("J",)
    assert found.values[found.names.index("J")] == (lower if lower > 2e-5 else upper)
    assert found.status == "converged"
    assert "at its bound" in found.summary()
    # the others are the best that the bound allows
    held = only(TRUTH.with_values({"J": lower if lower > 2e-5 else upper}), "F_c", "F_v")
    (best,) = fit(held, batch, pooled=True)
    for name in ("F_c", "F_v"):
        assert found.values[found.names.index(name)] == pytest.approx(
            best.values[best.names.index(name)], rel=2e-3
        )


def test_start_on_a_bound_leaves_it(batch: Batch) -> None:
    start = TRUTH.with_values({"F_c": 0.0, "F_v": 0.0})
    (found,) = fit(start, batch, pooled=True)
    assert found.status == "converged" and not found.at_bound
    for name, value in zip(found.names, found.values, strict=True):
        assert value == pytest.approx(EXACT[name], rel=0.03)


def test_nested_fit_from_the_simpler_optimum_is_never_worse(batch: Batch) -> None:
    (simple,) = fit(TRUTH, batch, pooled=True)
    richer = simple.system.with_component("joint1/motor_friction", Stribeck(F_drop=0.0, v_s=10.0))
    (found,) = fit(richer, batch, pooled=True, warm=False)
    assert found.cost <= simple.cost * (1 + 1e-9)
    assert found.values[found.names.index("F_drop")] < 1e-3


def of_their_own(runs: Batch) -> Batch:
    """The rows as records of their own, each of which gets a parameter set."""
    return replace(runs, names=tuple(map(str, range(runs.rows))))


def test_wide_starts_all_arrive() -> None:
    runs = make_batch(TRUTH, [record(k, samples=700) for k in range(2)], noise_std=NOISE, signal_share=0.0)
    generator = np.random.default_rng(0)
    rows = torch.arange(2).repeat(6)
    theta = TRUTH.theta().detach()[:, None].repeat(1, 12)
    free = [k for k, i in enumerate(TRUTH.table) if i.spec.estimate]
    theta[free] *= torch.tensor(generator.uniform(0.5, 1.5, (3, 12)))
    results = fit(TRUTH, of_their_own(runs.take(rows)), start_values=theta)
    assert {r.status for r in results} == {"converged"}
    values = np.array([r.values for r in results])
    for k in range(2):
        np.testing.assert_allclose(values[k::2], np.tile(values[k], (6, 1)), rtol=2e-3)


def test_several_starts_keep_the_best(batch: Batch, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = TRUTH.with_values({"J": 4e-4, "F_c": 0.3, "F_v": 2e-3})
    short = Options(max_iterations=4)
    (one,) = fit(bad, batch, pooled=True, warm=False, options=short)
    (many,) = fit(bad, batch, pooled=True, warm=False, options=short, starts=6, spread=0.95, seed=3)
    assert many.cost <= one.cost
    drawn = torch.stack([s.theta().detach() for s in (bad, TRUTH)], 1)
    monkeypatch.setattr("hybrid_id.identification.fit.start_points", lambda *_: drawn)
    (best,) = fit(bad, batch, pooled=True, warm=False, options=short, starts=2)
    assert best.cost < 0.5 * one.cost
    monkeypatch.undo()
    per_record = fit(TRUTH, batch, starts=3)
    single = fit(TRUTH, batch)
    for a, b in zip(per_record, single, strict=True):
        assert a.records == b.records and a.cost <= b.cost * (1 + 1e-6)
        np.testing.assert_allclose(a.values, b.values, rtol=1e-3)


@pytest.mark.parametrize("start", [0.3, 1e-2, -1e-4])
def test_how_near_to_zero_an_angle_starts_is_no_measure_of_its_steps(start: float) -> None:
    dataset, nominal = small_case(Spring(k_s=0.4, q_s=0.6), "joint1/load")
    begun = Spring(k_s=0.2, q_s=Bounded(start, -4.0, 4.0, "rad"))
    system = nominal.with_component("joint1/load", begun)
    (found,) = fit(
        system, batch_of(replace(dataset, signal_share=0.0), system, dataset.train), pooled=True, warm=False
    )
    assert found.noise_scale < 1.05
    assert found.values[found.names.index("q_s")] == pytest.approx(0.6, abs=0.002)


def test_start_points_stay_inside_and_begin_with_the_given_one() -> None:
    free = [k for k, i in enumerate(TRUTH.table) if i.spec.estimate]
    system = boxed("J", 2e-5, 1.8e-5, 2.1e-5)
    points = start_points(system, free, make_bounds(system, free), range(2), 4, 0.5, 0)
    assert points.shape == (len(system.table), 8)
    torch.testing.assert_close(points[:, :2], system.theta().detach()[:, None].expand(-1, 2))
    j = [i.name for i in system.table].index("J")
    assert (points[j] >= 1.8e-5).all() and (points[j] <= 2.1e-5).all()
    fixed = [k for k in range(len(system.table)) if k not in free]
    assert (points[fixed] == points[fixed, :1]).all()
    # a set that another process fits starts where it would have started beside the others
    alone = start_points(system, free, make_bounds(system, free), [1], 4, 0.5, 0)
    torch.testing.assert_close(alone, points[:, 1::2])


@pytest.mark.parametrize("loss", [Loss("huber", 2.0), Loss("l1", 0.5)], ids=lambda loss: loss.kind)
def test_standard_errors_of_robust_losses_are_the_scatter_of_estimates(loss: Loss) -> None:
    """Errors five times as large as the weights say: taken from the re-weighting they were half of it."""
    clean, rng = record(0, noise=0.0), np.random.default_rng(5)
    noisy = [
        Record(
            f"r{k}", clean.time, clean.inputs, {"q_m1": clean.outputs["q_m1"] + rng.laplace(0.0, 0.1, 1000)}
        )
        for k in range(60)
    ]
    batch = make_batch(TRUTH, noisy, noise_std=NOISE, signal_share=0.0)
    batch = replace(batch, x=batch.x.clone(), x0_std=torch.zeros_like(batch.x0_std))
    batch.x[:, 0] = 0.0  # known: the weights would claim too much of a measured one
    sets = fit(TRUTH, batch, options=Options(loss=loss))
    said = np.mean([robust_covariance(one.jacobian, one.residual).std_error for one in sets], axis=0)
    scatter = np.std([one.values for one in sets], axis=0, ddof=1)
    np.testing.assert_allclose(said / scatter, 1.0, atol=0.2)


@pytest.mark.parametrize("loss", [Loss("huber", 2.0), Loss("l1", 0.1)], ids=lambda loss: loss.kind)
def test_robust_losses_resist_outliers(loss: Loss) -> None:
    clean = record(0, samples=1200)
    generator = np.random.default_rng(1)
    spoilt = clean.outputs["q_m1"].copy()
    spoilt[100:][generator.random(1100) < 0.04] += 3.0  # 150 standard deviations, one-sided
    dirty = Record("dirty", clean.time, clean.inputs, {"q_m1": spoilt})
    one = make_batch(TRUTH, [dirty], noise_std=NOISE, signal_share=0.0)
    error = {}
    for name, options in (("l2", Options()), (loss.kind, Options(loss=loss))):
        (found,) = fit(TRUTH, one, options=options)
        assert found.status == "converged"
        error[name] = max(abs(v / EXACT[n] - 1) for n, v in zip(found.names, found.values, strict=True))
    assert error[loss.kind] < 0.4 * error["l2"] and error[loss.kind] < 0.01, error


def test_a_fit_goes_on_from_the_first_states_of_an_earlier_one(batch: Batch) -> None:
    start = TRUTH.with_values({"J": 6e-5, "F_c": 0.002})
    (first,) = fit(start, batch, pooled=True)
    again = Options(max_iterations=3)
    (on,) = fit(first.system, batch, pooled=True, warm=False, options=again, x0=torch.as_tensor(first.x0))
    (anew,) = fit(first.system, batch, pooled=True, warm=False, options=again)
    assert on.history[0] == pytest.approx(first.cost, rel=1e-6)
    assert anew.history[0] > 1.001 * first.cost  # from the noise of every measured state
    # several starts begin there, too; a row that leaves all bounds begins at its measured states
    (many,) = fit(
        first.system, batch, pooled=True, warm=False, starts=3, options=again, x0=torch.as_tensor(first.x0)
    )
    assert many.cost <= on.cost * (1 + 1e-9)
    lost = torch.as_tensor(first.x0).clone()
    lost[0] = torch.nan
    (found,) = fit(first.system, batch, pooled=True, warm=False, options=again, x0=lost)
    assert found.cost == pytest.approx(first.cost, rel=1e-3)


def test_a_fit_that_leaves_structure_ends_where_it_gains_little(batch: Batch) -> None:
    lacking = TRUTH.with_specs({"F_c": replace(TRUTH.parameter("F_c").spec, value=0.0, estimate=False)})
    endless = Options(max_iterations=30, tolerance=0.0)
    (whole,) = fit(lacking, batch, pooled=True, options=endless)
    (short,) = fit(lacking, batch, pooled=True, options=replace(endless, least_gain=1e-3))
    assert short.iterations < whole.iterations and short.status != "max_iterations"
    assert short.cost < 1.001 * whole.cost
    # what leaves noise alone goes on: there is nothing beyond it to gain a share of
    start = TRUTH.with_values({"J": 6e-5, "F_c": 0.002})
    ends = [fit(start, batch, pooled=True, options=Options(least_gain=share))[0] for share in (0.0, 1e-3)]
    np.testing.assert_allclose(ends[1].values, ends[0].values, rtol=1e-5)


def test_a_fit_that_has_lost_its_way_ends() -> None:
    costs = torch.tensor([[1e-4]] * (PATIENCE + 1) + [[1.0]], dtype=torch.float64)
    for share, ends in ((1e-3, True), (0.0, False)):
        assert bool(comes_to_nothing(costs, torch.tensor([100.0]), share)) is ends


def test_iterations_that_run_out_are_told(batch: Batch) -> None:
    start = TRUTH.with_values({"J": 6e-5, "F_c": 0.002})
    (found,) = fit(start, batch, pooled=True, warm=False, options=Options(max_iterations=2))
    assert found.status == "max_iterations" and not found.ok
    assert "max_iterations" in found.message and found.iterations <= 2
    assert len(found.history) >= 2 and found.history[-1] < found.history[0]


def test_diverging_start_is_a_status_and_spares_the_others(batch: Batch) -> None:
    theta = TRUTH.theta().detach()[:, None].repeat(1, 3)
    theta[[i.name for i in TRUTH.table].index("F_v"), 1] = 1e5  # stiff beyond any number of sub-steps
    results = fit(TRUTH, batch, start_values=theta, warm=False)
    assert [r.status for r in results] == ["converged", "diverged", "converged"]
    assert not results[1].ok and "start values" in results[1].message
    np.testing.assert_allclose(results[0].values, fit(TRUTH, batch)[0].values, rtol=1e-3)


def test_nothing_to_estimate_is_refused(batch: Batch) -> None:
    with pytest.raises(InputError, match="no parameter to estimate"):
        fit(only(TRUTH), batch)


def test_same_seed_same_result_bit_for_bit(batch: Batch) -> None:
    a, b = (fit(TRUTH.with_values({"J": 2.6e-5}), batch, starts=2, seed=5) for _ in range(2))
    for x, y in zip(a, b, strict=True):
        assert (x.values == y.values).all() and x.cost == y.cost and x.history == y.history
        assert all((p == q).all() for p, q in zip(x.jacobian, y.jacobian, strict=True))


def test_progress_is_told_and_can_stop_the_fit(batch: Batch) -> None:
    seen: list[tuple[str, int]] = []

    def watch(stage: str, iteration: int, cost: torch.Tensor, running: torch.Tensor) -> bool:
        seen.append((stage, iteration))
        return stage == "records" and iteration >= 2

    (found,) = fit(TRUTH.with_values({"J": 4e-5}), batch, pooled=True, warm=False, progress=watch)
    assert seen == [("records", 1), ("records", 2)]
    assert found.status == "interrupted"


def test_result_says_all(batch: Batch) -> None:
    (found,) = fit(TRUTH, batch, pooled=True)
    assert found.ok and found.records == ("r0", "r1", "r2")
    assert found.system.parameter("J").spec.value == found.values[found.names.index("J")]
    assert found.n_samples == 3000
    assert found.residual[0].shape == (1000, 1) and found.jacobian[0].shape == (1000, 1, 3)
    small = found.condensed()
    assert small.jacobian[0].shape == (3, 1, 3) and small.unseen == found.unseen
    for whole, root in zip(found.jacobian, small.jacobian, strict=True):
        whole, root = whole.reshape(-1, 3), root.reshape(-1, 3)
        np.testing.assert_allclose(root.T @ root, whole.T @ whole, rtol=1e-9)
    for words in ("converged", "J ", "kg m^2", "weighted residual"):
        assert words in found.summary()
    free_run = simulate(
        found.system,
        found.engine,
        replace(batch, x=torch.cat([torch.tensor(found.x0)[:, None], batch.x[:, 1:]], 1)),
    )
    residual = ((batch.y - free_run.y) * batch.weight).numpy()
    np.testing.assert_allclose(np.stack(found.residual), residual, atol=0.02)


def test_jacobian_of_the_result_is_that_of_the_simulation(batch: Batch) -> None:
    (found,) = fit(TRUTH, batch.take(torch.tensor([0])))
    at = batch.take(torch.tensor([0]))
    at = replace(at, x=torch.cat([torch.tensor(found.x0)[:, None], at.x[:, 1:]], 1))
    for column, name in enumerate(found.names):
        size = 1e-4 * found.values[column]
        up, down = (
            simulate(found.system.with_values({name: found.values[column] + s}), found.engine, at).y
            for s in (size, -size)
        )
        slope = ((up - down) / (2 * size) * at.weight)[0, :, 0].numpy()
        # the start angle is eliminated from the result's columns, and at rest it moves nothing else
        flat = found.jacobian[0][:, 0, column]
        assert np.abs((slope - slope.mean()) - (flat - flat.mean())).max() < 0.02 * np.abs(slope).max()


def test_record_without_motion_tells_nothing_and_says_so() -> None:
    time = 0.002 * np.arange(400)
    noise = 0.02 * np.random.default_rng(0).standard_normal(400)
    still = Record("still", time, {"u1": np.zeros(400)}, {"q_m1": noise})
    (found,) = fit(TRUTH, make_batch(TRUTH, [still], noise_std=NOISE))
    assert found.unseen == found.names
    assert all(v == EXACT[n] for n, v in zip(found.names, found.values, strict=True))


@pytest.mark.parametrize("samples", [5, 6, 9, 30])
def test_few_samples_are_fitted_without_a_fault(samples: int) -> None:
    cut = record(0, samples=200).between(0.1, 0.1 + 0.002 * (samples - 0.5))
    assert cut.n_samples == samples
    (found,) = fit(TRUTH, make_batch(TRUTH, [cut], noise_std=NOISE))
    assert np.isfinite(found.values).all() and np.isfinite(found.cost)


def test_end_is_that_of_an_independent_optimiser() -> None:
    one = make_batch(TRUTH, [record(4, samples=300)], noise_std=NOISE, signal_share=0.0, estimate_start=False)
    start = TRUTH.with_values({"J": 2.3e-5, "F_c": 0.009, "F_v": 6e-5})
    (found,) = fit(start, one)
    scale = np.array([EXACT[n] for n in found.names])

    def residual(z: np.ndarray) -> np.ndarray:
        system = TRUTH.with_values(dict(zip(found.names, z * scale, strict=True)))
        return ((simulate(system, found.engine, one).y - one.y) * one.weight).flatten().numpy()

    best = least_squares(
        residual, found.values / scale * 1.02, diff_step=1e-5, bounds=(0.1, 10.0), xtol=1e-12
    )
    assert found.cost == pytest.approx(best.cost, rel=1e-7)
    np.testing.assert_allclose(found.values / scale, best.x, rtol=1e-4)


def test_sets_behind_play_grow_on_records_of_less_than_half_a_second() -> None:
    loose = rigid_drive().with_component("joint1/transmission", Backlash(gap=0.02))
    made = make_records(loose, [multisine(k, samples=60, rest=10) for k in range(2)], noise={"q_m1": 0.01})
    batch = make_batch(loose, made, noise_std={"q_m1": 0.01})
    ends = fit(loose, batch, starts=2, options=Options(max_iterations=2))
    assert len(ends) == 2 and all(np.isfinite(end.values).all() for end in ends)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
def test_compiled_records_are_fitted_one_by_one_with_sub_steps_of_their_own() -> None:
    records = [record(0), record(1, samples=600), record(2)]
    many = make_batch(TRUTH, records, noise_std=NOISE, signal_share=0.0)
    seen: list[tuple[int, int]] = []

    def progress(_stage: str, _iteration: int, cost: torch.Tensor, running: torch.Tensor) -> None:
        seen.append((len(cost), len(running)))

    each = fit_records(TRUTH, many, engine=Engine(compiled=True), starts=2, progress=progress)
    together = fit(TRUTH, many, engine=Engine(compiled=True), starts=2)
    assert [one.records for one in each] == [("r0",), ("r1",), ("r2",)]
    for one, other in zip(each, together, strict=True):
        np.testing.assert_allclose(one.values, other.values, rtol=2e-3)
        assert one.n_samples == other.n_samples
    assert {sets for sets, _ in seen} == {3}
    assert [left for _, left in seen] == sorted((left for _, left in seen), reverse=True)
    (alone,) = fit_records(
        TRUTH, many.take(torch.tensor([1])), engine=Engine(compiled=True), numbers=[1], starts=2
    )
    np.testing.assert_allclose(alone.values, each[1].values, rtol=1e-9)

"""Fits to the train records, what they predict of records left out, and that processes change nothing."""

import pickle
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from gapcase import small_case
from hypothesis import given
from hypothesis import strategies as st
from joblib import parallel_config
from joblib.externals.loky.process_executor import BrokenProcessPool

import hybrid_id.diagnosis.fits as module
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import FULL, Fits, Task, bounded, engine, predicted, without_priors
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.errors import InputError
from hybrid_id.identification.finite_differences import Rollouts, finite_difference_fit
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.step import Engine


def disturbed(dataset: Dataset, name: str, seed: int = 1) -> Dataset:
    """The dataset with noise in place of what one of its records measured."""
    rng = np.random.default_rng(seed)
    records = (
        replace(r, outputs={n: rng.standard_normal(len(y)) for n, y in r.outputs.items()})
        if r.name == name
        else r
        for r in dataset.records
    )
    return replace(dataset, records=tuple(records))


def test_predictions_are_those_of_explicit_fits_without_each_record() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    fits = Fits(dataset)
    batch = fits.batch(nominal)
    base = finite_difference_fit(nominal, batch, engine=engine(), iterations=FULL)
    found = predicted(base, batch)
    for k, record in enumerate(dataset.train):
        others = torch.tensor([i for i in range(batch.rows) if i != k])
        again = finite_difference_fit(nominal, batch.take(others), engine=engine(), iterations=FULL)
        own = finite_difference_fit(  # the record by the others' values, from the first state that all have found
            again.system, batch.take(torch.tensor([k])), engine=engine(), iterations=0, x0=base.x0[[k]]
        )
        assert found[k].shape == (record.n_samples, 1)
        assert np.square(found[k]).mean() == pytest.approx(np.square(own.residual[0]).mean(), rel=0.02)
    # what a record tells of the parameters itself makes it look better than the others predict it
    assert np.square(np.concatenate(found)).mean() > np.square(np.concatenate(base.residual)).mean()


def test_windows_are_predicted_as_by_explicit_fits_without_their_record() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    batch = Fits(dataset, horizon=Horizon("windows", 0.25)).batch(nominal)
    base = fit(nominal, batch, pooled=True, engine=engine(), warm=False)[0]
    found, names = predicted(base, batch), np.array(batch.names)
    for name in dict.fromkeys(batch.names):
        own, others = (torch.as_tensor(np.flatnonzero(rows)) for rows in (names == name, names != name))
        again = fit(base.system, batch.take(others), pooled=True, engine=engine(), warm=False)[0]
        rest = Rollouts(base.system, batch.take(own), engine(), base.system.estimated)
        expected = rest.residuals(again.values[None], base.x0[None, own.numpy()])[0]
        assert np.square(np.concatenate([found[k] for k in own.tolist()])).mean() == pytest.approx(
            np.square(expected).mean(),
            rel=0.1,  # a few steps are taken
        )


def test_a_refit_that_has_not_moved_is_shaken(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the ripples of a cost a fit may rest where all records have led it, and predict what it has seen."""
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    batch = Fits(dataset).batch(nominal)
    base = finite_difference_fit(nominal, batch, engine=engine(), iterations=FULL)
    honest = np.square(np.concatenate(predicted(base, batch))).mean()
    monkeypatch.setattr(
        module,
        "finite_difference_fit",
        lambda *args, iterations, **more: finite_difference_fit(*args, iterations=0, **more),
    )
    stuck = np.square(np.concatenate(predicted(base, batch))).mean()
    seen = np.square(np.concatenate(base.residual)).mean()
    assert stuck - seen > 0.5 * (honest - seen) > 0.0


@given(st.floats(0.1, 100.0), st.floats(0.1, 10.0))
def test_a_lost_free_run_errs_by_as_much_as_records_move(size: float, reach: float) -> None:
    errors = [size * np.sin(np.arange(50.0))[:, None], np.full((20, 1), 0.01)]
    lost, small = bounded(errors, np.array([reach]))
    assert np.sqrt(np.square(lost).mean()) == pytest.approx(min(np.sqrt(np.square(errors[0]).mean()), reach))
    assert np.array_equal(small, errors[1])


def test_a_record_does_not_enter_the_values_that_predict_it() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    batch = Fits(dataset).batch(nominal)
    result = finite_difference_fit(nominal, batch, engine=engine(), iterations=5)
    noise = torch.as_tensor(np.random.default_rng(1).standard_normal(batch.y.shape[1:]))
    noisy = replace(batch, y=batch.y.clone())
    noisy.y[0] += noise

    def simulated(records: Batch) -> np.ndarray:
        return records.y[0].numpy() - predicted(result, records)[0] / records.weight[0].numpy()

    np.testing.assert_allclose(simulated(noisy), simulated(batch), atol=1e-9)
    assert not np.allclose(
        simulated(batch), batch.y[0].numpy() - result.residual[0] / batch.weight[0].numpy()
    )


def test_a_single_record_is_left_out_block_by_block() -> None:
    for missing in (None, REGISTRY["spring_load"](k_s=0.6, q_s=0.3)):
        dataset, nominal = small_case(missing)
        fits = Fits(replace(dataset, records=dataset.records[:1]))
        base = fits.base(nominal)
        assert base.validation.error >= np.square(base.result.residual[0]).mean()
        if missing is not None:
            spring = nominal.with_component("joint1/load", REGISTRY["spring_load"](k_s=0.5, q_s=0.2))
            (right,) = fits.run([Task((("spring_load", "joint1/load"),), spring)], FULL)
            assert right is not None and right.validation.fall(base.validation) > 0.5


def test_what_lacks_something_is_held_as_a_data_sheet_holds_it() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    own = nominal.parameter("P_m1").spec
    nominal = nominal.with_specs({"P_m1": replace(own, prior_mean=own.value, prior_std=0.001)})
    fits = Fits(dataset)
    free, base = fits.base(nominal, free=True), fits.base(nominal)
    assert free.system.parameter("J").spec.prior_std is None

    def moved(one: FittedModel) -> float:
        return abs(np.log(one.system.parameter("J").spec.value / nominal.parameter("J").spec.value))

    assert not base.no_structure and 2.0 * moved(base) < moved(free)
    specs = {info.symbol: info.spec for info in base.system.table}
    assert specs["P_m1"].prior_std == 0.001  # its own
    assert specs["F_c"].prior_std is None  # friction is on no data sheet
    again = {info.symbol: info.spec for info in without_priors(base.system, nominal).table}
    assert again["J"].prior_std is None and again["P_m1"].prior_std == 0.001


def test_a_right_model_is_held_by_nothing() -> None:
    dataset, nominal = small_case()
    base = Fits(dataset).base(nominal)
    assert base.no_structure and all(info.spec.prior_std is None for info in base.system.table)


def test_validation_records_are_judged_by_and_not_fitted() -> None:
    dataset, nominal = small_case()
    records = [replace(r, role="validation") if k == 2 else r for k, r in enumerate(dataset.records)]
    chosen = replace(dataset, records=tuple(records))
    base = Fits(chosen).base(nominal)
    alone = Fits(replace(dataset, records=dataset.records[:2])).base(nominal)
    np.testing.assert_array_equal(base.result.values, alone.result.values)
    assert base.validation.sizes.sum() == records[2].n_samples
    noisy = Fits(disturbed(chosen, records[2].name)).base(nominal)
    np.testing.assert_array_equal(noisy.result.values, base.result.values)
    assert noisy.validation.error > 10.0 * base.validation.error
    every = Fits(chosen).on_all()
    assert len(every.dataset.train) == 3 and not every.dataset.validation
    assert every.dataset.test == dataset.test


def test_free_runs_are_lost_only_where_the_model_is_wrong() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    assert Fits(dataset).astray(Fits(dataset).base(nominal)) > CRITERIA.lost
    dataset, nominal = small_case()
    assert Fits(dataset).astray(Fits(dataset).base(nominal)) < CRITERIA.lost


def test_a_model_that_cannot_be_fitted_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, nominal = small_case()
    monkeypatch.setattr(Fits, "run", lambda *_: [None, None])
    with pytest.raises(InputError, match="diverges on dataset 'small gap'"):
        Fits(dataset).base(nominal)


def test_fits_in_processes_are_those_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, nominal = small_case()
    spring = nominal.with_component("joint1/load", REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    lost = nominal.with_values({"J": 1e-12, "F_c": 0.0})
    some = [Task((), nominal), Task((), lost), Task((("spring_load", "joint1/load"),), spring)]
    in_turn = Fits(dataset).run(some, 2)
    monkeypatch.setattr(module, "PARALLEL_FROM", 0)
    with parallel_config(backend="threading"):  # what a process is given is another test's
        together = Fits(dataset, jobs=2).run(some, 2)
    assert [None if e is None else (e.effects, e.result.cost) for e in together] == [
        None if e is None else (e.effects, e.result.cost) for e in in_turn
    ]
    assert in_turn[0] is not None and in_turn[2] is not None
    fits, task = pickle.loads(pickle.dumps((Fits(dataset, jobs=2), some[2])))
    assert fits.jobs == 2 and task.effects == some[2].effects


def test_fits_whose_process_is_lost_are_done_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lost:
        """Loses its processes after the first result."""

        def __init__(self, n_jobs: int, **_: str) -> None:
            self.lost = n_jobs > 1

        def __call__(self, calls: Iterable[tuple]) -> Iterator[object]:
            for k, (function, args, named) in enumerate(calls):
                if self.lost and k == 1:
                    raise BrokenProcessPool
                yield function(*args, **named)

    dataset, nominal = small_case()
    monkeypatch.setattr(module, "PARALLEL_FROM", 0)
    monkeypatch.setattr(module, "Parallel", Lost)
    fits, some = (
        Fits(dataset, jobs=2),
        [Task((), nominal.with_values({"F_v": v})) for v in (4e-5, 5e-5, 6e-5)],
    )
    together, in_turn = fits.run(some, 1), Fits(dataset).run(some, 1)
    assert [e and e.result.cost for e in together] == [e and e.result.cost for e in in_turn]
    assert fits.jobs == 1


def test_a_process_need_not_know_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where fits are shared, an effect of the user's own is registered in the first process alone."""
    told = []

    def nearest(how: Engine, task: Task, batch: Batch, iterations: int, halting: bool) -> None:
        told.append(halting)
        raise RuntimeError("this is all that was asked")

    class Elsewhere:
        def __init__(self, **_: object) -> None:
            pass

        def __call__(self, calls: Iterable[tuple]) -> Iterator[object]:
            for function, args, named in calls:
                with monkeypatch.context() as there:
                    for name in list(CATALOGUE):
                        there.delitem(CATALOGUE, name)
                    yield function(*args, **named)

    dataset, nominal = small_case()
    monkeypatch.setattr(module, "_nearest", nearest)
    monkeypatch.setattr(module, "Parallel", Elsewhere)
    Fits(dataset, jobs=2).run([Task((("cogging", "joint1/motor"),), nominal), Task((), nominal)], 10)
    assert told == [True, False]


def test_a_fit_over_long_windows_also_begins_where_one_over_short_ones_has_ended() -> None:
    """A motor that rests in its detents halts a fit over a second of free run, and not one over half of it."""
    name = "cogging", "joint1/motor"
    dataset, nominal = small_case(REGISTRY["cogging"](T_c=0.0, T_s=0.01, n=6.0), name[1])
    fits = Fits(dataset, horizon=Horizon("windows", 1.0))
    start = nominal.with_component(name[1], REGISTRY["cogging"](T_c=0.0, T_s=0.003, n=6.0))
    (found,) = fits.run([Task((name,), start)], FULL)
    alone = module._within(fits.engine, start, fits.batch(start), FULL)
    assert found is not None and found.result.cost < 0.3 * alone.cost

"""Windows begin where the machine was seen to be, and with what only the model knows where its free run had it."""

import pickle
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pytest
import torch
from gapcase import small_case
from joblib import parallel_config
from joblib.externals.loky.process_executor import BrokenProcessPool

import hybrid_id.diagnosis.select as module
import hybrid_id.diagnosis.fits as refit_module
import hybrid_id.diagnosis.candidates as starts
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.select import attribute
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.fits import Fits, Task, engine
from hybrid_id.diagnosis.unidentified import untold
from hybrid_id.diagnosis.windows import windows
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.study.replays import batch_of


def cut(place: str, kind: str, **values: float):
    dataset, today = small_case()
    system = today.with_component(place, REGISTRY[kind](**values))
    batch = batch_of(dataset, system, dataset.train, 0.004, "cpu")
    return system, batch, windows(system, engine(), batch, 0.25)


def test_measured_states_begin_as_measured_and_may_move() -> None:
    _, batch, found = cut("joint1/motor", "thermal_derating", T_w=1.0, c=10.0)
    assert found.rows == 6 * batch.rows
    assert torch.equal(found.x[1, 0, :2], batch.x[0, 50, :2])
    assert (found.x0_std[:, :2] > 0).all()
    assert found.names[:6] == (batch.names[0],) * 6


def test_heat_begins_as_in_the_free_run_and_is_held() -> None:
    system, batch, found = cut("joint1/motor", "thermal_derating", T_w=1.0, c=1e4)
    (row,) = system.memory_rows
    fine = with_substeps(system, engine(), batch, system.theta().detach()[:, None].expand(-1, batch.rows))
    run = simulate(system, fine, batch).x
    assert run[0, 250, row] > 0.0
    assert found.x[5, 0, row] == pytest.approx(float(run[0, 250, row]))
    assert (found.x0_std[:, row] == 0).all()


def test_twist_that_nobody_sees_begins_as_in_the_free_run_and_is_held() -> None:
    system, batch, found = cut("joint1/transmission", "joint_flexibility", compliance=0.05, zeta=0.3)
    ratio, (motor, link) = system.joints[0].gear_ratio, system.joints[0].positions
    run = simulate(system, engine(), batch).x[0, 250]
    twist = float(run[link] - run[motor] / ratio)
    assert abs(twist) > 1e-4
    assert float(found.x[5, 0, link] - found.x[5, 0, motor] / ratio) == pytest.approx(twist)
    assert (found.x0_std[:, link : link + 2] == 0).all()


def test_records_of_less_than_four_windows_stay_whole() -> None:
    dataset, today = small_case()
    batch = batch_of(dataset, today, dataset.train, 0.004, "cpu")
    assert windows(today, engine(), batch, 0.5) is batch


def test_free_runs_are_lost_only_where_the_model_is_wrong() -> None:
    dataset, today = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    refit = Fits(dataset)
    lacking = refit.base(today)
    assert refit.strays(lacking)
    dataset, today = small_case()
    assert not Fits(dataset).strays(Fits(dataset).base(today))


def test_search_over_windows_names_the_same_and_ends_with_whole_records(monkeypatch) -> None:
    dataset, today = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    monkeypatch.setattr(Fits, "strays", lambda *_: True)
    monkeypatch.setattr(module, "WINDOW", 0.3)
    few = ("spring_load", "thermal_derating", "stribeck_friction")
    monkeypatch.setattr(starts, "CATALOGUE", {name: CATALOGUE[name] for name in few})
    found = attribute(Fits(dataset), today, max_effects=1)
    assert found.window == 0.3
    assert found.chosen.effects == (("spring_load", "joint1/load"),)
    assert len(found.chosen.result.residual) == len(dataset.train)
    assert len(found.rounds[0].before.result.residual) > len(dataset.train)
    assert found.chosen.evidence.error < 0.2 * found.base.evidence.error


def test_what_holds_the_scale_is_said_and_free_scales_are_not_said_twice() -> None:
    dataset, today = small_case()
    assert any("one number" in words and "claim" not in words for words in not_identifiable(dataset, today))
    held = today.with_specs({"J": replace(today.parameter("J").spec, estimate=False)})
    words = not_identifiable(dataset, held)
    assert any("P_m1" in w and "only the claim of J at" in w for w in words), words


def test_fits_in_processes_are_those_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, today = small_case()
    spring = today.with_component("joint1/load", REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    lost = today.with_values({"J": 1e-12, "F_c": 0.0})
    some = [Task((), today), Task((), lost), Task((("spring_load", "joint1/load"),), spring)]
    in_turn = Fits(dataset).run(some, 2)
    monkeypatch.setattr(refit_module, "SHARED_FROM", 0)
    with parallel_config(backend="threading"):  # what a process is given is another test's
        together = Fits(dataset, jobs=2).run(some, 2)
    assert [None if e is None else (e.effects, e.result.cost) for e in together] == [
        None if e is None else (e.effects, e.result.cost) for e in in_turn
    ]
    assert in_turn[0] is not None and in_turn[2] is not None
    refit, task = pickle.loads(pickle.dumps((Fits(dataset, jobs=2), some[2])))
    assert refit.jobs == 2 and task.effects == some[2].effects


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

    dataset, today = small_case()
    monkeypatch.setattr(refit_module, "SHARED_FROM", 0)
    monkeypatch.setattr(refit_module, "Parallel", Lost)
    refit, some = (
        Fits(dataset, jobs=2),
        [Task((), today.with_values({"F_v": v})) for v in (4e-5, 5e-5, 6e-5)],
    )
    together, in_turn = refit.run(some, 1), Fits(dataset).run(some, 1)
    assert [e and e.result.cost for e in together] == [e and e.result.cost for e in in_turn]
    assert refit.jobs == 1


def test_a_process_need_not_know_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where fits are shared, an effect of the user's own is registered in the first process alone."""
    told = []

    def nearest(task: Task, batch: Batch, iterations: int, halting: bool) -> None:
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

    dataset, today = small_case()
    monkeypatch.setattr(refit_module, "_nearest", nearest)
    monkeypatch.setattr(refit_module, "Parallel", Elsewhere)
    Fits(dataset, jobs=2).run([Task((("cogging", "joint1/motor"),), today), Task((), today)], 10)
    assert told == [True, False]

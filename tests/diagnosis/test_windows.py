"""Windows begin where the machine was seen to be, and with what only the model knows where its free run had it."""

import pytest
import torch
from gapcase import small_case

import hybrid_id.diagnosis.diagnose as module
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis import starts
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.fits import Fits, engine
from hybrid_id.diagnosis.thinning import thinned
from hybrid_id.identification.horizons import Horizon
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.study.replay import batch_of


def cut(place: str, kind: str, **values: float):
    dataset, nominal = small_case()
    system = nominal.with_component(place, REGISTRY[kind](**values))
    batch = batch_of(dataset, system, dataset.train)
    return system, batch, Horizon("windows", 0.25).cut(system, engine(), batch)


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


def test_records_that_hold_no_window_stay_whole() -> None:
    dataset, nominal = small_case()
    batch = batch_of(dataset, nominal, dataset.train)
    longest = batch.sample_time * batch.x.shape[1]
    assert Horizon("windows", 1.1 * longest).cut(nominal, engine(), batch) is batch
    assert Horizon("windows", 0.4 * longest).cut(nominal, engine(), batch).rows == 2 * batch.rows


def test_a_search_whose_free_runs_are_lost_goes_over_a_shorter_horizon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    monkeypatch.setattr(Fits, "astray", lambda *_: 1.0)
    monkeypatch.setattr(module, "LENGTHS", (0.3,))
    few = ("spring_load", "thermal_derating", "stribeck_friction")
    monkeypatch.setattr(starts, "CATALOGUE", {name: CATALOGUE[name] for name in few})
    whole = Fits(thinned(dataset, nominal))
    fits, found = module.search(whole, whole.base(nominal), nominal, max_effects=1)
    assert (fits.horizon.kind, fits.horizon.seconds) == ("windows", 0.3)
    assert found.chosen.effects == (("spring_load", "joint1/load"),)
    assert all(len(e.result.residual) > len(dataset.train) for e in (found.base, found.chosen))
    assert found.chosen.error < 0.2 * found.base.error

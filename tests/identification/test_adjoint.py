"""Training by the adjoint method: it ends where Levenberg-Marquardt ends, and it can be stopped and resumed."""

# pyright: reportAttributeAccessIssue=false, reportCallIssue=false

import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from drives import make_records, multisine, rigid_drive
from torch import nn

from hybrid_id import __version__
from hybrid_id.components import ResidualNetwork
from hybrid_id.components.base import LoadTorque
from hybrid_id.errors import InputError
from hybrid_id.identification import adjoint, costate
from hybrid_id.identification.adjoint import Snapshot, TrainOptions
from hybrid_id.identification.fit import fit
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import Bounded
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

NOISE = {"q_m1": 0.02}
SMOOTH = Engine("smooth", substeps=4, width=2.0, compiled=compiler() is not None)
ADJOINT = OdeEngine(fine=4, width=2.0)
train = partial(adjoint.train, engine=ADJOINT)


def respecified(system: System, name: str, value: float, **roles: Any) -> System:
    """The system with one parameter between 0 and 1, in another role."""
    return system.with_specs({name: Bounded(value, 0.0, 1.0, **roles)})


TRUTH = respecified(respecified(rigid_drive(), "P_m1", 0.019, estimate=False), "P_m2", 0.0254, estimate=False)
START = TRUTH.with_values({"J": 3e-5, "F_c": 0.006, "F_v": 8e-5})
QUICK = TrainOptions(windows=((0.05, 2),), tolerance=0.003)


def prepared(system: System = TRUTH, count: int = 2, samples: int = 240) -> Batch:
    """Noisy records of a drive with smooth friction."""
    voltages = [multisine(k, samples=samples, rest=10) for k in range(count)]
    records = make_records(system, voltages, noise=NOISE, engine=SMOOTH)
    return make_batch(system, records, noise_std=NOISE, signal_share=0.0)


@pytest.fixture(scope="module")
def batch() -> Batch:
    return prepared()


@pytest.fixture(scope="module")
def trained(batch: Batch) -> list[FitResult]:
    return train(START, batch, options=QUICK)


def in_standard_errors(found: FitResult, reference: FitResult) -> np.ndarray:
    """Difference of the estimates in standard errors of the reference."""
    jacobian = np.concatenate([j.reshape(-1, len(reference.names)) for j in reference.jacobian])
    information = jacobian.T @ jacobian + np.diag(reference.prior_precision)
    error = np.sqrt(np.diag(np.linalg.inv(information))) * reference.noise_scale
    assert found.names == reference.names
    return (found.values - reference.values) / error


def test_ends_where_levenberg_marquardt_ends(batch: Batch, trained: list[FitResult]) -> None:
    for found, reference in zip(trained, fit(START, batch, engine=SMOOTH), strict=True):
        assert found.status == reference.status == "converged"
        assert np.abs(in_standard_errors(found, reference)).max() < 0.05
        np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-3)
        np.testing.assert_allclose(found.x0, reference.x0, atol=1e-4)
        assert found.n_samples == reference.n_samples and found.iterations < 40


def test_priors_count_as_they_do_in_a_fit(batch: Batch) -> None:
    tight = respecified(START, "F_v", 8e-5, prior_mean=8e-5, prior_std=1e-6)
    one = batch.take(torch.tensor([0]))
    (found,), (reference,) = train(tight, one, options=QUICK), fit(tight, one, engine=SMOOTH)
    assert found.prior_precision.max() == pytest.approx(1e12)
    assert np.abs(in_standard_errors(found, reference)).max() < 0.05


def test_a_parameter_ends_on_its_bound_and_leaves_one() -> None:
    free = TRUTH.with_values({"F_v": 0.0})
    one = prepared(free, 1)
    (found,) = train(START, one, options=QUICK)
    (reference,) = fit(START, one, engine=SMOOTH)
    assert found.at_bound == reference.at_bound
    assert np.abs(found.values - reference.values).max() < 1e-6
    (left,) = train(START.with_values({"F_v": 0.0}), prepared(count=1), options=QUICK)
    assert left.status == "converged" and left.values[left.names.index("F_v")] > 2e-5


def test_robust_loss_takes_the_weight_off_spikes(batch: Batch) -> None:
    spiked = prepared(count=1)
    spiked.y[0, 60::40, 0] += 2.0
    options = TrainOptions(windows=(), loss=Loss("huber"))
    (robust,) = train(TRUTH, spiked, options=options)
    (plain,) = train(TRUTH, spiked, options=TrainOptions(windows=()))
    truth = np.array([TRUTH.parameter(n).spec.value for n in robust.names])
    assert np.abs(robust.values / truth - 1).max() < 0.5 * np.abs(plain.values / truth - 1).max()


# --- stop, resume, fail --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stop_after", [3, 7], ids=["windows", "records"])
def test_resume_goes_on_to_the_same_numbers(
    tmp_path: Path, batch: Batch, trained: list[FitResult], stop_after: int
) -> None:
    saved = tmp_path / "checkpoint.pt"
    stopped = train(
        START, batch, options=QUICK, checkpoint=saved, progress=lambda _, k, cost, run: k >= stop_after
    )
    assert {r.status for r in stopped} & {"interrupted"}
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.pt"]
    assert torch.load(saved, weights_only=True)["program"] == f"hybrid_id {__version__}"
    resumed = train(START, batch, options=QUICK, resume=saved)
    for a, b in zip(resumed, trained, strict=True):
        assert (a.status, a.iterations, a.cost) == (b.status, b.iterations, b.cost)
        np.testing.assert_array_equal(a.values, b.values)


def test_resume_with_a_larger_limit_goes_on(tmp_path: Path, batch: Batch) -> None:
    saved, short = tmp_path / "checkpoint.pt", replace(QUICK, windows=(), max_iterations=3)
    first = train(START, batch, options=short, checkpoint=saved)
    assert {r.status for r in first} == {"max_iterations"}
    longer = train(START, batch, options=replace(short, max_iterations=6), resume=saved)
    whole = train(START, batch, options=replace(short, max_iterations=6))
    for a, b in zip(longer, whole, strict=True):
        assert (a.status, a.iterations) == (b.status, b.iterations)
        np.testing.assert_array_equal(a.values, b.values)


def test_interrupt_keeps_what_is_done(batch: Batch) -> None:
    class Pressed:
        def record(self, snapshot: Snapshot) -> None:
            if snapshot.step == 6:
                raise KeyboardInterrupt

    results = train(START, batch, options=QUICK, writer=Pressed())
    assert all(r.status == "interrupted" and not r.ok for r in results)
    assert all(r.values[r.names.index("J")] != 3e-5 for r in results)


def test_checkpoint_of_another_training_is_refused(tmp_path: Path, batch: Batch) -> None:
    with pytest.raises(InputError, match="no checkpoint"):
        train(START, batch, resume=tmp_path / "nothing.pt")
    (tmp_path / "text.pt").write_text("weights")
    with pytest.raises(InputError, match=r"text\.pt is no checkpoint"):
        train(START, batch, resume=tmp_path / "text.pt")
    saved = tmp_path / "checkpoint.pt"
    train(START, batch, options=QUICK, checkpoint=saved, progress=lambda _, k, cost, run: k >= 2)
    with pytest.raises(InputError, match="other records"):
        train(START, batch.take(torch.tensor([1])), options=QUICK, resume=saved)
    with pytest.raises(InputError, match="other records"):  # other noise, other numbers
        train(START, replace(batch, weight=2.0 * batch.weight), options=QUICK, resume=saved)
    J = START.parameter("J").spec
    with pytest.raises(InputError, match="another model"):
        prior = START.with_specs({"J": replace(J, prior_mean=J.value, prior_std=0.1 * J.value)})
        train(prior, batch, options=QUICK, resume=saved)
    other = copy.deepcopy(START)
    other.gear_ratio = tuple(2.0 * ratio for ratio in START.gear_ratio)
    with pytest.raises(InputError, match="another model"):  # the same names, another gear
        train(other, batch, options=QUICK, resume=saved)
    content = torch.load(saved, weights_only=True)
    del content["state"]["metric"]
    torch.save(content, saved)
    with pytest.raises(InputError, match=r"checkpoint\.pt is damaged or was altered"):
        train(START, batch, options=QUICK, resume=saved)


def test_a_start_that_diverges_is_a_status() -> None:
    wild = START.with_values({"J": 2e-12})
    (result,) = train(wild, prepared(count=1, samples=40), options=TrainOptions(windows=(), max_iterations=3))
    assert result.status in ("diverged", "stalled", "max_iterations") and not result.ok
    assert result.message


def test_nothing_to_estimate_is_refused(batch: Batch) -> None:
    held = {i.name: replace(i.spec, estimate=False) for i in TRUTH.table}
    with pytest.raises(InputError, match="no parameter to estimate"):
        train(TRUTH.with_specs(held), batch)


def test_writer_is_told_of_every_gradient(batch: Batch) -> None:
    class Notes:
        def __init__(self) -> None:
            self.snapshots: list[Snapshot] = []

        def record(self, snapshot: Snapshot) -> None:
            self.snapshots.append(snapshot)

    notes: Any = Notes()
    results = train(START, batch, options=QUICK, validation=batch.take(torch.tensor([1])), writer=notes)
    steps = [s.step for s in notes.snapshots]
    assert steps == sorted(set(steps)) and len(steps) >= max(r.iterations for r in results)
    last = notes.snapshots[-1]
    assert last.names == ("run_0", "run_1") and last.simulated.shape == batch.y.shape
    np.testing.assert_allclose(last.values[0], results[0].values, rtol=1e-9)
    looks = [s.validation for s in notes.snapshots if s.validation is not None]
    assert looks and all(torch.isfinite(look).all() for look in looks)


# --- weights beyond the table --------------------------------------------------------------------------------------


def test_weights_of_a_network_train_beside_the_parameters(batch: Batch) -> None:
    # viscous friction is missing; the network can learn it
    physics = respecified(TRUTH, "F_v", 0.0, estimate=False)
    place, network = "joint1/load", ResidualNetwork(hidden=(4,), output_scale=2.0)
    hybrid, options = physics.with_component(place, network), TrainOptions(windows=(), max_iterations=20)
    (plain,) = train(physics, batch, pooled=True, options=options)
    (found,) = train(hybrid, batch, pooled=True, options=options)
    assert found.cost < 0.9 * plain.cost
    (before,), (after,) = (system.networks.values() for system in (hybrid, found.system))
    assert all(not weight.any() for weight in before.last_weights().values())
    speed = torch.linspace(-1.0, 1.0, 3, dtype=torch.float64)
    torque = after.output(after.view(), [speed], [])
    assert torque[2] > 0 > torque[0]
    with pytest.raises(InputError, match="one record, or pooled"):
        train(hybrid, batch)


def test_weights_of_another_component_are_refused(batch: Batch) -> None:
    class Own(LoadTorque):
        kind = "test_adjoint_net"

        def __init__(self) -> None:
            super().__init__()
            self.last = nn.Linear(1, 1).double()

    with pytest.raises(InputError, match="residual networks only"):
        train(TRUTH.with_component("joint1/load", Own()), batch, pooled=True)


def test_gradient_by_backprop_ends_at_the_same_place(batch: Batch, trained: list[FitResult]) -> None:
    found = train(START, batch, options=QUICK, engine=replace(ADJOINT, gradient="backprop"))
    for a, b in zip(found, trained, strict=True):
        assert np.abs(in_standard_errors(a, b)).max() < 0.02


def test_a_set_that_settled_over_windows_is_not_converged_where_the_training_was_stopped(
    batch: Batch,
) -> None:
    def stop(stage: str, _iteration: int, _cost: Any, going: torch.Tensor) -> bool:
        return stage == "windows" and going.numel() == 0

    options = replace(QUICK, window_tolerance=1e6)
    assert all(r.status == "interrupted" for r in train(START, batch, options=options, progress=stop))


def test_ctrl_c_leaves_the_weights_free(batch: Batch, monkeypatch: pytest.MonkeyPatch) -> None:
    def pressed(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(costate, "free_run", pressed)
    weight = nn.Parameter(torch.ones(1, dtype=torch.float64))
    theta = START.theta().detach()[:, None].expand(-1, batch.rows)
    with pytest.raises(KeyboardInterrupt):
        costate.gradient(START, OdeEngine(), batch, batch.x, theta, [], extra=[weight])
    assert weight.requires_grad

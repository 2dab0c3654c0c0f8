"""Hybrid training: a network finds what the physics lacks and leaves the physics what is its own."""

import math
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
import torch
from drives import make_records, multisine, rigid_drive
from scipy.signal import lfilter

from hybrid_id.components import Cogging, ElectricalLag, ResidualNetwork
from hybrid_id.errors import InputError
from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.hybrid import HybridOptions, HybridResult, fit_physics, losses, train_hybrid
from hybrid_id.identification.networks import (
    linearise_with_weights,
    networks_of,
    with_memory,
    with_price,
    with_scales,
)
from hybrid_id.identification.objective import Loss
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
from hybrid_id.simulation.step import Engine
from hybrid_id.study.hybrid import correlated_errors
from hybrid_id.systems import System, two_link

NOISE = {"q_m1": 0.02}
ENGINE = OdeEngine(fine=4, width=2.0)
STEP = 0.004


def drive() -> System:
    """The physics, its torque scale known."""
    system = rigid_drive(ratio=20.0).with_values({"F_c": 0.005})
    return system.with_specs({"P_m1": replace(system.parameter("P_m1").spec, estimate=False)})


def records(system: System, count: int = 4, samples: int = 200) -> list:
    voltages = [multisine(k, samples=samples, rest=10, amplitude=2.5, step=STEP) for k in range(count)]
    return make_records(system, voltages, noise=NOISE, engine=Engine("smooth", 4, width=2.0), step=STEP)


def hybrid(**options) -> System:
    settings = {"inputs": ("speed", "sin 3", "cos 3"), "hidden": (6,)} | options
    return drive().with_component("joint1/motor", ResidualNetwork(**settings))


def batches(system: System, made: list) -> tuple[Batch, Batch]:
    """Three records to train on, one to validate on."""
    whole = make_batch(system, made, noise_std=NOISE, signal_share=0.0)
    return whole.take(torch.arange(3)), whole.take(torch.tensor([3]))


QUICK = HybridOptions(windows=(), max_iterations=9, validate_every=3)
BRIEF = replace(QUICK, windows=((0.1, 3),), max_iterations=2, validate_every=1)
"""Too short to arrive: for what is to be the same, however far a training gets."""
WITHHELD = drive().with_component("joint1/motor", Cogging(T_c=0.0, T_s=2.5e-3, n=3.0))


@pytest.fixture(scope="module")
def made() -> list:
    return records(WITHHELD)


@pytest.fixture(scope="module")
def found(made: list) -> HybridResult:
    return train_hybrid(hybrid(), *batches(hybrid(), made), engine=ENGINE, options=QUICK)


def deviation(loss: float) -> float:
    """RMS error in units of the noise from a loss per measurement."""
    return math.sqrt(2.0 * loss)


def test_the_network_finds_what_was_withheld(found: HybridResult) -> None:
    physics, best = found.models
    assert deviation(physics.train) > 3.0 and found.chosen == 1
    assert deviation(best.train) < 1.1 and deviation(best.validation) < 1.5
    part = next(iter(best.system.networks.values()))
    angle = torch.linspace(0.0, 6.0, 50, dtype=torch.float64)
    signals = [10.0 * torch.ones_like(angle), torch.sin(3.0 * angle), torch.cos(3.0 * angle)]
    torque = part.output(part.view(), signals, []).detach()
    truth = 2.5e-3 * torch.sin(3.0 * angle)
    assert float((torque - truth).norm() / truth.norm()) < 0.25


def test_without_a_price_nothing_is_known_better(found: HybridResult) -> None:
    names = [info.name for info in found.system.table if info.spec.estimate]
    growth = {}
    for model in found.models:
        assert (model.loose >= model.errors * (1 - 1e-6)).all()
        growth = dict(zip(names, model.loose / found.models[0].errors, strict=True))
    assert growth["F_v"] > 3.0 * growth["J"]  # the network reads the speed, and no acceleration


@pytest.fixture(scope="module")
def brief(made: list) -> HybridResult:
    return train_hybrid(hybrid(), *batches(hybrid(), made), engine=ENGINE, options=BRIEF)


def same(one: HybridResult, other: HybridResult) -> None:
    """Hold that two trainings came to the same numbers."""
    assert one.chosen == other.chosen and not one.interrupted
    for a, b in zip(one.models, other.models, strict=True):
        for what in ("train", "validation", "iterations", "status"):
            assert getattr(a, what) == getattr(b, what)
        for weight, twin in zip(a.system.parameters(), b.system.parameters(), strict=True):
            assert torch.equal(weight, twin)


def test_resume_goes_on_to_the_same_numbers(tmp_path: Path, made: list, brief: HybridResult) -> None:
    saved, data = tmp_path / "checkpoint.pt", batches(hybrid(), made)
    for stop in (1, 5):
        stopped = train_hybrid(
            hybrid(), *data, engine=ENGINE, options=BRIEF, checkpoint=saved, resume=saved if saved.exists() else None,
            progress=lambda label, k, loss, stop=stop: k >= stop,
        )  # fmt: skip
        assert stopped.interrupted
    same(train_hybrid(hybrid(), *data, engine=ENGINE, options=BRIEF, resume=saved), brief)
    for other in (replace(BRIEF, price=0.5), replace(BRIEF, optimizer="adam")):
        with pytest.raises(InputError, match="other records, another model or other settings"):
            train_hybrid(hybrid(), *data, engine=ENGINE, options=other, resume=saved)
    moved = data[0].take(torch.arange(data[0].rows))
    moved.y[0, 5] += 0.1
    for wrong, records in ((hybrid(hidden=(3,)), data), (hybrid(), (moved, data[1]))):
        with pytest.raises(InputError, match="other records, another model or other settings"):
            train_hybrid(wrong, *records, engine=ENGINE, options=BRIEF, resume=saved)


@pytest.mark.parametrize("moment", ["between two steps", "half-way through a checkpoint"])
def test_a_killed_run_leaves_a_checkpoint(
    tmp_path: Path, made: list, brief: HybridResult, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL gives no chance to tidy up: what lies there has to be whole, whenever it comes."""
    saved, data = tmp_path / "checkpoint.pt", batches(hybrid(), made)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        count, whole = 0, torch.save

        def broken(content: object, file: BinaryIO) -> None:
            nonlocal count
            count += 1
            whole(content, file)
            if count == 4:
                if moment != "between two steps":
                    file.truncate(1000)
                os.write(writer, b"!")
                time.sleep(60)

        torch.save = broken
        try:
            train_hybrid(hybrid(), *data, engine=ENGINE, options=BRIEF, checkpoint=saved)
        finally:  # a child that lives on would run the rest of the tests
            os._exit(1)
    os.close(writer)
    assert os.read(reader, 1) == b"!"
    os.kill(child, signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    same(train_hybrid(hybrid(), *data, engine=ENGINE, options=BRIEF, resume=saved), brief)


def test_physics_alone_does_not_see_hidden_states() -> None:
    """Those of joint 1's network lie before joint 2's angle in the state."""
    arm = two_link((50.0, 30.0)).with_component("joint1/motor", ResidualNetwork(memory=2))
    generator, time = np.random.default_rng(0), 0.01 * np.arange(60)
    u = {f"u{k}": 5.0 * np.sin(3.0 * k * time + generator.uniform(0, 6)) for k in (1, 2)}
    outputs = {f"q_m{k}": 20.0 * np.sin(2.0 * k * time) for k in (1, 2)}
    record, noise = Record("arm", time, u, outputs), {"q_m1": 1.0, "q_m2": 1.0}
    plain = arm.without_component("joint1/motor", "residual_network")
    found, expected = (
        fit_physics(s, make_batch(s, [record], noise_std=noise), ENGINE, HybridOptions())
        for s in (arm, plain)
    )
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-9)


def test_nothing_missing_leaves_the_physics_alone() -> None:
    system = hybrid()
    options = replace(QUICK, max_iterations=5)
    result = train_hybrid(system, *batches(system, records(drive())), engine=ENGINE, options=options)
    assert result.chosen == 0
    assert all(deviation(model.validation) < 1.1 for model in result.models)


def test_intervals_hold_the_truth_where_residuals_are_correlated() -> None:
    """Noise of the first order: as white noise, of each of six seeds, it would be known too well."""
    names, inside, memory = ("F_c", "J"), {"loose": 0, "plain": 0}, 0.9
    clean = make_records(
        drive(), [multisine(k, samples=200, rest=10, amplitude=2.5, step=STEP) for k in range(4)],
        noise={"q_m1": 0.0}, engine=Engine("smooth", 4, width=2.0), step=STEP,
    )  # fmt: skip
    system = hybrid(inputs=("sin 3", "cos 3"), hidden=())
    options = replace(QUICK, price=0.1, max_iterations=3)
    for seed in range(6):
        rng, noisy = np.random.default_rng(seed), []
        for one in clean:
            white = NOISE["q_m1"] * (1.0 - memory**2) ** 0.5 * rng.standard_normal(one.n_samples + 100)
            drifting = lfilter([1.0], [1.0, -memory], white)[100:]
            noisy.append(replace(one, outputs={"q_m1": one.outputs["q_m1"] + drifting}))
        made = batches(system, noisy)
        model = train_hybrid(system, *made, engine=ENGINE, options=options, spread=correlated_errors).models[
            1
        ]
        estimated = [info.name for info in model.system.table if info.spec.estimate]
        for name in names:
            off = abs(model.system.parameter(name).spec.value - drive().parameter(name).spec.value)
            for which in inside:
                inside[which] += off < 1.96 * getattr(model, which)[estimated.index(name)]
    assert inside["loose"] >= 11 and inside["plain"] <= 8  # of twelve


def test_interrupt_keeps_physics_and_the_checkpoint(tmp_path: Path, made: list) -> None:
    class Pressed:
        def record(self, snapshot: Snapshot) -> None:
            assert set(snapshot.scalars) == {"residual/share_r_motor1", "residual/price"}
            assert snapshot.simulated.shape == snapshot.batch.y.shape
            if snapshot.step == 3:
                raise KeyboardInterrupt

    saved = tmp_path / "checkpoint.pt"
    result = train_hybrid(
        hybrid(), *batches(hybrid(), made), engine=ENGINE, options=QUICK, writer=Pressed(), checkpoint=saved
    )
    assert result.interrupted and len(result.models) == 1 and saved.exists()


def test_adam_comes_near(made: list) -> None:
    options = replace(
        QUICK, optimizer="adam", rate=0.02, max_iterations=12, validate_every=4, windows=((0.1, 2),)
    )
    alone, trained = train_hybrid(hybrid(), *batches(hybrid(), made), engine=ENGINE, options=options).models
    assert trained.train < 0.7 * alone.train


# --- what it is made of ----------------------------------------------------------------------------------------------


def awake(system: System, size: float = 0.2) -> System:
    """The system with random weights in the last layers of its networks."""
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for part in system.networks.values():
            last = f"layers.{len(part.hidden)}.weight"
            part.weights()[last].copy_(size * torch.randn(part.weights()[last].shape, generator=generator))
    return system


def problem_of(system: System, batch: Batch, price: float) -> Problem:
    free = [i for i, info in enumerate(system.table) if info.spec.estimate]
    sets = torch.zeros(batch.rows, dtype=torch.long)
    theta, extra = system.theta().detach()[:, None], extra_parameters(system)
    priced = with_price(system, batch, price)
    return Problem(system, ENGINE, priced, sets, free, make_bounds(system, free), theta, extra, Loss())


@pytest.mark.parametrize("memory", [0, 2])
def test_gradient_by_the_adjoint_with_price_and_memory(made: list, memory: int) -> None:
    system = awake(hybrid(memory=memory))
    batch = (
        batches(system, made)[0]
        .take(torch.tensor([0]))
        .windows(40, 400, torch.zeros(1, len(system.state_names)))[0]
    )
    problem = problem_of(with_scales(system, batch), batch, 50.0)
    q = problem.start(problem.base)
    slope = problem.value(q, batch.x)[1]
    generator = torch.Generator().manual_seed(5)
    for _ in range(3):
        way = torch.randn(q.shape, generator=generator, dtype=q.dtype)
        ahead, behind = (float(problem.value(q + side * 1e-5 * way, batch.x)[0]) for side in (1, -1))
        assert (ahead - behind) / 2e-5 == pytest.approx(float((slope * way).sum()), rel=2e-3)


@pytest.mark.parametrize("memory", [0, 2])
def test_metric_of_the_weights_is_that_of_a_sample(made: list, memory: int) -> None:
    system = awake(hybrid(memory=memory))
    batch = batches(system, made)[0].take(torch.tensor([0]))
    system = with_scales(system, batch)
    batch = with_price(system, with_memory(system, batch, system.theta().detach()[:, None]), 4.0)
    theta, engine = system.theta().detach()[:, None], replace(ENGINE, gradient="backprop", substeps=2)
    free = [0]
    lin = linearise_with_weights(system, engine, batch, batch.x, theta, free)
    extra = extra_parameters(system)
    assert lin.b.shape[-1] == lin.d.shape[-1] == 1 + sum(w.numel() for w in extra)
    vector = torch.nn.utils.parameters_to_vector(extra).detach()
    way = torch.randn(len(vector), generator=torch.Generator().manual_seed(6), dtype=vector.dtype)
    moved = []
    for side in (1, -1):
        torch.nn.utils.vector_to_parameters(vector + side * 1e-5 * way, extra)
        moved.append(linearise_with_weights(system, engine, batch, batch.x, theta, free))
    torch.testing.assert_close((moved[0].y - moved[1].y) / 2e-5, lin.d[..., 1:] @ way, rtol=1e-6, atol=1e-9)
    truth, told = ((moved[0].x_next - moved[1].x_next) / 2e-5)[:, :-1], (lin.b[..., 1:] @ way)[:, :-1]
    for row in range(truth.shape[-1]):
        torch.testing.assert_close(truth[..., row], told[..., row], rtol=1e-5, atol=1e-8)


def test_scales_come_from_the_data(made: list) -> None:
    system = hybrid(inputs=("angle", "speed", "direction", "sin 3"))
    batch = batches(system, made)[0]
    (name, place, part, _), *_ = networks_of(with_scales(system, batch, 0.7))
    assert (name, place) == ("r_motor1", "motor")
    speed = float(batch.x[..., 1].square().mean().sqrt())
    assert part.scale.tolist() == pytest.approx([float(batch.x[..., 0].std()), speed, 0.7, 1.0], rel=1e-9)
    assert part.shift.tolist() == pytest.approx([float(batch.x[..., 0].mean()), 0.0, 0.0, 0.0])
    assert 0.003 < float(part.output_scale) < 0.05


def test_a_price_is_a_measurement_of_zero(made: list) -> None:
    system = awake(hybrid())
    batch = batches(system, made)[0]
    system = with_scales(system, batch)
    priced = with_price(system, batch, 9.0)
    assert priced.outputs == ("q_m1", "r_motor1") and with_price(system, batch, 0.0) is batch
    run = simulate(system, replace(ENGINE, gradient="backprop"), priced)
    part = next(iter(system.networks.values()))
    share = (run.y[..., 1] / part.output_scale).square().mean()
    cost = Loss().value((priced.y - run.y)[..., 1] * priced.weight[..., 1]).mean()
    assert float(cost) == pytest.approx(0.5 * 9.0 * float(share))


def test_faults_are_told(made: list) -> None:
    data = batches(hybrid(), made)
    with pytest.raises(InputError, match="no residual network"):
        train_hybrid(drive(), *data)
    with pytest.raises(InputError, match="not negative"):
        train_hybrid(hybrid(), *data, options=HybridOptions(price=-1.0))


def test_losses_of_a_short_record_are_those_of_its_own_parts() -> None:
    system, wave = drive(), records(WITHHELD, count=1, samples=300)[0]
    short = Record(
        "short", wave.time[:150], {"u1": wave.inputs["u1"][:150]}, {"q_m1": wave.outputs["q_m1"][:150]}
    )
    both = make_batch(system, [wave, short], noise_std=NOISE, signal_share=0.0)
    alone = make_batch(system, [short], noise_std=NOISE, signal_share=0.0)
    problem, theta = problem_of(system, both, 0.0), system.theta().detach()[:, None]
    found = losses(problem, theta, both)
    torch.testing.assert_close(found[:, 1:], losses(problem, theta, alone), rtol=1e-6, atol=1e-9)
    assert (found > 0).all()


def test_a_parameter_at_its_bound_is_not_rounded_beyond_it(made: list) -> None:
    narrow = drive()
    narrow = narrow.with_specs({"F_v": replace(narrow.parameter("F_v").spec, value=0.1507, upper=0.95)})
    problem = problem_of(narrow, batches(narrow, made)[0], 0.0)
    row = narrow.estimated.index([i.name for i in narrow.table].index("F_v"))
    q = problem.start(problem.base)
    q[:, row] = 0.95 / problem.unit[row] * (1.0 + 1e-15)
    assert float(problem.theta(q).max(1).values[narrow.estimated[row]]) <= 0.95


def test_scales_beside_a_winding_that_lags_are_those_of_its_torque(made: list) -> None:
    plain, lagging = hybrid(), hybrid().with_component("joint1/motor", ElectricalLag())
    scales = []
    for system in (plain, lagging):
        batch = make_batch(system, made, noise_std=NOISE)
        scales.append(float(next(iter(with_scales(system, batch).networks.values())).output_scale))
    assert scales[0] < 0.2
    assert scales[1] == pytest.approx(scales[0], rel=1e-6)

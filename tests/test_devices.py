"""The same figures on every device.

Where there is no GPU, every job runs with tensors that name no device on the one that holds no numbers: whatever a job
would make there, and a GPU would then refuse, breaks it here, too. Where there is one, the jobs run on it and are
compared with the CPU's.
"""

import sys
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
import torch
from drives import flexible_drive, make_records, multisine, rigid_drive
from torch import Tensor

from hybrid_id.components import Backlash, Cogging, Delay, LuGre, ResidualNetwork
from hybrid_id.identification.adjoint import TrainOptions, train
from hybrid_id.identification.fit import fit
from hybrid_id.identification.hybrid import HybridOptions, train_hybrid
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import Loss
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, two_link

NOISE = {"q_m1": 0.02}
STEP = 0.004
MAKER = rigid_drive(ratio=20.0).with_component("joint1/motor", Cogging(T_c=0.0, T_s=2.5e-3, n=3.0))
VOLTAGES = [multisine(k, samples=300, rest=10, amplitude=2.5, step=STEP) for k in range(3)]
RECORDS = make_records(MAKER, VOLTAGES, noise=NOISE, engine=Engine("smooth", 4, width=2.0), step=STEP)


def batch_of(system: System) -> Batch:
    """Two records; one short one, the same for both joints, for systems whose steps take long without C code."""
    if len(system.state_names) == 2 or system.networks:
        records = [r.between(0.0, 0.4) if system.networks else r for r in RECORDS[:2]]
        return make_batch(system, records, noise_std=NOISE)
    short, joints = RECORDS[0].between(0.0, 0.12), range(1, len(system.joints) + 1)
    u, y = ({f"{stem}{k}": short.signal(f"{stem}1") for k in joints} for stem in ("u", "q_m"))
    return make_batch(system, [Record("short", short.time, u, y)], noise_std=dict.fromkeys(y, 0.02))


Job = Callable[[System, Batch], list[Tensor]]


def free_run(engine: Engine, system: System, batch: Batch) -> list[Tensor]:
    run = simulate(system, engine, batch)
    return [run.x, run.y]


def least_squares(engine: Engine, system: System, batch: Batch, **settings) -> list[Tensor]:
    found = fit(
        system, batch, engine=engine, options=Options(loss=Loss("huber"), max_iterations=6), **settings
    )
    return [
        torch.tensor([*r.values, r.cost, float(np.abs(r.jacobian[0]).sum())], device="cpu") for r in found
    ]


def adjoint(system: System, batch: Batch) -> list[Tensor]:
    options = TrainOptions(windows=((0.2, 3),), max_iterations=3)
    found = train(system, batch, pooled=True, engine=OdeEngine(fine=4, width=2.0), options=options)
    return [torch.tensor(r.values, device="cpu") for r in found]


def hybrid(system: System, batch: Batch, **settings) -> list[Tensor]:
    options = HybridOptions(price=1.0, windows=((0.1, 1),), max_iterations=1, validate_every=1, **settings)
    rows = [torch.tensor([k], device=batch.x.device) for k in (0, 1)]
    found = train_hybrid(system, *map(batch.take, rows), engine=OdeEngine(fine=4, width=2.0), options=options)
    return [part.detach() for model in found.models for part in model.system.parameters()]


DRY, SMOOTH = Engine("dry"), Engine("smooth", 2, 1.0)
RIGID = rigid_drive(ratio=20.0)
SYSTEMS = {
    "rigid": RIGID,
    "lugre": rigid_drive(LuGre(sigma_0=2.0, sigma_1=1e-3), ratio=20.0),
    "flexible": flexible_drive(),
    "play": rigid_drive(ratio=20.0).with_component("joint1/transmission", Backlash()),
    "delay": rigid_drive(ratio=20.0).with_component("joint1/input", Delay(T_d=0.01)),
    "two links": two_link((20.0, 20.0)),
}
NETWORK = ResidualNetwork(inputs=("speed", "sin 3", "cos 3"), hidden=(6,), memory=1)
HYBRID = RIGID.with_component("joint1/motor", NETWORK)
JOBS: dict[str, tuple[System, Job]] = {
    **{f"dry run, {name}": (system, partial(free_run, DRY)) for name, system in SYSTEMS.items()},
    "smooth run": (RIGID, partial(free_run, SMOOTH)),
    "fit": (RIGID, partial(least_squares, DRY, pooled=True)),
    "fit, two starts": (RIGID, partial(least_squares, DRY, starts=2)),
    "fit, smooth": (RIGID, partial(least_squares, SMOOTH)),
    **{f"fit, {n}": (SYSTEMS[n], partial(least_squares, DRY, pooled=True)) for n in ("delay", "two links")},
    "adjoint": (RIGID, adjoint),
    "hybrid": (HYBRID, hybrid),
    "hybrid by first-order steps": (HYBRID, partial(hybrid, optimizer="adam")),
}


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No C code, which serves the CPU alone."""
    for module in [m for name, m in sys.modules.items() if name.startswith("hybrid_id")]:
        for name in ("supports_compiled",):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, lambda *_: False)
    yield


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("name", JOBS)
def test_no_tensor_is_made_beside_the_device(name: str) -> None:
    system, job = JOBS[name]
    batch = batch_of(system)
    with torch.device("meta"):
        found = job(system, batch)
    assert all(part.device.type == "cpu" for part in found)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("name", JOBS)
def test_a_gpu_gives_the_figures_of_the_cpu(name: str) -> None:
    system, job = JOBS[name]
    batch = batch_of(system)
    expected = job(system, batch)
    found = job(system.to("cuda"), batch.to("cuda"))
    system.to("cpu")
    for one, other in zip(found, expected, strict=True):
        scale = float(other.abs().max())
        torch.testing.assert_close(one.cpu(), other.cpu(), rtol=1e-4, atol=1e-6 * scale)

"""Compiled sub-steps give what the eager engine gives."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import batch_of, flexible_drive, multisine, rigid_drive, stored

from hybrid_id.components import AsymmetricStribeck, Coulomb, Dahl, Delay, LoadDependent, Stribeck
from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import library
from hybrid_id.simulation.compiled import CompiledStep, serves
from hybrid_id.simulation.lifted import condensed, shoot
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine
from hybrid_id.simulation.tracing import record

SMOOTH = Engine("smooth", substeps=3, width=0.5)


SYSTEMS = {
    "rigid": rigid_drive(vertical=True),
    "asymmetric": rigid_drive(AsymmetricStribeck()).with_component(
        "joint1/motor_friction", LoadDependent(mu=0.2)
    ),
    "stribeck": rigid_drive(Stribeck()),
    "bristle": rigid_drive().with_component("joint1/motor_friction", Dahl(sigma=0.5)),
    "flexible": flexible_drive().with_component("joint1/link_friction", Coulomb(F_c=0.4)),
}


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("name", SYSTEMS)
def test_compiled_steps_equal_eager_ones(name: str) -> None:
    system, compiled = SYSTEMS[name], replace(SMOOTH, substeps=12, compiled=True)
    eager = replace(compiled, compiled=False)
    inputs = {"u1": np.stack([multisine(k, samples=75, rest=3) for k in range(2)])}
    batch = batch_of(system, inputs, rows=2, outputs=("q_m1", "tau1"))
    theta = stored(system, 2) * torch.tensor([1.0, 1.1])
    free = [0, 2, len(system.table) - 1]
    whole = rollout(system, eager, batch, theta)
    torch.testing.assert_close(rollout(system, compiled, batch, theta), whole, rtol=1e-9, atol=1e-12)
    x = shoot(system, eager, whole + 0.01, batch.u, batch.dt, theta, 4)
    found = shoot(system, compiled, whole + 0.01, batch.u, batch.dt, theta, 4)
    torch.testing.assert_close(found, x, rtol=1e-9, atol=1e-12)
    for some in (free, []):
        arguments = (x, batch.u, batch.dt, theta, some, batch.outputs)
        measured, chain = condensed(system, eager, *arguments)
        both, fast = condensed(system, compiled, *arguments)
        torch.testing.assert_close(both.y, measured.y, rtol=1e-10, atol=1e-13)
        scale = chain.abs().amax((0, 1)).clamp_min(1e-9)
        torch.testing.assert_close(fast / scale, chain / scale, rtol=1e-8, atol=1e-9)


def test_what_has_no_c_expression_is_named() -> None:
    with pytest.raises(InputError, match="'cumsum'"):
        record(lambda x: [x.cumsum(0)], ["x"], [1.0])
    with pytest.raises(InputError, match="adds up lanes"):
        record(lambda x: [x / x.sum()], ["x"], [1.0])
    own = torch.tensor([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="array of its own"):
        record(lambda x: [x * own], ["x"], [1.0])


def test_recording_follows_aliases_and_writes_in_place() -> None:
    def function(x: torch.Tensor) -> list[torch.Tensor]:
        y = x.clone()
        alias = y.detach()
        y += 1.0
        return [alias * 0.0 + y.square() * 1.0, torch.zeros_like(x) * x]

    def limited(x: torch.Tensor) -> list[torch.Tensor]:
        return [x.clamp(-1.0, 2.0), x.clamp(max=2.0), torch.where(x > 0, x, torch.nan)]

    statements, _ = record(limited, ["x"], [2.0])
    assert [line.split(" = ")[1] for line in statements] == [
        "x < (-1.0) ? (-1.0) : x > 2.0 ? 2.0 : x;", "x > 2.0 ? 2.0 : x;", "x > 0.0;", "t2 ? x : NAN;",
    ]  # fmt: skip
    statements, results = record(function, ["x"], [2.0])
    assert statements == ["const double t0 = x + 1.0;", "const double t1 = t0 * t0;"]
    assert results == ["t1", "0.0"]


def test_compilation_serves_smooth_friction() -> None:
    compiled, x = replace(SMOOTH, compiled=True), torch.zeros(1, 2, 2, dtype=torch.float64)
    assert serves(rigid_drive(), compiled, x)
    assert not serves(rigid_drive(), compiled, x.float())
    assert not serves(rigid_drive(), SMOOTH, x)
    assert not serves(rigid_drive(), Engine(compiled=True), x)
    assert not serves(rigid_drive().with_component("joint1/input", Delay()), compiled, x)


def test_missing_compiler_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr("hybrid_id.simulation.compiled.library", library.__wrapped__)
    with pytest.raises(InputError, match="C compiler"):
        CompiledStep(rigid_drive(), SMOOTH, ("u1",), [])

"""Compiled sub-steps give what the eager engine gives."""

import shutil
from dataclasses import replace

import pytest
import torch
from drives import batch_of, multisine, rigid_drive, stored

from hybrid_id.components import Dahl
from hybrid_id.errors import InputError
from hybrid_id.simulation.compiled import CompiledStep, serves
from hybrid_id.simulation.lifted import linearise
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine

SMOOTH = Engine("smooth", substeps=3, width=0.5)


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs a C++ compiler")
def test_compiled_jacobians_equal_eager_ones() -> None:
    system = rigid_drive()
    batch = batch_of(system, {"u1": multisine(1, samples=60, rest=3)})
    theta = stored(system)
    x = rollout(system, SMOOTH, batch, theta)
    arguments = (batch.u, batch.dt, theta, [0, 2], batch.outputs)
    eager = linearise(system, SMOOTH, x, *arguments)
    compiled = linearise(system, replace(SMOOTH, compiled=True), x, *arguments)
    for name in ("x_next", "a", "b", "y"):
        torch.testing.assert_close(getattr(compiled, name), getattr(eager, name), rtol=1e-10, atol=1e-13)


def test_compilation_serves_smooth_friction_without_memory() -> None:
    compiled = replace(SMOOTH, compiled=True)
    assert serves(rigid_drive(), compiled)
    assert not serves(rigid_drive(), SMOOTH)
    assert not serves(rigid_drive(), Engine(compiled=True))
    assert not serves(rigid_drive().with_component("joint1/motor_friction", Dahl()), compiled)


def test_missing_compiler_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(InputError, match=r"C\+\+ compiler"):
        CompiledStep(rigid_drive(), SMOOTH, ("u1",), [])

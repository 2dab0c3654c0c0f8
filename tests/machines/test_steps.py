"""Steps in C: what NumPy gives, for every law there is."""

import shutil

import numpy as np
import pytest

from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.physics import steps
from hybrid_id.machines.physics.bench import replay
from hybrid_id.machines.robots import SYSTEMS, draw_robot

EFFECTS = [k for kinds in (*CATALOGUE.values(), OUTSIDE) for k in kinds if set(k.systems) & set(SYSTEMS)]
LANES, SAMPLES, TIME = 17, 120, 0.002


def angles(kind: type[Effect], system: str) -> np.ndarray:
    """Angles of seventeen machines with an effect, each of another size."""
    rng = np.random.default_rng(3)
    robot = draw_robot(rng, system)
    effect = kind.draw(rng, robot, 0).scaled(np.linspace(0.4, 1.6, LANES))
    robot = effect.alter(robot)
    machine = robot.assemble(substeps=effect.substeps)
    effect.install(machine, robot)
    waves = np.sin(np.outer(TIME * np.arange(SAMPLES), rng.uniform(5, 20, LANES)))
    volts = np.repeat(0.5 * robot.supply * waves[:, None], robot.joints, axis=1)
    return replay(machine, volts, sample_time=TIME, start=np.full((robot.joints, LANES), 0.1))


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.__name__)
def test_c_gives_what_numpy_gives(kind: type[Effect], monkeypatch: pytest.MonkeyPatch) -> None:
    system = next(s for s in reversed(SYSTEMS) if s in kind.systems)
    compiled = angles(kind, system)
    monkeypatch.setattr(steps, "library", lambda: None)
    np.testing.assert_allclose(compiled, angles(kind, system), rtol=1e-9, atol=1e-9)
    assert np.ptp(compiled) > 0

"""Steps in C: what NumPy gives, for every law there is."""

import shutil

import numpy as np
import pytest

from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.physics import steps
from hybrid_id.machines.physics.bench import replay
from hybrid_id.machines.physics.steps import Notes, Steps, Term
from hybrid_id.machines.robots import SYSTEMS, draw_robot

EFFECTS = [k for kinds in (*CATALOGUE.values(), OUTSIDE) for k in kinds if set(k.systems) & set(SYSTEMS)]
COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
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


@COMPILED
@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.__name__)
def test_c_gives_what_numpy_gives(kind: type[Effect], monkeypatch: pytest.MonkeyPatch) -> None:
    system = next(s for s in reversed(SYSTEMS) if s in kind.systems)
    compiled = angles(kind, system)
    monkeypatch.setattr(steps, "library", lambda: None)
    np.testing.assert_allclose(compiled, angles(kind, system), rtol=1e-9, atol=1e-9)
    assert np.ptp(compiled) > 0


@pytest.mark.parametrize("compiled", [pytest.param(True, marks=COMPILED), False])
def test_states_inputs_and_trail(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not compiled:
        monkeypatch.setattr(steps, "library", lambda: None)
    kept = {"x": np.array([0.0, 1.0, 2.0]), "last": np.zeros(3)}

    def step(time, inputs):
        kept["x"], kept["last"] = kept["x"] + np.where(time > 0.5, inputs[0], 0.0), kept["x"]

    run = Steps(step, [(kept, "x"), (kept, "last")], 3, np.arange(4.0), inputs=1, substeps=2, kept=1)
    run.inputs[:, 0] = [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]]
    for k in (0, 1):
        run.play(k, 1)
    assert run.trail[:, 0].tolist() == [[0, 1, 2], [0, 1, 2], [1, 3, 5], [11, 23, 35], [21, 43, 65]]
    assert kept["last"].tolist() == [11, 23, 35]


def test_what_is_done_twice_is_noted_once_and_runs_may_not_part() -> None:
    notes = Notes()
    x = Term(notes, "state", 0)
    assert np.sin(2.0 * x) is np.sin(2.0 * x) and len(notes.lines) == 2
    with pytest.raises(TypeError, match=r"np\.where"):
        bool(x > 0)

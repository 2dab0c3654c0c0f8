"""Three physics agree where they should: the integrator, MuJoCo, and the models of the package."""

import numpy as np
import pytest

from hybrid_id.machines import experiments as plans
from hybrid_id.machines.case import Case
from hybrid_id.machines.effects import CATALOGUE, Effect
from hybrid_id.machines.experiments import SAMPLE_TIME, draw_campaign
from hybrid_id.machines.physics.bench import replay, run
from hybrid_id.machines.physics.mujoco import MujocoMachine, Unsupported, planar
from hybrid_id.machines.robots import SYSTEMS, draw_robot
from hybrid_id.machines.trials import Trials
from hybrid_id.records.yaml_file import validate
from hybrid_id.study.replay import replay as model_replay
from hybrid_id.systems.model_file import build_model
from hybrid_id.systems.model_schema import ModelFile

FORMULAS = [
    ("one_link", "Warming"),
    ("one_link", "PreslidingLuGre"),
    ("two_link", "Bias"),
    ("one_link", "FlatTeeth"),
    ("one_link_flexible", "LinkCoulomb"),
]
"""One of each way in which an effect meets the stepping: laws are the same in both."""


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 800))


def trials_of(system: str, seed: int, formula: str = "") -> Trials:
    rng = np.random.default_rng(seed)
    robot = draw_robot(rng, system)
    campaign, effects = draw_campaign(rng, robot), list[Effect]()
    if formula:
        kind = next(k for kinds in CATALOGUE.values() for k in kinds if k.__name__ == formula)
        effects = [kind.draw(np.random.default_rng(1), robot, robot.joints - 1)]
    return Trials(robot, effects, campaign)


def both(trials: Trials, *sizes: float) -> list[np.ndarray]:
    """Rotor angles of a machine in both engines, under the same voltages."""
    encoders = trials.campaign.encoders
    machine = trials.machine(np.zeros((len(trials.effects), 8)), {}, {}, least=4)
    volts, _ = run(machine, trials.campaign.program, encoders, sample_time=SAMPLE_TIME)
    machine = trials.machine(np.outer(sizes, np.ones(8)), {}, {}, least=4)
    plants = machine, MujocoMachine(*planar(machine))
    return [replay(plant, volts, sample_time=SAMPLE_TIME) for plant in plants]


@pytest.mark.parametrize("system", SYSTEMS)
def test_engines_agree_far_below_the_noise(system: str) -> None:
    pytest.importorskip("mujoco")
    trials = trials_of(system, 3)
    here, there = both(trials)
    noise = trials.noise[: trials.robot.joints]
    assert np.all((here - there).std(axis=0).mean(axis=-1) < 0.2 * noise)
    assert np.all(np.ptp(here, axis=0) > 10 * noise[:, None])


@pytest.mark.parametrize(("system", "formula"), FORMULAS)
def test_engines_agree_on_an_effect(system: str, formula: str) -> None:
    pytest.importorskip("mujoco")
    trials = trials_of(system, 5, formula)
    before, after = both(trials, 0.0), both(trials, 1.0)
    # what the effect changes, for a drawn effect may be small beside what the engines differ by without it
    here, there = (with_it - without for with_it, without in zip(after, before, strict=True))
    assert (here - there).std() < 0.15 * here.std()


def test_mujoco_says_what_it_cannot_do() -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(Unsupported, match="gear errors"):
        both(trials_of("one_link", 3, "GearError"), 1.0)


@pytest.mark.parametrize("system", SYSTEMS)
def test_true_model_of_the_package_replays_a_case_to_its_noise_floor(system: str) -> None:
    trials = trials_of(system, 8)
    made = trials.record([()], np.ones((trials.robot.joints, 8)))
    case = Case("x", trials.bare, trials.campaign, trials.bare.model(np.random.default_rng(0), 0.0))
    model, data = build_model(validate(ModelFile, case.model, "model")), case.dataset(made[0])
    tests = data.select([r.name for r in data.test])
    error = np.mean([e for done in model_replay(tests, model) for e in done.nrmse.values()])
    assert error == pytest.approx(trials.floors([()], made)[0].test, rel=0.05)

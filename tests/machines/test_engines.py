"""Three physics agree where they should: the integrator, MuJoCo, and the models of the package."""

import numpy as np
import pytest

from hybrid_id.machines import experiments as plans
from hybrid_id.machines.case import Case, build, record
from hybrid_id.machines.effects import CATALOGUE
from hybrid_id.machines.experiments import SAMPLE_TIME, draw_campaign, noise_std
from hybrid_id.machines.physics.bench import replay, run
from hybrid_id.machines.physics.mujoco import Unsupported
from hybrid_id.machines.robots import SYSTEMS, draw_robot
from hybrid_id.records.yaml_file import validate
from hybrid_id.study.replays import replay as model_replay
from hybrid_id.systems.model_file import build_model
from hybrid_id.systems.model_schema import ModelFile

IN_BOTH = [
    ("one_link", "InputDelay"),
    ("one_link", "CoggingTorque"),
    ("one_link", "WindingLag"),
    ("one_link", "Warming"),
    ("one_link", "MotorDrag"),
    ("one_link", "Unbalance"),
    ("one_link", "Hose"),
    ("two_link", "Bias"),
    ("one_link", "SoftGear"),
    ("one_link", "Threshold"),
    ("one_link_flexible", "LinkCoulomb"),
    ("one_link_flexible", "CubicSpring"),
]


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 800))


def case_of(system: str, seed: int = 3, error: float = 0.0) -> Case:
    rng = np.random.default_rng(seed)
    robot = draw_robot(rng, system)
    return Case("x", robot, (), draw_campaign(rng, robot), robot.model(rng, error))


@pytest.mark.parametrize("system", SYSTEMS)
def test_engines_agree_far_below_the_noise(system: str) -> None:
    pytest.importorskip("mujoco")
    case = case_of(system)
    encoders = case.campaign.encoders
    volts, measured = run(case.plant(), case.campaign.program, encoders, sample_time=SAMPLE_TIME)
    angles = [
        replay(build(case.robot, (), engine), volts, sample_time=SAMPLE_TIME)
        for engine in ("in_house", "mujoco")
    ]
    error = (angles[0] - angles[1]).std(axis=0)[: case.robot.joints].mean(axis=-1)
    assert np.all(error < 0.2 * noise_std(encoders)[: case.robot.joints])
    assert np.all(np.ptp(measured, axis=0) > 10 * noise_std(encoders)[:, None])


@pytest.mark.parametrize(("system", "formula"), IN_BOTH)
def test_engines_agree_on_an_effect(system: str, formula: str) -> None:
    pytest.importorskip("mujoco")
    case = case_of(system, seed=5)
    kind = next(k for kinds in CATALOGUE.values() for k in kinds if k.__name__ == formula)
    effect = kind.draw(np.random.default_rng(1), case.robot, case.robot.joints - 1)
    volts, _ = run(case.plant(), case.campaign.program, case.campaign.encoders, sample_time=SAMPLE_TIME)
    before, after = (
        [
            replay(build(case.robot, effects, engine), volts, sample_time=SAMPLE_TIME)
            for engine in ("in_house", "mujoco")
        ]
        for effects in ((), (effect,))
    )
    # what the effect changes, for a drawn effect may be small beside what the engines differ by without it
    here, there = (with_it - without for with_it, without in zip(after, before, strict=True))
    assert (here - there).std() < 0.15 * here.std()


def test_mujoco_says_what_it_cannot_do() -> None:
    pytest.importorskip("mujoco")
    case = case_of("one_link")
    effect = CATALOGUE["kinematic_error"][0].draw(np.random.default_rng(1), case.robot, 0)
    with pytest.raises(Unsupported, match="gear errors"):
        build(case.robot, (effect,), "mujoco")


@pytest.mark.parametrize("system", SYSTEMS)
def test_true_model_of_the_package_replays_a_case_to_its_noise_floor(system: str) -> None:
    case = case_of(system, seed=8)
    records = record(case)
    model = build_model(validate(ModelFile, case.model, "model"))
    tests = records.dataset.select([r.name for r in records.dataset.test])
    error = np.mean([e for done in model_replay(tests, model) for e in done.nrmse.values()])
    assert error == pytest.approx(records.noise_floor, rel=0.05)

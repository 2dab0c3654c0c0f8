"""Two physics agree where they should: the integrator, and the models of the package."""

import numpy as np
import pytest

from hybrid_id.machines import experiments as plans
from hybrid_id.machines.case import Case
from hybrid_id.machines.experiments import draw_campaign
from hybrid_id.machines.robots import SYSTEMS, draw_robot
from hybrid_id.machines.trials import Trials
from hybrid_id.records.yaml_file import validate
from hybrid_id.study.replay import replay as model_replay
from hybrid_id.systems.model_file import build_model
from hybrid_id.systems.model_schema import ModelFile


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 800))


@pytest.mark.parametrize("system", SYSTEMS)
def test_true_model_of_the_package_replays_a_case_to_its_noise_floor(system: str) -> None:
    rng = np.random.default_rng(8)
    robot = draw_robot(rng, system)
    trials = Trials(robot, [], draw_campaign(rng, robot))
    made = trials.record([()], np.ones((trials.robot.joints, 8)))
    case = Case("x", trials.bare, trials.campaign, trials.bare.model(np.random.default_rng(0), 0.0))
    model, data = build_model(validate(ModelFile, case.model, "model")), case.dataset(made[0])
    tests = data.select([r.name for r in data.test])
    error = np.mean([e for done in model_replay(tests, model) for e in done.nrmse.values()])
    assert error == pytest.approx(trials.floors([()], made)[0].test, rel=0.05)

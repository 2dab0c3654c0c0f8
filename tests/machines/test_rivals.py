"""What a case asks of its effects, and that a draw that goes wrong loses no other."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hybrid_id.machines import experiments
from hybrid_id.machines import make as module
from hybrid_id.machines.case import Case, build, record, runs_in_mujoco
from hybrid_id.machines.draw import SEEN
from hybrid_id.machines.effects import OUTSIDE, Effect
from hybrid_id.machines.effects.friction import UnevenBoth
from hybrid_id.machines.effects.load import Bias
from hybrid_id.machines.effects.motor import WeakSupply
from hybrid_id.machines.effects.outside import Wind
from hybrid_id.machines.effects.transmission import SoftGear
from hybrid_id.machines.grading import Errors, Graded, refit_model
from hybrid_id.machines.ground_truth import ground_truth
from hybrid_id.machines.make import NEEDED, make_cases
from hybrid_id.machines.rivals import Rival, fit_all, with_only
from hybrid_id.machines.robots import draw_robot

RNG = np.random.default_rng(0)
ROBOT = draw_robot(RNG, "one_link")


def test_friction_of_any_size_takes_energy() -> None:
    machine = build(ROBOT, [UnevenBoth.draw(RNG, ROBOT, 0).scaled(8.0)])
    uneven = machine.drives[0].rotor_laws[-1]
    assert abs(uneven.slope) < 2.0 * ROBOT.value(0, "F_v")


def test_wind_of_any_size_lets_the_joint_rest() -> None:
    law = build(ROBOT, [Wind.draw(RNG, ROBOT, 0).scaled(8.0)]).drives[0].link_laws[-1]
    assert law.c * law.wind**2 <= 0.9 * ROBOT.value(0, "F_c") * ROBOT.ratio[0] * (1 + 1e-9)


def test_mujoco_knows_no_supply_that_sags() -> None:
    pytest.importorskip("mujoco")
    assert runs_in_mujoco(ROBOT, [])
    assert not runs_in_mujoco(ROBOT, [WeakSupply.draw(RNG, ROBOT, 0)])


def test_nominal_arms_have_a_mass_matrix() -> None:
    for seed in range(300):
        rng = np.random.default_rng(seed)
        arm = draw_robot(rng, "two_link").model(rng, 0.3)["parameters"]
        P_1, P_2, P_3, P_4 = (arm[f"P_{k}"]["nominal"] for k in (1, 2, 3, 4))
        assert P_4 < P_2
        for cosine in (-1.0, 0.0, 1.0):
            assert (P_1 + 2 * cosine * P_3) * P_2 > (P_4 + cosine * P_3) ** 2


def pair_of(*sizes: float) -> Case:
    """A drive with a constant torque and a gear that gives way, each of some size."""
    rng = np.random.default_rng(5)
    robot = draw_robot(rng, "one_link")
    effects = [
        kind.draw(rng, robot, 0).scaled(size) for kind, size in zip((Bias, SoftGear), sizes, strict=True)
    ]
    return Case("c", robot, tuple(effects), experiments.draw_campaign(rng, robot), robot.model(rng, 0.3))


def test_a_pair_is_one_only_where_each_effect_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiments, "LENGTHS", (300, 400))
    case = pair_of(1.0, 1.0)
    both = with_only(case, record(case))
    assert both is not None and all(one.test > NEEDED and one.train > SEEN for one in both.values())
    case = pair_of(1.0, 0.03)
    slight = with_only(case, record(case))
    assert slight is not None and slight["constant_torque"].test < 1.05
    # records that not even both explain say nothing of either
    broken = replace(record(case), noise_floor=1e-9)
    assert with_only(case, broken) is None


def test_level_outside_the_catalogue_is_what_the_best_named_effect_leaves() -> None:
    case = replace(pair_of(1.0, 1.0), effects=(Wind.draw(RNG, ROBOT, 0),))
    records = SimpleNamespace(noise_floor=0.01)
    graded = Graded(case, records, Errors(1.0, 0.05, 4.0))
    rivals = [[Rival(case.effects[0], 0.2, False, 1.6), Rival(case.effects[0], 0.9, False)]]
    levels = [
        ground_truth(graded, family, (1, 0), rivals=rivals, alone=None)["level"]
        for family in ("single", "unknown")
    ]
    assert levels == ["strong", "medium"]


@pytest.mark.parametrize("kind", OUTSIDE)
def test_every_effect_without_a_name_can_be_fitted_as_its_rivals_are(
    kind: type[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments, "LENGTHS", (300, 400))
    rng = np.random.default_rng(3)
    system = next(name for name in ("one_link", "one_link_flexible") if name in kind.systems)
    robot = draw_robot(rng, system)
    effects = [kind.draw(rng, robot, 0)]
    case = Case("c", robot, tuple(effects), experiments.draw_campaign(rng, robot), {}, "in_house")
    records = record(case)
    start = refit_model(case, records, rounds=1)
    fit, _ = fit_all(case, records, [((case.effects[0],), start), ((case.effects[0].scaled(1.5),), start)])[0]
    assert np.isfinite(fit.train)


def test_a_fault_in_one_case_is_told_and_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments, "LENGTHS", (700, 900))
    honest = module.draw_case

    def broken_once(rng, name, *rest):
        if name == "c001":
            raise ZeroDivisionError("float division by zero")
        return honest(rng, name, *rest)

    monkeypatch.setattr(module, "draw_case", broken_once)
    with pytest.warns(UserWarning, match="case c001 of seed 7 is left out: ZeroDivisionError"):
        made = make_cases(2, 7, tmp_path, family="none", system="one_link", engine="in_house")
    assert [path.name for path in made] == ["c002"]

"""What joints claim, held against values of each record's own, all joints simulated."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gapcase import only
from servo_arm import described, records_of

from hybrid_id import Dataset
from hybrid_id.components import REGISTRY
from hybrid_id.components.load.base_tilt import BaseTilt
from hybrid_id.diagnosis import whole_robot
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import answered
from hybrid_id.diagnosis.fits import FULL, Task
from hybrid_id.diagnosis.grade import RatedEffect
from hybrid_id.diagnosis.own_values import _smallest_first, borne_out, helps, own_values
from hybrid_id.diagnosis.whole_robot import WholeRobot
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.identification.result import FitResult
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.chain import System

pytest.importorskip("mujoco")
FRICTIONS = (0.03, 0.06, 0.045, 0.03)
SPRINGY = "spring_load", "joint3/load"
SPRING = REGISTRY["spring_load"](k_s=0.8, q_s=0.4)


@pytest.fixture
def nominal(tmp_path: Path) -> System:
    return described(tmp_path)


def days_of(machines: Sequence[System]) -> Dataset:
    """Records of one arm whose values are others in each."""
    days = [records_of(one) for one in machines]
    return replace(days[0], records=tuple(day.records[k] for k, day in enumerate(days)))


def test_values_of_each_records_own_explain_records_that_differ_and_no_missing_spring(
    nominal: System,
) -> None:
    drift = days_of([nominal.with_values({"F_c_elbow": friction}) for friction in FRICTIONS])
    spring = records_of(nominal.with_component("joint3/load", SPRING))
    found = [own_values(one, nominal, (), WHOLE) for one in (drift, spring)]
    assert [one.explain("joint3") for one in found if one is not None] == [True, False]


def test_a_robot_that_runs_away_decides_nothing(nominal: System, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*given: Any, **settings: Any) -> list[FitResult]:
        (one,) = kept_fit(*given, **settings)
        return [replace(one, residual=(*one.residual[:-1], np.full_like(one.residual[-1], np.nan)))]

    monkeypatch.setattr(whole_robot, "kept_fit", lost)
    assert own_values(records_of(nominal), nominal, (), WHOLE) is None


def test_a_tilt_that_two_joints_claim_is_not_refuted_by_the_other_claim(nominal: System) -> None:
    tilt = BaseTilt(e_x=0.15, e_y=-0.1)
    dataset = records_of(nominal.with_component("joint2/load", tilt))
    answers = {}
    with only("base_tilt"):
        for name, number in (("lift", 1), ("elbow", 2)):
            own = alone(nominal, number)
            answers[name] = answered(with_others_measured(dataset, nominal, number), own, max_effects=1)
        assert all(one.found.chosen.effects for one in answers.values())
        kept = borne_out(WholeRobot(dataset, nominal, answers, WHOLE))
    assert kept["lift"].found.chosen.effects


def test_the_smallest_claim_of_all_joints_is_asked_first() -> None:
    def answer(gap: float, **shares: float | None) -> Any:
        effects = [
            SimpleNamespace(name=name, where="joint1/load", share=share) for name, share in shares.items()
        ]
        return SimpleNamespace(grade=SimpleNamespace(gap=gap, effects=effects))

    answers = {"lift": answer(100.0, spring=0.9, bias=0.1), "elbow": answer(1.0, spring=0.6, bias=None)}
    claimed = {name: [("spring", "joint1/load"), ("bias", "joint1/load")] for name in answers}
    asked = [(joint, effect) for joint, (effect, _) in _smallest_first(answers, claimed)]
    assert asked == [("elbow", "bias"), ("elbow", "spring"), ("lift", "bias"), ("lift", "spring")]


def test_white_noise_is_explained_however_little_structure_one_set_leaves(nominal: System) -> None:
    found = own_values(records_of(nominal), nominal, (), WHOLE)
    assert found is not None and found.left("joint3") == 0.0 and found.explain("joint3")


def test_an_effect_has_to_help_beside_values_of_each_records_own(nominal: System) -> None:
    """What explains the drift of friction does not; a spring does, in records that drift, too."""
    sprung = nominal.with_component("joint3/load", SPRING)
    days = [
        days_of([one.with_values({"F_c_elbow": friction}) for friction in FRICTIONS])
        for one in (nominal, sprung)
    ]
    name, helpful = ("spring_load", "joint3/load"), []
    for dataset in days:
        start = nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.1, q_s=0.4))
        both = own_values(dataset, start, [name], WHOLE), own_values(dataset, nominal, (), WHOLE)
        assert both[0] is not None and both[1] is not None
        helpful.append(helps(*both, "joint3"))
        common = both[0].common
        assert all(one.names == common.names for one in both[0].sets)  # one program for all of them
        assert {one.system.parameter("k_s").spec.value for one in both[0].sets} == {
            common.system.parameter("k_s").spec.value
        }
    assert helpful == [False, True]


def test_what_only_looks_missing_is_refuted_by_the_whole_robot(nominal: System) -> None:
    """A joint by itself that has named an effect where records differ keeps neither its name nor its probability."""
    dataset = days_of([nominal.with_values({"F_c_elbow": friction}) for friction in FRICTIONS])
    one = alone(nominal, 2)
    with only("spring_load", "constant_torque"):
        answer = answered(with_others_measured(dataset, nominal, 2), one)
        with_spring = answer.fits.run([Task((SPRINGY,), one.with_component("joint3/load", SPRING))], FULL)[0]
        assert with_spring is not None
        claimed = RatedEffect(*SPRINGY, 0.97, True, (), {})
        wrong = replace(
            answer,
            searched=replace(answer.searched, chosen=with_spring, own=None),
            found=replace(answer.found, chosen=with_spring, own=None),
            grade=replace(answer.grade, effects=(claimed,)),
        )
        kept = borne_out(WholeRobot(dataset, nominal, {"elbow": wrong}, WHOLE))["elbow"]
    assert not kept.found.chosen.effects and kept.verdict == "parameters_only"
    assert list(kept.rejected) == ["spring_load at joint3/load"] and "F_c_elbow" in " ".join(kept.varying)
    assert all(each.probability <= CRITERIA.false_alarms for each in kept.grade.effects)

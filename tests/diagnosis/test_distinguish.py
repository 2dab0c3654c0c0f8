"""What a joint's own records cannot distinguish, all joints simulated can."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gapcase import only
from servo_arm import described, of_joint, records_of

from hybrid_id import Dataset
from hybrid_id.components import REGISTRY, Component
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.distinguish import _compared, _held_alike, _large_models, _tie, distinguished
from hybrid_id.diagnosis.grade import tied_models, tied_sets, tied_steps
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.screen import SelectionStep, Shown
from hybrid_id.diagnosis.validation import Validation
from hybrid_id.diagnosis.whole_robot import WholeRobot
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.systems.chain import System

pytest.importorskip("mujoco")
ZERO, TORQUE = ("encoder_zero", "joint2/sensor"), ("constant_torque", "joint2/load")
LAWS: Mapping[tuple[str, str], Component] = {
    ZERO: REGISTRY["motor_log"](offset=0.03),
    TORQUE: REGISTRY["constant_torque"](T_0=0.24),
}


@pytest.fixture
def nominal(tmp_path: Path) -> System:
    return described(tmp_path)


@pytest.fixture(autouse=True)
def both() -> Iterator[None]:
    with only("encoder_zero", "constant_torque"):
        yield


@pytest.fixture(scope="module")
def biased(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, dict[str, Answer]]:
    """Records of an arm with a torque at one joint, and what that and its neighbour say by themselves."""
    nominal = described(tmp_path_factory.mktemp("biased"))
    dataset = records_of(nominal.with_component(TORQUE[1], LAWS[TORQUE]))
    with only("encoder_zero", "constant_torque"):
        return dataset, {
            name: of_joint(dataset, nominal, joint) for name, joint in (("lift", 1), ("elbow", 2))
        }


def wrong_first(answer: Answer) -> Answer:
    """The answer as a few records less could have made it: its only rival before it."""
    ((step, (best, rival)),) = tied_steps(answer.found, answer.searched.steps)
    turned, (leading,) = replace(step, candidates=(rival, best)), rival.effects
    effects = tuple(replace(c, share=1.0 * ((c.name, c.where) == leading)) for c in answer.grade.effects)
    return replace(
        answer,
        grade=replace(answer.grade, effects=effects),
        searched=replace(answer.searched, steps=(turned,), chosen=rival),
        found=replace(answer.found, steps=(turned,), chosen=rival),
    )


@pytest.mark.parametrize("right", [ZERO, TORQUE])
def test_a_wrong_zero_and_a_torque_at_the_load_are_two_things_to_the_neighbours(
    nominal: System, right: tuple[str, str]
) -> None:
    dataset = records_of(nominal.with_component(right[1], LAWS[right]))
    lift, elbow = (of_joint(dataset, nominal, joint) for joint in (1, 2))
    assert {model.effects for group in tied_models(lift.found) for model in group} == {(ZERO,), (TORQUE,)}
    found = distinguished(WholeRobot(dataset, nominal, {"lift": wrong_first(lift), "elbow": elbow}, WHOLE))
    (one,) = (effect for effect in found["lift"].grade.effects if effect.selected)
    assert (one.name, one.where) == right and found["lift"].found.chosen.effects == (right,)
    assert one.probability > 0.95 and not tied_sets(found["lift"].grade.effects)
    assert all(other.probability < 0.05 for other in found["lift"].grade.effects if other is not one)
    assert not tied_models(found["lift"].found)
    assert found["elbow"] is elbow


def test_a_joint_without_neighbours_keeps_its_ties(
    nominal: System, biased: tuple[Dataset, dict[str, Answer]]
) -> None:
    dataset, answers = biased
    lift = {"lift": answers["lift"]}
    assert distinguished(WholeRobot(dataset, nominal, lift, WHOLE)) == lift


def test_what_is_a_small_part_of_the_robots_gap_is_not_asked(
    nominal: System, biased: tuple[Dataset, dict[str, Answer]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit of all joints costs as much as the search of one."""
    dataset, answers = biased
    parts = {"lift": 0.05, "elbow": 0.95}
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.parts_of_gap", lambda *_: (parts, {}))
    assert distinguished(WholeRobot(dataset, nominal, answers, WHOLE)) == answers


def claims(where: str, *effects: tuple[str, float]) -> Any:
    """A joint's answer with these effects, selected, and their shares of the joint's gap."""
    each = [SimpleNamespace(name=name, where=where, share=share, selected=True) for name, share in effects]
    return SimpleNamespace(
        found=SimpleNamespace(chosen=SimpleNamespace(system=SimpleNamespace(components={}), said=where)),
        searched=SimpleNamespace(base=SimpleNamespace(said="base")), grade=SimpleNamespace(effects=each),
    )  # fmt: skip


def test_neighbours_little_claims_take_no_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """They may be the image of one of the explanations, as a tilted base is; what acts on all joints is one claim."""
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.held", lambda model, _: model)
    one_for_all = lambda name, _: name[0] if name[0] == "floor_contact" else name  # noqa: E731
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.what", one_for_all)
    answers = {
        "large": claims("joint1/load", ("spring_load", 0.5)),
        "little": claims("joint2/load", ("spring_load", 0.4)),
        "worse": claims("joint3/load", ("spring_load", -1.0)),
        "floor": claims("joint4/load", ("floor_contact", 0.5)),
        "same": claims("joint5/load", ("floor_contact", 0.5)),
    }
    parts = {"large": 0.5, "little": 0.1, "worse": 0.15, "floor": 0.12, "same": 0.13}
    models: Any = _large_models(answers, parts)
    found = {name: one.said for name, one in models.items()}
    assert found == {
        "large": "joint1/load", "little": "base", "worse": "base", "floor": "joint4/load", "same": "joint5/load",
    }  # fmt: skip


def test_of_several_ties_the_one_about_most_of_the_gap_is_asked(
    biased: tuple[Dataset, dict[str, Answer]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, answers = biased
    ((step, equals),) = tied_steps(answers["lift"].found, answers["lift"].searched.steps)
    others = [replace(one, effects=(("backlash", "joint2/transmission"),)) for one in equals]
    small = replace(step, candidates=tuple(others)), others  # nothing is known of their share
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.tied_steps", lambda *_: [small, (step, equals)])
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.accepted_ones", lambda step: step.candidates)
    tie = _tie(answers["lift"])
    assert tie is not None and tie[0] is step


def test_what_all_joints_have_shown_is_not_asked_again(biased: tuple[Dataset, dict[str, Answer]]) -> None:
    answer = biased[1]["lift"]
    ((step, _),) = tied_steps(answer.found, answer.searched.steps)
    told = replace(answer.found, steps=(*answer.found.steps, replace(step, shown=Shown(0.9, {}))))
    assert _tie(answer) is not None and _tie(replace(answer, found=told, searched=told)) is None


def test_where_no_robot_can_be_fitted_the_joint_keeps_its_ties(
    nominal: System, biased: tuple[Dataset, dict[str, Answer]], monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset, answers = biased

    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("diverged")

    monkeypatch.setattr("hybrid_id.diagnosis.whole_robot.kept_fit", fails)
    assert distinguished(WholeRobot(dataset, nominal, answers, WHOLE)) == answers


def test_a_rival_whose_records_do_not_accept_it_is_none(
    nominal: System, biased: tuple[Dataset, dict[str, Answer]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It could not stand alone, and the joint would be left with nothing."""
    dataset, answers = biased
    monkeypatch.setattr("hybrid_id.diagnosis.distinguish.accepted_ones", lambda step: [step.leader])
    assert distinguished(WholeRobot(dataset, nominal, answers, WHOLE)) == answers


def test_fewer_parameters_are_no_merit_of_a_robot_that_errs_clearly_more() -> None:
    def robot(error: float, parameters: int) -> Any:
        blocks = error * (1.0 + 0.5 * np.random.default_rng(parameters).uniform(size=40))
        found = Validation(blocks, np.ones(40), np.arange(40) // 10, 3000.0, np.arange(40) // 10)
        names = tuple(map(str, range(parameters)))
        return FittedModel((), SimpleNamespace(names=names, residual=[np.ones((9, 1))]), found, judged=False)  # type: ignore[arg-type]

    step: Any = SelectionStep(robot(9.0, 3), ("rich", "poor"))  # type: ignore[arg-type]
    best = _compared(step, ["rich", "poor"], [robot(1.0, 5), robot(8.0, 3)])  # type: ignore[list-item]
    alike = _compared(step, ["rich", "poor"], [robot(1.0, 5), robot(1.02, 3)])  # type: ignore[list-item]
    assert best is not None and best.candidates[0] == "rich"
    assert alike is not None and alike.candidates[0] == "poor"
    assert best.odds[0] == alike.odds[0] == 0.0 and best.odds[1] < 0.0 and alike.odds[1] < 0.0


def test_explanations_are_compared_held_alike(nominal: System) -> None:
    """A free drive takes what a wrong explanation leaves, and would win over a held one that is right."""
    (name,) = (i.name for i in nominal.table if i.symbol == "k_p" and i.component.startswith("joint2"))
    spec = nominal.parameter(name).spec
    tied = nominal.with_specs({name: replace(spec, prior_mean=spec.value, prior_std=0.01 * spec.value)})

    @dataclass
    class Fit:
        system: System

    def of(system: System) -> Any:
        unseen: Any = None
        fit: Any = Fit(system)
        return FittedModel((), fit, unseen)

    both = _held_alike([of(tied), of(nominal)], nominal)
    assert all(one.system.parameter(name).spec.prior_std is None for one in both)
    alike = _held_alike([of(tied), of(tied)], nominal)
    assert all(one.system.parameter(name).spec.prior_std for one in alike)

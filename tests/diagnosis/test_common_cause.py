"""What acts on all joints of a robot is judged by all of them, where each by itself leaves it open."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from gapcase import only
from servo_arm import described, of_joint, records_of

from hybrid_id import Dataset
from hybrid_id.components import REGISTRY
from hybrid_id.components.load.base_tilt import BaseTilt
from hybrid_id.diagnosis.common_cause import judged_by_all
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.model import added_effect
from hybrid_id.diagnosis.whole_robot import WholeRobot, brought_to
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.systems.by_joint import alone
from hybrid_id.systems.chain import System

pytest.importorskip("mujoco")
NAMES = "base_tilt", "constant_torque"
JOINTS = {"lift": 1, "elbow": 2}
OPEN = 0.4
Case = tuple[Dataset, System, dict[str, Answer]]


def answers_of(dataset: Dataset, nominal: System) -> dict[str, Answer]:
    """What the joints say by themselves, as a few records less could have left it: all is as likely, none asserted."""
    found = {}
    for name, k in JOINTS.items():
        one = of_joint(dataset, nominal, k)
        effects = tuple(replace(c, selected=False, probability=OPEN) for c in one.grade.effects)
        found[name] = replace(
            one,
            grade=replace(one.grade, effects=effects),
            found=replace(one.found, chosen=one.found.base),
            searched=replace(one.searched, chosen=one.searched.base),
        )
    return found


@pytest.fixture(autouse=True)
def both() -> Iterator[None]:
    with only(*NAMES):
        yield


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> Case:
    nominal = described(tmp_path_factory.mktemp("tilted"))
    dataset = records_of(nominal.with_component("joint2/load", BaseTilt(e_x=0.03, e_y=0.1)))
    with only(*NAMES):
        return dataset, nominal, answers_of(dataset, nominal)


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two joints with a torque each, of unlike sign: no tilt is both."""
    nominal = described(tmp_path_factory.mktemp("pulled"))
    system = nominal
    for place, size in (("joint2/load", 0.1), ("joint3/load", -0.05)):
        system = system.with_component(place, REGISTRY["constant_torque"](T_0=size))
    dataset = records_of(system)
    with only(*NAMES):
        return dataset, nominal, answers_of(dataset, nominal)


def test_a_tilt_that_no_joint_asserts_is_asserted_by_all(tilted: Case) -> None:
    dataset, nominal, answers = tilted
    found = judged_by_all(WholeRobot(dataset, nominal, answers, WHOLE))
    for name, k in JOINTS.items():
        (one,) = (c for c in found[name].grade.effects if c.selected)
        assert (one.name, one.where) == ("base_tilt", f"joint{k + 1}/load") and one.probability > 0.95
        # of one size, which is that of all joints: the lift by itself knows it to 0.005 rad
        assert one.parameters["e_y"][0] == pytest.approx(0.1, abs=0.001)
        assert found[name].found.chosen.effects == ((one.name, one.where),)
        table = found[name].found.chosen.system.table
        assert all(info.spec.prior_std is None for info in table)  # and the answer is held by nothing


def test_validation_records_judge_it_too(tilted: Case) -> None:
    """A joint's answer is of all records, and candidates are judged by these alone."""
    dataset, nominal, _ = tilted
    records = [replace(r, role="validation") if k == 0 else r for k, r in enumerate(dataset.records)]
    dataset = replace(dataset, records=tuple(records))
    found = judged_by_all(WholeRobot(dataset, nominal, answers_of(dataset, nominal), WHOLE))
    assert all([c.name for c in found[name].grade.effects if c.selected] == ["base_tilt"] for name in JOINTS)


def test_an_image_of_it_that_a_joint_asserts_gives_way(tilted: Case) -> None:
    dataset, nominal, answers = tilted
    lift = answers["lift"]
    image = next(e for e in lift.found.steps[0].candidates if e.effects[0][0] == "constant_torque")
    asserted = replace(lift, found=replace(lift.found, chosen=image))
    found = judged_by_all(WholeRobot(dataset, nominal, answers | {"lift": asserted}, WHOLE))
    assert [name for name, _ in found["lift"].found.chosen.effects] == ["base_tilt"]


def test_torques_of_their_own_are_no_tilt(pulled: Case) -> None:
    dataset, nominal, answers = pulled
    assert judged_by_all(WholeRobot(dataset, nominal, answers, WHOLE)) == answers


def test_what_one_joint_alone_finds_likely_is_its_own(tilted: Case) -> None:
    dataset, nominal, answers = tilted
    elbow = answers["elbow"]
    step = elbow.found.steps[0]
    unlikely = tuple(-20.0 * (added_effect(one, step.before)[0] == "base_tilt") for one in step.candidates)
    turned = replace(elbow.found, steps=(replace(step, odds=unlikely),))
    answers = answers | {"elbow": replace(elbow, found=turned)}
    assert judged_by_all(WholeRobot(dataset, nominal, answers, WHOLE)) == answers


def test_what_all_assert_is_not_asked_again(tilted: Case) -> None:
    dataset, nominal, answers = tilted
    sure = {
        name: replace(
            one,
            grade=replace(
                one.grade,
                effects=tuple(replace(c, selected=c.name == "base_tilt") for c in one.grade.effects),
            ),
        )
        for name, one in answers.items()
    }
    assert judged_by_all(WholeRobot(dataset, nominal, sure, WHOLE)) == sure


def test_the_joint_that_does_not_list_it_shows_the_size_of_the_robot(tilted: Case) -> None:
    _, nominal, answers = tilted
    robot = nominal.with_component("joint2/load", BaseTilt(e_x=0.03, e_y=0.1))
    elbow = alone(nominal, JOINTS["elbow"]).with_component("joint3/load", BaseTilt())
    rows = brought_to(robot, ("base_tilt", "joint3/load"), elbow)
    assert {symbol: info.spec.value for symbol, info in rows.items()} == {"e_x": 0.03, "e_y": 0.1}
    assert not brought_to(robot, ("constant_torque", "joint3/load"), answers["elbow"].found.chosen.system)

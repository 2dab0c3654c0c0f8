"""A robot's diagnosis in words and tables: what a joint lacks, how large its errors are, and in which unit."""

from dataclasses import replace

import pytest

from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.arm import ArmDiagnosis
from hybrid_id.reporting.arm_diagnosis import joints_table, remark_lines

pytest.importorskip("mujoco")


@pytest.fixture
def found(mended_arm) -> ArmDiagnosis:
    return mended_arm[2]


def cells(found: ArmDiagnosis) -> dict[str, list[str]]:
    """The table of joints, column by column."""
    return {str(c.header): [str(cell) for cell in c.cells] for c in joints_table(found).columns}


def test_ties_are_said_where_the_effect_matters_to_the_robot(found: ArmDiagnosis) -> None:
    elbow = found.joints["elbow"]
    first, second, *others = elbow.effects
    rival = f"{second.name}@{second.where}"
    unsure = replace(elbow, effects=(replace(first, tied_with=(rival,)), second, *others))
    robot = replace(found, joints={**found.joints, "elbow": unsure})
    group = [f"{first.name}@elbow/load", f"{second.name}@elbow/{second.where.rpartition('/')[2]}"]
    assert robot.as_dict()["ties"] == [group]
    said = next(line for line in remark_lines(robot) if "indistinguishable on these records" in line)
    assert said.startswith("elbow: ") and second.name.replace("_", " ") in said
    slight = replace(robot, parts={"pan": 0.999, "lift": 0.0, "elbow": 0.001})
    assert slight.as_dict()["ties"] == [] and "indistinguishable" not in " ".join(remark_lines(slight))


def test_where_records_differ_a_joint_is_said_to_lack_nothing(found: ArmDiagnosis) -> None:
    joint, own = next((j, one) for j, one in found.joints.items() if not one.selected)
    parts = {j: float(j == joint) for j in found.joints}
    others = {j: replace(one, verdict="no_gap", effects=(), varying=()) for j, one in found.joints.items()}
    for varying, verdict in ((("F_c by 9 %",), "parameters_only"), ((), "outside_catalogue")):
        odd = replace(own, verdict=verdict, unknown=not varying, varying=varying)
        robot = replace(found, joints={**others, joint: odd}, parts=parts)
        assert (robot.verdict, robot.unknown) == (verdict, not varying)
        said = " ".join(remark_lines(robot))
        assert ("values differ from record to record" in said) == bool(varying)
        assert ("values differ from record to record" in "".join(cells(robot)["lacks"])) == bool(varying)


def test_what_acts_on_all_joints_has_its_size_at_each_that_has_it(found: ArmDiagnosis) -> None:
    """The robot lists it once, here at the lift."""
    elbow, tilt = found.joints["elbow"], REGISTRY["base_tilt"]
    one = replace(elbow.effects[0], name="base_tilt", parameters={"e_x": (0.1, 0.0), "e_y": (0.2, 0.0)})
    chosen = elbow.search.chosen
    own = elbow.model.with_component(one.where, tilt(e_x=0.1, e_y=0.2))
    chosen = replace(chosen, result=replace(chosen.result, system=own))
    elbow = replace(elbow, effects=(one, *elbow.effects[1:]), search=replace(elbow.search, chosen=chosen))
    robot = found.model.with_component("joint2/load", tilt(e_x=0.1, e_y=0.2))
    several = replace(found, model=robot, joints={**found.joints, "elbow": elbow})
    assert any("base tilt" in line and "0.2" in line for line in remark_lines(several))

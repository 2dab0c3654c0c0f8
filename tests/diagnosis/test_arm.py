"""A robot diagnosed joint by joint: what is missing is found where it is, and the whole robot is better for it."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import text_of
from gapcase import only
from servo_arm import NOISE, described, records_of

from hybrid_id import Dataset, diagnose, diagnose_arm
from hybrid_id.components import REGISTRY, Component
from hybrid_id.components.load.base_tilt import BaseTilt
from hybrid_id.components.load.body_inertia import BodyInertia
from hybrid_id.components.load.floor_contact import FloorContact
from hybrid_id.diagnosis import arm
from hybrid_id.diagnosis.arm import NOT_ASKED, STOPPED, ArmDiagnosis
from hybrid_id.diagnosis.catalogue import effect as effect_of
from hybrid_id.diagnosis.catalogue import with_effect
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import answered
from hybrid_id.diagnosis.scales import scales
from hybrid_id.errors import InputError
from hybrid_id.identification.keep import Kept
from hybrid_id.records.skew import Skew
from hybrid_id.reporting.arm_diagnosis import arm_headline, arm_page
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.by_joint import (
    STANDS,
    alone,
    joints_to_diagnose,
    with_others_measured,
)
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


@pytest.fixture
def few() -> Iterator[None]:
    """A catalogue of what is missing, a near rival and a far one."""
    with only("spring_load", "constant_torque", "quadratic_drag"):
        yield


@pytest.fixture
def nominal(tmp_path: Path) -> System:
    return described(tmp_path)


@pytest.mark.usefixtures("few")
def test_a_missing_spring_is_found_at_its_joint_and_mends_the_whole_robot(
    mended_arm: tuple[Dataset, System, ArmDiagnosis], kept: Kept
) -> None:
    dataset, nominal, found = mended_arm
    assert [(one.name, one.where) for one in found.selected] == [("spring_load", "elbow/load")]
    assert found.verdict == "effects" and not found.unknown and not found.interrupted
    right = {one.verdict for name, one in found.joints.items() if name != "elbow"}
    assert right <= {"no_gap", "parameters_only"}
    assert found.parts["elbow"] > 0.9 and sum(found.parts.values()) == pytest.approx(1.0)
    assert all(0.0 <= least <= found.parts[n] <= most for n, (least, most) in found.part_bounds.items())
    # one that lacks something lacks more than its records can show
    assert all(one.selected or one.probability >= CRITERIA.base_rate for one in found.effects)
    assert found.shrink is not None and found.shrink.share > 0.9
    assert found.model.parameter("k_s_elbow").spec.value == pytest.approx(0.8, rel=0.03)
    assert found.model.tree is not None and len(found.model.joints) == 3
    said = json.loads(json.dumps(found.as_dict()))
    assert said["effects"][0]["joint"] == "elbow" and said["location"][0]["joint"] == "elbow"
    assert set(said["gap"]["by_output"]) == {"q_m1", "q_m2", "q_m3"}

    rng = np.random.default_rng(0)
    scrambled = replace(
        dataset,
        records=tuple(
            replace(r, outputs={n: rng.permutation(y) for n, y in r.outputs.items()})
            if r.role == "test"
            else r
            for r in dataset.records
        ),
    )
    stages = list[str]()
    other = diagnose_arm(scrambled, nominal, kept=kept, progress=lambda stage, *_: stages.append(stage))
    assert {stage.split(":")[0] for stage in stages} >= {"pan", "lift", "elbow", "the whole robot"}
    assert answer(other) == answer(found)
    assert other.shrink is not None and other.shrink.with_effect > found.shrink.with_effect


def answer(found: ArmDiagnosis) -> object:
    """What the test records must not change."""
    said = found.as_dict()
    values = {info.name: info.spec.value for info in found.model.table}
    return [said[key] for key in ("verdict", "unknown", "effects", "remainder", "location")], values


@pytest.mark.usefixtures("few")
def test_one_joint_alone_is_diagnosed_where_it_is_asked_for(nominal: System) -> None:
    dataset = records_of(nominal, 3)
    found = diagnose_arm(dataset, nominal, joints=["lift"])
    assert set(found.joints) == {"lift"} and not found.selected
    assert any(one.probability < CRITERIA.base_rate for one in found.effects)
    assert found.verdict in ("no_gap", "parameters_only")
    assert found.skipped == {"pan": NOT_ASKED, "elbow": NOT_ASKED}
    said = json.loads(json.dumps(found.as_dict()))["joints"]["lift"]
    assert all(one["where"].startswith("lift/") for one in said["effects"]) and set(
        said["gap"]["by_output"]
    ) == {"q_m2"}
    assert "joint2" not in json.dumps(said) and "joint1" not in json.dumps(said)
    with pytest.raises(InputError, match=r"no joint 'lfit'.*lift"):
        diagnose_arm(dataset, nominal, joints=["lfit"])


@pytest.mark.usefixtures("few")
def test_joints_of_a_coupled_gear_are_diagnosed_as_one_part(nominal: System, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(
        "robot: {file: arm.xml}\ncouplings: [{joints: [lift, elbow], matrix: [[1, 0], [1, 1]]}]\n"
    )
    wrist = load_model(tmp_path / "model.yaml")
    dataset = records_of(wrist.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4)))
    assert joints_to_diagnose(dataset, wrist) == (["pan", "lift + elbow"], {})
    found = diagnose_arm(dataset, wrist, joints=["elbow"], max_effects=1)
    assert found.skipped == {"pan": NOT_ASKED} and list(found.joints) == ["lift + elbow"]
    said = found.as_dict()["effects"][0]
    assert (said["name"], said["where"], said["selected"]) == ("spring_load", "elbow/load", True)
    assert said["joint"] == "lift + elbow" and found.model.tree == wrist.tree
    assert said["parameters"]["k_s"][0] == pytest.approx(0.8, rel=0.05)
    errors = found.model_errors
    assert errors is not None and set(errors.rmse) == {"q_m1", "q_m2", "q_m3"}
    assert re.search(r"lift \+ elbow +spring", text_of(arm_page(found, {}, {}).screen()))


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("noise", [NOISE, 0.0])
def test_a_joint_that_stands_still_is_held_where_it_was_measured(nominal: System, noise: float) -> None:
    dataset = records_of(nominal, 3)
    rng = np.random.default_rng(1)
    still = replace(
        dataset,
        records=tuple(
            replace(r, outputs={**r.outputs, "q_m2": 0.1 + noise * rng.standard_normal(r.n_samples)})
            for r in dataset.records
        ),
    )
    taken, skipped = joints_to_diagnose(still, nominal)
    assert taken == ["pan", "elbow"] and skipped == {"lift": STANDS}
    with pytest.raises(InputError, match="'lift' cannot be diagnosed by itself: stands still"):
        diagnose_arm(still, nominal, joints=["lift"])
    if noise:
        return
    found = diagnose_arm(still, nominal, joints=["pan"], max_effects=1)
    assert found.skipped == {"lift": STANDS, "elbow": NOT_ASKED}
    assert set(found.as_dict()["gap"]["by_output"]) == {"q_m1", "q_m3"}
    assert re.search(
        "lift +not diagnosed: stands still in all train records", text_of(arm_page(found, {}, {}).screen())
    )
    assert len(found.model.joints) == 3


def test_a_joint_whose_angle_nobody_has_measured_is_said(nominal: System) -> None:
    dataset = records_of(nominal, 2)
    records = (replace(r, outputs={n: r.outputs[n] for n in ("q_m1", "q_m3")}) for r in dataset.records)
    blind = replace(dataset, outputs=dataset.outputs[::2], records=tuple(records))
    with pytest.raises(InputError, match=r"no angle of joint 'lift'.*hold: {lift: 0.0}"):
        diagnose_arm(blind, nominal)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("alike", [True, False])
def test_what_several_joints_lack_is_one_size_or_several(nominal: System, alike: bool) -> None:
    machine = nominal
    for joint, k in ((2, 0.8), (3, 0.8 if alike else 1.2)):
        machine = machine.with_component(f"joint{joint}/load", REGISTRY["spring_load"](k_s=k, q_s=0.4))
    found = diagnose_arm(records_of(machine), nominal, max_effects=1)
    sizes = {one.symbol: one for one in found.common}
    assert sizes["k_s"].joints == ("lift", "elbow")
    assert sizes["k_s"].common == alike
    if alike:
        assert sizes["k_s"].value == pytest.approx(0.8, rel=0.05)


@pytest.mark.usefixtures("few")
def test_a_stopped_search_keeps_the_joints_that_it_has_done(nominal: System) -> None:
    dataset = records_of(nominal, 3)

    def stop(stage: str, done: int, total: int) -> None:
        if stage.startswith("lift"):
            raise KeyboardInterrupt

    found = diagnose_arm(dataset, nominal, progress=stop)
    assert set(found.joints) == {"pan"} and found.interrupted
    assert found.skipped == {"lift": STOPPED, "elbow": STOPPED}
    assert found.verdict == "inconclusive" and not found.estimates
    assert arm_headline(found).startswith(
        "Inconclusive: no effect had been accepted at any joint that was diagnosed."
    )


@pytest.mark.usefixtures("few")
def test_a_channel_that_is_late_is_shifted_for_every_stage(nominal: System, monkeypatch) -> None:
    dataset = records_of(nominal, 3)
    late = Skew("q_m1", 0.02, 1e-4, ("v_m1",))
    monkeypatch.setattr(arm, "find_skews", lambda _: [late])

    def stop(stage: str, done: int, total: int) -> None:
        if stage.startswith("lift"):
            raise KeyboardInterrupt

    found = diagnose_arm(dataset, nominal, progress=stop)
    assert (
        found.dataset.records[0].n_samples < dataset.records[0].n_samples
    )  # the ends have no value any more
    assert found.joints["pan"].skews == (late.message,)


SERVOS = {
    "encoder_zero": (
        "elbow",
        lambda whole: whole.with_component("joint3/sensor", REGISTRY["motor_log"](offset=0.05)),
    ),
    "goal_rate_limit": (
        "elbow",
        lambda whole: whole.with_component("joint3/input", REGISTRY["goal_rate_limit"](w_max=1.2)),
    ),
    "delay": ("lift", lambda whole: whole.with_component("joint2/input", REGISTRY["delay"](T_d=0.03))),
    "link_mass": (  # of the body beyond: that of its own link is a scale of all torques, which nobody knows
        "lift",
        lambda whole: whole.with_component("joint3/load", BodyInertia("elbow_link", c_m=2.5)),
    ),
}
"""What servos and descriptions get wrong: the joint that shows it, and the machine that has it."""
RIVALS = ("constant_torque", "spring_load", "joint_flexibility", "electrical_lag", "stribeck_friction")


@pytest.mark.parametrize("effect", SERVOS)
def test_what_servos_and_descriptions_get_wrong_is_named(nominal: System, effect: str) -> None:
    joint, altered = SERVOS[effect]
    machine = altered(nominal)
    with only(*SERVOS, *RIVALS):
        found = diagnose_arm(records_of(machine), nominal, joints=[joint], max_effects=1)
    (best,) = found.selected
    alike = {best.name, *(tie.split("@")[0] for tie in best.tied_with)}
    assert effect in alike and best.probability > 0.3, found.joints[joint].summary()
    if effect == "encoder_zero":  # which a bias torque is, but for the weight that it turns
        assert alike <= {"encoder_zero", "constant_torque", "gravity_load", "link_mass"}


@pytest.mark.parametrize(
    ("effect", "part"),
    [
        ("base_tilt", BaseTilt(e_x=0.15, e_y=-0.1)),
        ("cable_pull", REGISTRY["cable"](k_c=3.0, q_c=0.2)),
        ("floor_contact", FloorContact("elbow_link", z_f=-0.28, k_f=400.0)),
        ("gravity_compensation", REGISTRY["gravity_compensation"]()),
    ],
)
def test_what_loads_an_arm_beside_its_links_is_named_among_loads(
    nominal: System, effect: str, part: Component
) -> None:
    dataset = records_of(nominal.with_component("joint2/load", part))
    loads = "base_tilt", "cable_pull", "constant_torque", "floor_contact", "link_mass", "spring_load"
    with only(*loads, "encoder_zero", "gravity_compensation"):
        found = diagnose_arm(dataset, nominal, joints=["lift"], max_effects=1)
    (best,) = found.selected
    assert effect in {best.name, *(tie.split("@")[0] for tie in best.tied_with)} and best.probability > 0.3


ONE = """<mujoco><compiler angle="radian"/><worldbody><body name="upper">
<joint name="lift" axis="0 1 0" armature="0.015" damping="0.08" frictionloss="0.04"/>
<inertial mass="0.4" pos="0 0 0.1" diaginertia="0.001 0.001 0.0003"/>
</body></worldbody><actuator><position joint="lift" kp="8"/></actuator></mujoco>"""


def test_no_fit_makes_a_link_weightless_by_huge_torques_where_its_weight_is_held(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ONE)
    (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\n")
    system = load_model(tmp_path / "model.yaml")
    held = system.with_component("joint1/load", REGISTRY["gravity_compensation"]())
    with only("gravity_compensation", "constant_torque", "spring_load", "link_mass", "encoder_zero"):
        found = diagnose(records_of(held), system, max_effects=1)
    (best,) = found.selected
    assert best.name == "gravity_compensation" and best.probability > 0.9
    assert best.parameters["c_g"][0] == pytest.approx(1.0, abs=0.05)


def test_an_arm_on_a_wall_is_told_from_one_on_a_table(nominal: System) -> None:
    dataset = records_of(nominal.with_component("joint2/load", BaseTilt(e_y=0.5 * np.pi)))
    with only("base_tilt", "constant_torque", "link_mass"):
        found = diagnose_arm(dataset, nominal, joints=["lift"], max_effects=1)
    (best,) = found.selected
    assert best.name == "base_tilt" and best.parameters["e_y"][0] == pytest.approx(0.5 * np.pi, abs=0.02)
    assert best.share is not None and best.share > 0.95


def test_a_zero_that_is_two_teeth_off_is_no_torque(nominal: System) -> None:
    machine = nominal.with_component("joint2/sensor", REGISTRY["motor_log"](offset=0.5))
    with only("encoder_zero", "constant_torque"):
        found = diagnose_arm(records_of(machine), nominal, joints=["lift"], max_effects=2)
    (best,) = found.selected
    assert best.name == "encoder_zero" and best.parameters["offset"][0] == pytest.approx(0.5, abs=0.02)


def test_what_the_robot_lists_at_another_joint_is_not_tried(nominal: System) -> None:
    known = nominal.with_component("joint3/load", BodyInertia("elbow_link", c_m=1.0))
    dataset = records_of(known, 2)
    tried = {}
    for name, robot in (("plain", nominal), ("known", known)):
        one, records = alone(robot, 1), with_others_measured(dataset, robot, 1)
        size = scales(one, batch_of(records, one, records.train))[0]
        models = with_effect(effect_of("link_mass"), one, size).get("joint2/load", [])
        tried[name] = {
            part.point for m in models for part in m.components.values() if isinstance(part, BodyInertia)
        }
    assert "elbow_link" in tried["plain"] and "elbow_link" not in tried["known"]


def test_a_floor_is_suspected_where_the_joint_raises_a_point_of_the_last_link(nominal: System) -> None:
    dataset = records_of(nominal, 2)
    tips = {}
    for k, name in enumerate(["pan", "lift", "elbow"]):
        one, records = alone(nominal, k), with_others_measured(dataset, nominal, k)
        tips[name] = scales(one, batch_of(records, one, records.train))[0].tip
    assert tips["pan"] is None and tips["elbow"] is None  # its origin is all that the last link has
    assert tips["lift"].name == "elbow_link" and -0.3 <= tips["lift"].lowest < tips["lift"].highest < -0.1


@pytest.mark.usefixtures("few")
def test_fewer_validation_than_train_records_judge_what_stands_for_all(nominal: System) -> None:
    dataset = records_of(nominal.with_component("joint2/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4)), 5)
    roles = ["train"] * 3 + ["validation"] * 2
    records = tuple(replace(one, role=role) for one, role in zip(dataset.records, roles, strict=True))
    found = diagnose_arm(replace(dataset, records=records), nominal, joints=["lift"], max_effects=1)
    assert [one.name for one in found.selected] == ["spring_load"]


@pytest.mark.usefixtures("few")
def test_a_joint_that_cannot_be_fitted_does_not_cost_the_others_their_answers(
    nominal: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def fails_once(dataset: Dataset, system: System, **settings: Any) -> Any:
        calls.append(system)
        if len(calls) == 1:
            raise InputError("The nominal model diverges.")
        return answered(dataset, system, **settings)

    monkeypatch.setattr(arm, "answered", fails_once)
    found = diagnose_arm(records_of(nominal, 2), nominal, joints=["pan", "lift"])
    assert set(found.joints) == {"lift"} and found.skipped["pan"] == "The nominal model diverges"

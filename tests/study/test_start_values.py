"""What is said of records before a fit: joints that stand still, and angles that their joints cannot have."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_id import Channel, Dataset, InputError, Record, System, load_model, one_link, two_link
from hybrid_id.components.input.position_loop import PositionLoop
from hybrid_id.study import check_scales, check_start_values

TIME = 0.01 * np.arange(100)
NOISE = 1e-3


def arm_records(joints: int, moving: int, runs: int = 2) -> Dataset:
    """Runs of an arm of which the first joints move; the others' encoders give noise."""
    rng = np.random.default_rng(0)
    names = [f"q_m{k + 1}" for k in range(joints)]
    records = [
        Record(
            f"run{r}",
            TIME,
            {f"u{k + 1}": np.sin((5 + r) * TIME) for k in range(joints)},
            {
                n: NOISE * rng.standard_normal(100) + (k < moving) * np.sin(9 * TIME)
                for k, n in enumerate(names)
            },
        )
        for r in range(runs)
    ]
    inputs = tuple(Channel(f"u{k + 1}", "V") for k in range(joints))
    return Dataset("arm", inputs, tuple(Channel(n, "rad", NOISE) for n in names), tuple(records), 0.01)


def said(dataset: Dataset, system: System) -> str:
    return " ".join(finding.message for finding in check_start_values(dataset, system))


def test_of_a_joint_that_stands_still_nothing_can_be_identified() -> None:
    dataset, system = arm_records(2, moving=1), two_link()
    assert "joint2 stands still in all records to learn from" in said(dataset, system)
    assert "still" not in said(arm_records(2, moving=2), system)
    undeclared = tuple(replace(channel, noise_std=None) for channel in dataset.outputs)
    assert "joint2 stands still" in said(replace(dataset, outputs=undeclared), system)
    one, other = dataset.records
    turned = replace(one, outputs={**one.outputs, "q_m2": np.sin(TIME)})
    assert "still" not in said(replace(dataset, records=(turned, other)), system)  # it moves in one of them


@pytest.mark.parametrize(("system", "joints"), [(one_link(), 1), (two_link(), 2)])
def test_records_in_which_nothing_moves_are_refused(system: System, joints: int) -> None:
    with pytest.raises(InputError, match="nothing of a drive at rest can be identified"):
        check_start_values(arm_records(joints, moving=0), system)


@pytest.mark.parametrize(
    ("output", "scale", "found"),
    [
        ("q_a1", 1.0, False),
        ("q_a1", 180.0 / np.pi, True),
        ("q_m1", 10.0, False),  # the motor's angle, ten turns for one of the joint
        ("q_m1", 1800.0 / np.pi, True),
    ],
)
def test_angles_far_out_of_the_joints_range_are_in_another_unit(
    tmp_path: Path, output: str, scale: float, found: bool
) -> None:
    (tmp_path / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint name='pan' type='hinge' range='-60 60'/>"
        "<geom type='box' size='0.1 0.1 0.1' mass='1'/></body></worldbody></mujoco>"
    )
    (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\ngear_ratio: [10]\n")
    record = Record("run", TIME, {"tau1": np.sin(5 * TIME)}, {output: scale * np.sin(9 * TIME)})
    dataset = Dataset("arm", (Channel("tau1", "N m"),), (Channel(output, "rad"),), (record,), 0.01)
    findings = check_scales(dataset, load_model(tmp_path / "model.yaml"))
    assert [(f.severity, f.code) for f in findings] == ([("error", "range")] if found else [])
    assert all("takes pan through" in f.message and "its range in arm.xml" in f.message for f in findings)


@pytest.mark.parametrize(
    ("actuator", "ratio", "channel", "beyond"),
    [
        ('<motor joint="pan" ctrlrange="-1 2"/>', 1, "tau1", ""),
        ('<motor joint="pan" ctrlrange="-0.4 2"/>', 1, "tau1", "pan allows in arm.xml"),
        ('<motor joint="pan" ctrlrange="-0.4 2" gear="-3"/>', 1, "tau1", ""),  # at the joint, -6 to 1.2
        ('<motor joint="pan" ctrlrange="-0.4 2" gear="3"/>', 3, "tau1", "beyond the -0.4 to 2 N m that"),
        ('<general joint="pan" gainprm="2" ctrlrange="-0.4 2"/>', 1, "tau1", "beyond the -0.8 to 4 N m that"),
        ('<velocity joint="pan" kv="1" ctrlrange="-0.4 2"/>', 1, "tau1", ""),  # a range of speeds
        (
            '<position joint="pan" kp="1" ctrlrange="-1 0.5"/>',
            1,
            "goal1",
            "beyond the -1 to 0.5 rad to which",
        ),
    ],
)
def test_a_command_beyond_the_range_of_its_actuator_is_told(
    tmp_path: Path, actuator: str, ratio: int, channel: str, beyond: str
) -> None:
    (tmp_path / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint name='pan' type='hinge'/><geom type='box' size='0.1 0.1 0.1' mass='1'/>"
        f"</body></worldbody><actuator>{actuator}</actuator></mujoco>"
    )
    (tmp_path / "model.yaml").write_text(f"robot: {{file: arm.xml}}\ngear_ratio: [{ratio}]\n")
    command = Channel(channel, "rad" if channel == "goal1" else "N m")
    record = Record("run", TIME, {channel: np.sin(9 * TIME)}, {"q_a1": 0.9 * np.sin(9 * TIME - 0.2)})
    dataset = Dataset("arm", (command,), (Channel("q_a1", "rad"),), (record,), 0.01)
    found = check_scales(dataset, load_model(tmp_path / "model.yaml"))
    assert [(one.severity, one.code) for one in found] == [("warning", "command_range")] * bool(beyond)
    assert all(beyond in one.message for one in found)


@pytest.mark.parametrize(
    ("unit", "turns", "severity"),
    [
        (1.0, 1.0, None),
        (10.0, 1.0, "warning"),
        (180.0 / np.pi, 1.0, "error"),
        (50.0, 50.0, None),  # this loop reads the motor's angle, 50 turns for one of the joint
        (1.0, 50.0, "error"),
    ],
)
def test_a_goal_that_the_angle_follows_far_off_is_in_another_unit(
    unit: float, turns: float, severity: str | None
) -> None:
    """In degrees, say; a servo that trails its goal by a tenth of its motion is none."""
    goal = np.sin(9 * TIME)
    record = Record("a", TIME, {"goal1": unit * goal}, {"q_a1": 0.9 * np.sin(9 * TIME - 0.2)})
    dataset = Dataset("a", (Channel("goal1", "rad"),), (Channel("q_a1", "rad", NOISE),), (record,), 0.01)
    servo = one_link(turns).with_component("joint1/input", PositionLoop())
    found = check_scales(dataset, servo)
    assert [(one.severity, one.channel) for one in found] == [(severity, "goal1")] * bool(severity)


@pytest.mark.parametrize(
    ("apart", "sags", "zero"),
    [
        (6.28, 0.0, "zero 6.2832"),
        (-1.57, 0.0, "zero -1.5708"),
        (2.5, 0.0, "zero 2.4"),
        (0.5, 0.0, "beside 0.4"),
        (0.2, 0.0, ""),
        (1.6, 2.0, ""),
    ],
)
def test_an_angle_far_beside_its_goal_has_another_zero(apart: float, sags: float, zero: str) -> None:
    """A loop that gives way to a load stays beside its goal, too, and not by the same angle everywhere."""
    goal = np.sin(9 * TIME)
    angle = 0.99 * np.sin(9 * TIME - 0.05) + apart + sags * np.sin(9 * TIME)
    record = Record("a", TIME, {"goal1": goal}, {"q_a1": angle})
    dataset = Dataset("a", (Channel("goal1", "rad"),), (Channel("q_a1", "rad", NOISE),), (record,), 0.01)
    found = check_scales(dataset, one_link(1.0).with_component("joint1/input", PositionLoop()))
    assert [(one.code, one.channel) for one in found] == [(zero.split(" ")[0], "q_a1")] * bool(zero)
    assert all(f"stays {zero.split(' ')[1]}" in one.message for one in found)


def test_an_angle_that_moves_against_its_goal_or_with_anothers_is_named() -> None:
    goals = {"goal1": np.sin(9 * TIME), "goal2": np.cos(14 * TIME)}
    channels = (
        tuple(Channel(name, "rad") for name in goals),
        tuple(Channel(f"q_a{k}", "rad", NOISE) for k in (1, 2)),
    )
    arm = two_link().with_component("joint1/input", PositionLoop())
    arm = arm.with_component("joint2/input", PositionLoop())

    def said(first: np.ndarray, second: np.ndarray) -> list[tuple[str, str]]:
        record = Record("a", TIME, goals, {"q_a1": first, "q_a2": second})
        dataset = Dataset("a", *channels, (record,), 0.01)
        return [(one.code, one.channel) for one in check_scales(dataset, arm)]

    one, other = goals.values()
    assert said(0.95 * one, 0.95 * other) == []
    assert said(-0.95 * one, 0.95 * other) == [("sign", "q_a1")]
    assert said(0.95 * other, 0.95 * one) == [("columns", "q_a1"), ("columns", "q_a2")]

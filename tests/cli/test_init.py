"""`init`: logs of many shapes get the files that a person would have written, and doubts are asked."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from drives import make_records, multisine, rigid_drive
from record_formats import write_lerobot

from hybrid_id.records.dataset import Dataset

RECORDS = 3
ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder_pan" axis="0 0 1" range="-1.9 1.9"
 armature="0.01" damping="0.2" frictionloss="0.05"/>
<inertial mass="0.5" pos="0.1 0 0" diaginertia="2e-3 2e-3 2e-3"/>
<body name="lower" pos="0.2 0 0"><joint name="elbow_flex" axis="0 1 0" range="-1.7 1.7" armature="0.01" damping="0.2"
 frictionloss="0.05"/><inertial mass="0.3" pos="0.1 0 0" diaginertia="0.001 0.001 0.001"/></body></body>
</worldbody><actuator>{actuators}</actuator></mujoco>"""
ACTUATORS = '<position joint="shoulder_pan" kp="8" kv="0.8"/><position joint="elbow_flex" kp="8" kv="0.8"/>'


@pytest.fixture(scope="module")
def motions() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Time [s], voltage [V] and motor's angle [rad] of three records."""
    voltages = [multisine(seed, samples=1000, amplitude=6.0 + seed) for seed in range(RECORDS)]
    records = make_records(rigid_drive(), voltages, noise={"q_m1": 0.01})
    return [(r.time, r.inputs["u1"], r.outputs["q_m1"]) for r in records]


def write_csv(folder: Path, motions, columns, records: int = RECORDS) -> Path:
    """CSV files whose columns are functions of time, voltage and angle."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, motion in enumerate(motions[:records], 1):
        table = np.column_stack([values(*motion) for values in columns.values()])
        np.savetxt(folder / f"run{k}.csv", table, header=",".join(columns), comments="", delimiter=",")
    return folder


def written(folder: Path) -> tuple[dict, dict]:
    data, model = (yaml.safe_load((folder / f"{kind}.yaml").read_text()) for kind in ("dataset", "model"))
    return data, model


def proposed(run, folder: Path, *options: object) -> tuple[dict, dict, str]:
    """What `init` writes for logs, and what it says, in one line."""
    done = run("init", folder, *options)
    assert done.code == 0, done.err
    return *written(folder), " ".join(done.out.split())


def columns_of(data: dict) -> dict[str, str]:
    """The files' column of each channel."""
    return {name: one if isinstance(one, str) else one["column"] for name, one in data["columns"].items()}


MS = {
    "time": lambda t, u, q: 1e3 * t,
    "plant_voltage": lambda t, u, q: u,
    "theta": lambda t, u, q: np.degrees(q),
}


def test_degrees_and_milliseconds_pass_check(run, tmp_path: Path, motions) -> None:
    folder = write_csv(tmp_path / "bench", motions, MS)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    data, model, words = proposed(run, folder)
    assert data["inputs"] == [{"name": "u1", "unit": "V"}]
    assert data["outputs"] == [{"name": "q_m1", "unit": "deg"}]
    assert data["columns"]["t"] == {"column": "time", "unit": "ms"}
    assert [record["role"] for record in data["records"]] == ["train", "train", "test"]
    assert model["system"] == "one_link" and model["gear_ratio"] == [1.0]
    assert model["parameters"]["P_m2"]["nominal"] == pytest.approx(
        rigid_drive().parameter("P_m2").spec.value, rel=0.1
    )
    assert "gear_ratio" in words and "question" in words and "gravity" not in model
    assert {name: (folder / name).read_bytes() for name in before} == before
    checked = run("check", folder)
    assert checked.code == 0, checked.err


def test_a_weight_that_the_logs_show_is_in_the_model(run, tmp_path: Path) -> None:
    drive = rigid_drive(vertical=True, ratio=1.0).with_values({"G_l": 2e-2})
    voltages = [multisine(seed, samples=1000, amplitude=2.0 + seed, rest=1) for seed in range(RECORDS)]
    records = make_records(drive, voltages, noise={"q_m1": 1e-3})
    hanging = [(r.time, r.inputs["u1"], r.outputs["q_m1"]) for r in records]
    _, model, words = proposed(run, write_csv(tmp_path / "x", hanging, MS))
    assert model["gravity"] == "vertical" and "gravity that pulls" in words
    found = {name: entry["nominal"] for name, entry in model["parameters"].items()}
    assert found["G_l"] / found["J"] == pytest.approx(2e-2 / 2e-5, rel=0.3) and abs(found["q_0"]) < 0.1
    assert run("check", tmp_path / "x").code == 0


def test_files_turn_their_schemas_on(run, tmp_path: Path, motions) -> None:
    folder = write_csv(tmp_path / "bench", motions, MS)
    assert run("init", folder).code == 0
    for kind in ("dataset", "model"):
        first = (folder / f"{kind}.yaml").read_text().splitlines()[0]
        assert first == f"# yaml-language-server: $schema=.schema/{kind}.json"
        schema = json.loads((folder / ".schema" / f"{kind}.json").read_text())
        assert set(yaml.safe_load((folder / f"{kind}.yaml").read_text())) <= set(schema["properties"])
    assert run("init", folder, "--force").code == 0  # schemas are no logs


def test_nothing_is_overwritten_without_force(run, tmp_path: Path, motions) -> None:
    folder = write_csv(tmp_path / "bench", motions, MS, records=1)
    (folder / "model.yaml").write_text("mine")
    refused = run("init", folder)
    assert refused.code == 2 and "model.yaml" in refused.err and "--force" in refused.err
    assert (folder / "model.yaml").read_text() == "mine" and not (folder / "dataset.yaml").exists()
    assert run("init", folder, "--force").code == 0
    assert written(folder)[1]["system"] == "one_link"


def test_other_names_a_turned_sign_and_a_sheet(run, tmp_path: Path, motions) -> None:
    columns = {
        "stamp_us": lambda t, u, q: 1e6 * t + 1.7e9,
        "encoder": lambda t, u, q: -q,
        "motor_current_mA": lambda t, u, q: 1e3 * (u - 0.0254 * np.gradient(q, t)) / 2.0,
        "cmd_volts": lambda t, u, q: u,
        "notes": lambda t, u, q: np.zeros_like(t),
    }
    folder = write_csv(tmp_path / "logs", motions, columns, records=2)
    sheet = tmp_path / "sheet.yaml"
    sheet.write_text("gear_ratio: 20\ntorque_constant: 0.0254\nresistance: 1.33\n")
    done = run("init", folder / "run1.csv", folder / "run2.csv", "--motor", sheet, "--out", tmp_path / "mine")
    assert done.code == 0, done.err
    data, model = written(tmp_path / "mine")
    assert data["columns"]["t"] == {"column": "stamp_us", "unit": "us"}
    assert data["columns"]["q_m1"] == {"column": "encoder", "scale": -1.0}
    assert {"name": "i1", "unit": "mA"} in [
        {k: v for k, v in one.items() if k != "skew"} for one in data["outputs"]
    ]
    assert model["gear_ratio"] == [20.0] and model["parameters"]["P_m2"]["prior_std"] > 0
    assert model["parameters"]["J"]["nominal"] == pytest.approx(
        rigid_drive().parameter("J").spec.value, rel=0.25
    )
    assert [record["role"] for record in data["records"]] == [
        "train",
        "train",
    ] and "record at least 1 more" in done.out
    assert sorted(file.name for file in folder.iterdir()) == ["run1.csv", "run2.csv"]  # logs are left alone
    assert "notes: stands still" in done.out


def test_columns_without_names_are_asked_about(run, tmp_path: Path, motions) -> None:
    columns = {
        "a": lambda t, u, q: t,
        "b": lambda t, u, q: q,
        "c": lambda t, u, q: np.gradient(q, t) + 0.5 * np.sin(1e5 * t),
        "d": lambda t, u, q: u,
    }
    done = run("init", write_csv(tmp_path / "x", motions, columns), "--json")
    assert done.code == 0, done.err
    data, _ = written(tmp_path / "x")
    assert columns_of(data) == {"t": "a", "u1": "d", "q_m1": "b", "v_m1": "c"}
    asked = " ".join(one["question"] for one in json.loads(done.out)["questions"])
    assert "'b'" in asked and "'d'" in asked


def test_jitter_proposes_resampling(run, tmp_path: Path, motions) -> None:
    rng = np.random.default_rng(0)
    columns = MS | {"time": lambda t, u, q: 1e3 * (t + rng.uniform(-3e-4, 3e-4, t.size))}
    folder = write_csv(tmp_path / "x", motions, columns)
    assert run("init", folder).code == 0
    assert written(folder)[0]["resample"] is True


def test_gaps_are_bridged_or_cut_and_said(run, tmp_path: Path, motions) -> None:
    short, long = np.r_[0:300, 305:1000], np.r_[0:300, 400:1000]
    folder = tmp_path / "x"
    for k, rows in enumerate((short, long)):
        write_csv(folder / "part", [[signal[rows] for signal in motions[k]]], MS)
        (folder / "part" / "run1.csv").rename(folder / f"run{k}.csv")
    (folder / "part").rmdir()
    data, _, words = proposed(run, folder)
    assert data["resample"] == {"max_gap": 7} and data["records"][1]["between"] == [0.8, 1.998]
    assert "bridged" in words
    assert run("check", folder).code == 0


def test_the_command_that_acts_is_taken_of_several(run, tmp_path: Path, motions) -> None:
    rng = np.random.default_rng(1)
    columns = MS | {
        "control": lambda t, u, q: u + rng.normal(0.0, 3.0, t.size),
        "plant_input": MS["plant_voltage"],
    }
    del columns["plant_voltage"]
    data, _, words = proposed(run, write_csv(tmp_path / "x", motions, columns))
    assert columns_of(data)["u1"] == "plant_input" and "control" in words


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"time": MS["time"], "temperature": lambda t, u, q: q}, "no usable pair"),
        ({"voltage": lambda t, u, q: u, "angle": lambda t, u, q: q}, "no column of time"),
    ],
)
def test_no_usable_columns_are_refused(run, tmp_path: Path, motions, columns, words: str) -> None:
    folder = write_csv(tmp_path / "x", motions, columns)
    refused = run("init", folder)
    assert refused.code == 2 and words in refused.err and refused.err.count("\n") == 1
    assert not list(folder.glob("*.yaml"))


def test_an_empty_folder_and_a_wrong_sheet_are_refused(run, tmp_path: Path, motions) -> None:
    (tmp_path / "empty").mkdir()
    assert run("init", tmp_path / "empty").code == 2
    assert run("init", tmp_path / "nowhere").code == 2
    folder = write_csv(tmp_path / "x", motions, MS)
    (tmp_path / "sheet.yaml").write_text("gear: 3\n")
    refused = run("init", folder, "--motor", tmp_path / "sheet.yaml")
    assert refused.code == 2 and "gear" in refused.err and not list(folder.glob("*.yaml"))
    (tmp_path / "sheet.yaml").write_text("gear_ratio: -3\n")
    refused = run("init", folder, "--motor", tmp_path / "sheet.yaml")
    assert refused.code == 2 and "leave out the sign" in refused.err and "'scale: -1'" in refused.err


def swing(seed: int, samples: int = 600, step: float = 0.02) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], goals and angles [rad] of two joints that follow them with a lag."""
    t = step * np.arange(samples)
    phase = np.random.default_rng(seed).uniform(0, 6, (2, 3))
    goal = np.stack(
        [sum(0.5 * np.sin((0.7 + 0.6 * k + 0.2 * j) * t + phase[j, k]) for k in range(3)) for j in range(2)],
        axis=1,
    )
    angle = np.zeros_like(goal)
    angle[0] = goal[0]
    for k in range(1, samples):
        angle[k] = angle[k - 1] + step * 8.0 * (goal[k - 1] - angle[k - 1])
    return t, goal, angle


def write_logs(folder: Path, columns: dict, robot: str = "", logs: int = 3) -> Path:
    """Logs whose columns are functions of time, goals and angles ``(T, 2)``, and beside their folder the robot."""
    pytest.importorskip("mujoco")
    folder.mkdir(parents=True, exist_ok=True)
    if robot:
        (folder.parent / "arm.xml").write_text(robot)
    for seed in range(logs):
        table = np.column_stack([values(*swing(seed)) for values in columns.values()])
        header = ",".join(columns)
        np.savetxt(folder / f"run{seed}.csv", table, "%.9g", header=header, comments="", delimiter=",")
    return folder


def pair(name: str, k: int, factor: float = 1.0) -> dict:
    """Angle and goal of the k-th joint."""
    return {
        f"{name}.pos": lambda t, goal, angle: factor * angle[:, k],
        f"{name}.goal": lambda t, goal, angle: factor * goal[:, k],
    }


TIME = {"time": lambda t, goal, angle: t}
BOTH = TIME | pair("elbow_flex", 1, 180 / np.pi) | pair("shoulder_pan", 0, 180 / np.pi)
FOLLOWING = ARM.format(actuators=ACTUATORS)


@pytest.mark.parametrize("actuators", [ACTUATORS, ""])
def test_two_joints_of_a_robot(run, tmp_path: Path, actuators: str) -> None:
    folder = write_logs(tmp_path / "logs", BOTH, ARM.format(actuators=actuators))
    data, model, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert columns_of(data)["q_a1"] == "shoulder_pan.pos" and columns_of(data)["goal2"] == "elbow_flex.goal"
    assert {one["unit"] for one in (*data["inputs"], *data["outputs"])} == {"deg"}
    assert "'shoulder_pan.pos', 'elbow_flex.pos'" in words  # percent or degrees: one question for both
    assert "times the range of shoulder_pan" in (folder / "dataset.yaml").read_text()
    assert model["robot"]["file"] == "../arm.xml"
    kinds = [one["kind"] for one in model.get("components", [])]
    assert kinds == ([] if actuators else ["position_servo"] * 2)
    assert re.search(r"lag of goal1 0\.1[12]\d* s yes distance of angle and goal over the speed", words)
    assert run("check", folder).code == 0


@pytest.mark.parametrize(
    ("angle", "goal", "others"),
    [
        ("actual_q_{}", "target_q_{}", ("target_current_{}", "actual_current_{}")),  # a UR's RTDE
        ("state.q[{}]", "state.q_d[{}]", ("state.tau_J[{}]", "state.tau_J_d[{}]")),  # libfranka
    ],
)
def test_numbers_from_zero_goals_before_currents_and_units_of_columns_named_alike(
    run, tmp_path: Path, angle: str, goal: str, others: tuple[str, str]
) -> None:
    columns = dict(TIME)
    for k in (0, 1):
        columns[angle.format(k)] = lambda t, g, q, k=k: q[:, k]
        columns[goal.format(k)] = lambda t, g, q, k=k: g[:, k]
        columns |= {other.format(k): lambda t, g, q, k=k: (g - q)[:, k] for other in others}
    text = FOLLOWING.replace("-1.9 1.9", "-60 60")  # degrees would be as likely
    robot = tmp_path / "arm.xml"
    numbered = text.replace("shoulder_pan", "joint1").replace("elbow_flex", "joint2")
    folder = write_logs(tmp_path / "logs", columns, numbered)
    data, _, words = proposed(run, folder, "--robot", robot)
    chosen = [columns_of(data)[one] for one in ("q_a1", "q_a2", "goal1", "goal2")]
    assert chosen == [angle.format(0), angle.format(1), goal.format(0), goal.format(1)]
    assert f"that of '{angle.format(1)}', which is named alike, and" in words
    assert "In which unit" not in words and "those of joint" not in words
    robot.write_text(text)
    asked = "Are the columns of '0', '1' those of joint shoulder_pan, elbow_flex, in this order?"
    assert asked in proposed(run, folder, "--robot", robot, "--force")[2]


@pytest.mark.parametrize("clear", [True, False])
def test_elements_of_a_command_go_to_the_joints_that_follow_them(run, tmp_path: Path, clear: bool) -> None:
    """A topic of joint states is sorted by name, a command by the robot; a controller's errors drive nothing."""

    def told(t, goal, angle):
        return (
            goal
            if clear
            else np.sign(np.random.default_rng(round(1e6 * goal[0, 0]) % 99).normal(size=goal.shape))
        )

    states = ["/joint_states/elbow_flex/position", "/joint_states/shoulder_pan/position"]
    columns = {"__time": TIME["time"]}
    columns |= {name: lambda t, g, q, k=k: q[:, 1 - k] for k, name in enumerate(states)}
    commands = [f"/forward_controller/commands/data[{k}]" for k in (0, 1)]
    columns |= {name: lambda t, g, q, k=k: told(t, g, q)[:, k] for k, name in enumerate(commands)}
    errors = [f"/forward_controller/error/positions[{k}]" for k in (0, 1)]
    columns |= {name: lambda t, g, q, k=k: (g - q)[:, k] for k, name in enumerate(errors)}
    folder = write_logs(tmp_path / "logs", columns, FOLLOWING)
    data, _, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    found = columns_of(data)
    assert set(found.values()) == {"__time", *states, *commands}
    for k, name in enumerate(("shoulder_pan", "elbow_flex")):
        own = {column for channel, column in found.items() if channel.endswith(str(k + 1))}
        assert own == {commands[k], f"/joint_states/{name}/position"}
    assert ("each is the one that the angle of its joint follows" in words) == clear
    assert ("they are taken in the order of the joints: shoulder_pan" in words) != clear
    assert f"{errors[0]} (and 1 alike): error of shoulder_pan: nothing that a drive" in words
    assert f"# {errors[1]}: error of elbow_flex" in (folder / "dataset.yaml").read_text()


def test_d_is_what_is_desired_only_beside_what_is_measured(run, tmp_path: Path) -> None:
    columns = TIME | {f"{what}_{name}": lambda t, g, q, what=what, k=k: (g if what == "cmd" else q)[:, k]
                      for what in ("cmd", "pos") for k, name in enumerate("bd")}  # fmt: skip
    robot = ARM.format(actuators="").replace("shoulder_pan", "b").replace("elbow_flex", "d")
    folder = write_logs(tmp_path / "logs", columns, robot)
    found = columns_of(proposed(run, folder, "--robot", tmp_path / "arm.xml")[0])
    assert (found["goal2"], found["q_a2"]) == ("cmd_d", "pos_d")
    columns = TIME | {
        "i_q": lambda t, g, q: (g - q)[:, 0],
        "i_d": lambda t, g, q: 1e-3 * (g - q)[:, 1],
        "pos": lambda t, g, q: q[:, 0],
    }
    assert columns_of(proposed(run, write_logs(tmp_path / "currents", columns))[0])["i1"] == "i_q"


@pytest.mark.parametrize("side", ["left", "right"])
def test_columns_of_one_arm_are_not_those_of_the_other(run, tmp_path: Path, side: str) -> None:
    arm = ARM[ARM.index('<body name="upper">') : ARM.index("\n</worldbody>")]
    arm = arm.replace("shoulder_pan", "joint1").replace("elbow_flex", "joint2")
    both = "".join(arm.replace('name="', f'name="{one}_') for one in ("right", "left"))
    robot = f'<mujoco><compiler angle="radian"/><worldbody>{both}</worldbody></mujoco>'
    columns = TIME | {
        f"{side}_{k + 1}_{what}": lambda t, g, q, what=what, k=k: (q if what == "pos" else g)[:, k]
        for what in ("pos", "goal")
        for k in (0, 1)
    }
    folder = write_logs(tmp_path / "logs", columns, robot)
    other = "left" if side == "right" else "right"
    held = proposed(run, folder, "--robot", tmp_path / "arm.xml")[1]["robot"]["hold"]
    assert set(held) == {f"{other}_joint1", f"{other}_joint2"}


def test_a_joint_that_shows_no_lag_starts_as_those_with_the_same_actuator(run, tmp_path: Path) -> None:
    """A loop too stiff for the lag of one joint is none for its neighbour, which gravity holds off its goal."""
    columns = BOTH | {"elbow_flex.pos": lambda t, g, q: np.degrees(g[:, 1] - 0.1)}
    stiff = FOLLOWING.replace('kp="8" kv="0.8"', 'kp="998" kv="2.7"')
    folder = write_logs(tmp_path / "logs", columns, stiff)
    _, model, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    gains = [part["parameters"]["k_p"]["nominal"] for part in model["components"]]
    assert gains == [pytest.approx(0.2 / 0.12, rel=0.1)] * 2
    assert "of joints with the same actuator is" in (folder / "model.yaml").read_text()
    assert "servos of shoulder_pan, elbow_flex?" in words


def random_load(t: np.ndarray, goal: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.abs(np.random.default_rng(0).normal(size=t.size))


EQUALITY = '<equality><joint name="jaws" joint1="elbow_flex"/></equality></mujoco>'
TRUNK = (
    '<body name="trunk"><freejoint/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><body name="upper">'
)
SHUT = {
    "elbow_flex.pos": lambda t, g, q: 0.5 + 0.002 * np.sin(t),
    "elbow_flex.goal": lambda t, g, q: np.full(t.size, 0.5),
}
RESTING = {name: lambda t, g, q: np.full(t.size, 0.5) for name in SHUT}


@pytest.mark.parametrize(
    ("elbow", "robot", "hold", "said"),
    [
        # a gripper that stays shut reports a load without a sign, which is no commanded torque
        (SHUT | {"elbow_flex.effort": random_load}, FOLLOWING, {"elbow_flex": 0.0},
         ("which is held (elbow_flex.pos is about 0.5): its goal stands still",
          "Where do joints stand that no command moves in the logs? elbow_flex at 0")),
        (RESTING, FOLLOWING, {"elbow_flex": 0.0}, ("elbow_flex.pos: stands still in all logs",)),
        (pair("elbow_flex", 1), FOLLOWING.replace("</mujoco>", EQUALITY), {"elbow_flex": 0.0},
         ("which is held because of equality 'jaws'", "Does elbow_flex, which moves in the logs",
          "Where do joints stand that are tied to others? elbow_flex at 0")),
        ({}, ARM.format(actuators="").replace("-1.7 1.7", "0.9 1.7"), {"elbow_flex": 0.9}, ("elbow_flex at 0.9",)),
        (pair("elbow_flex", 1), FOLLOWING.replace('<body name="upper">', TRUNK).replace("</worldbody>",
         "</body></worldbody>"), {"trunk": 0.0}, ("a floating base, so held: trunk at 0",
                                                  "Does the base trunk stand still in all logs")),
    ],
    ids=["shut gripper", "still", "tied", "not at zero", "on a rack"],
)  # fmt: skip
def test_what_no_command_moves_is_held(
    run, tmp_path: Path, elbow: dict, robot: str, hold: dict, said: tuple[str, ...]
) -> None:
    folder = write_logs(tmp_path / "logs", TIME | pair("shoulder_pan", 0) | elbow, robot)
    data, model, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert model["robot"]["hold"] == hold
    if "elbow_flex" in hold:
        assert {one["name"] for one in (*data["inputs"], *data["outputs"])} == {"q_a1", "goal1"}
    assert all(one in words for one in said), words
    assert run("check", folder).code == 0


def test_a_joint_that_swings_is_not_held_whatever_its_logged_goal_does(run, tmp_path: Path) -> None:
    elbow = {
        "elbow_flex.pos": lambda t, g, q: q[:, 1],
        "elbow_flex.goal": lambda t, g, q: np.zeros(t.size),
        "elbow_flex.voltage": lambda t, g, q: 5.0 * (g - q)[:, 1],
    }
    columns = TIME | pair("shoulder_pan", 0) | elbow
    folder = write_logs(tmp_path / "logs", columns, ARM.format(actuators=""))
    data, model, _ = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert "u2" in {one["name"] for one in data["inputs"]} and "hold" not in model["robot"]


@pytest.mark.parametrize("bad", [(0, 1, 2), (1,)])
def test_a_bad_cell_pairs_no_joints_command_with_another_joints_angle(
    run, tmp_path: Path, bad: tuple[int, ...]
) -> None:
    columns = dict(TIME)
    for k, name in enumerate(("shoulder_pan", "elbow_flex")):
        columns[f"{name}.position"] = lambda t, g, q, k=k: q[:, k]
        columns[f"{name}.torque_cmd"] = lambda t, g, q, k=k: (g - q)[:, k]
    folder = write_logs(tmp_path / "logs", columns, ARM.format(actuators=""))
    for seed in bad:
        frame = pd.read_csv(folder / f"run{seed}.csv").astype({"shoulder_pan.position": object})
        frame.loc[50, "shoulder_pan.position"] = "err"
        frame.to_csv(folder / f"run{seed}.csv", index=False)
    data, _, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert "row 52: column 'shoulder_pan.position' holds 'err'" in words
    if len(bad) == 3:  # the elbow alone, with its own torque
        assert columns_of(data)["tau1"] == "elbow_flex.torque_cmd" and len(data["inputs"]) == 1
        assert "Joint 'shoulder_pan' has no angle and no speed in the logs" in words
    else:
        assert len(data["records"]) == 2 and len(data["inputs"]) == 2


def test_a_goal_that_rests_where_the_joint_moves_most_has_the_unit_of_its_place(run, tmp_path: Path) -> None:
    """A joint that is pushed while its goal rests, in degrees; in another log it follows its goal a little."""
    robot = PENDULUM.format(low=-1.9, high=1.9, actuator="")
    for part, push, follow in (("pushed", 0.1, 0.0), ("follows", 0.02, 0.02)):
        columns = TIME | {
            "elbow.pos_rad": lambda t, g, q, push=push: 0.56 + push * q[:, 0],
            "elbow.goal": lambda t, g, q, follow=follow: np.degrees(0.5 + follow * g[:, 0]),
        }
        write_logs(tmp_path / part, columns, robot, logs=2)
    for k in (0, 1):
        (tmp_path / "follows" / f"run{k}.csv").rename(tmp_path / "pushed" / f"run{k + 2}.csv")
    data, *_ = proposed(run, tmp_path / "pushed", "--robot", tmp_path / "arm.xml")
    assert data["inputs"] == [{"name": "goal1", "unit": "deg"}]


def test_a_stamp_that_repeats_is_told_by_its_sample(run, tmp_path: Path, motions) -> None:
    folder = write_csv(tmp_path / "x", motions, MS)
    frame = pd.read_csv(folder / "run2.csv")
    frame.loc[51, "time"] = frame.loc[50, "time"]
    frame.to_csv(folder / "run2.csv", index=False)
    done = run("init", folder)
    assert done.code == 2 and "run2.csv: time 'time' goes from 100 to 100 at sample 52" in done.err


PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="elbow" axis="0 1 0" range="{low} {high}"
 armature="0.01" damping="0.6" frictionloss="0.05"/><inertial mass="0.5" pos="0 0 -0.1" diaginertia="2e-3 2e-3 2e-3"/>
</body></worldbody><actuator>{actuator}</actuator></mujoco>"""


def one_joint(folder: Path, columns: dict, actuator: str = "", high: float = 1.9, logs: int = 3) -> Path:
    """Logs of one joint as functions of time, goal and angle ``(T,)``, and beside their folder the robot."""
    of = {
        name: lambda t, g, q, values=values: values(t, g[:, 0], q[:, 0]) for name, values in columns.items()
    }
    return write_logs(folder, of, PENDULUM.format(low=-1.9, high=high, actuator=actuator), logs)


TORQUE = {"t": lambda t, g, q: t, "torque_cmd": lambda t, g, q: g - q, "pos_rad": lambda t, g, q: q}


@pytest.mark.parametrize(
    ("actuator", "asked", "line"),
    [
        ('<motor joint="elbow" gear="-2"/>', "(-2 at elbow)? ", "gear_ratio: [2]"),
        ('<motor joint="elbow" gear="-2"/>', "A minus turns the joint the other way", ""),
        ('<general joint="elbow" gainprm="12"/>', "multiplies by a gain (12 at elbow): torques, volts,", ""),
        ('<velocity joint="elbow" kv="3"/>', "Are the commands of elbow torques?", ""),
        ('<motor joint="elbow" ctrlrange="-0.1 0.1"/>', "beyond the -0.1 to 0.1 N m that ctrlrange", ""),
    ],
)
def test_what_a_command_is_in_the_robots_file_is_asked(
    run, tmp_path: Path, actuator: str, asked: str, line: str
) -> None:
    folder = one_joint(tmp_path / "logs", TORQUE, actuator)
    _, _, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert asked in words and line in (folder / "model.yaml").read_text()
    told = "arm.xml brakes elbow by the speed (<velocity>, or a back-EMF), which is left out"
    err = run("check", folder).err
    assert (told in err) == ("velocity" in actuator) and ("it is the drive's gear" in err) == (
        "gear=" in actuator
    )


COUNTS = {
    "timestamp": lambda t, g, q: t,
    "goal_position": lambda t, g, q: g,
    "present_position": lambda t, g, q: 2048 + np.round(4096 * q / (2 * np.pi)),
}


def test_counts_from_elsewhere_beside_a_goal_in_radians(run, tmp_path: Path) -> None:
    folder = one_joint(tmp_path / "logs", COUNTS, logs=5)
    data, model, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert data["columns"]["goal1"] == {"column": "goal_position"}
    assert data["columns"]["q_a1"]["zero"] == 2048
    assert [record["role"] for record in data["records"]] == ["train"] * 3 + ["test"] * 2
    assert "sensor" not in str(model) and "zero" in words
    assert run("init", folder, "--out", tmp_path / "alone").code == 0  # without the robot, by the goal alone
    assert written(tmp_path / "alone")[0]["columns"]["q_a1"]["zero"] == 2048
    loaded = Dataset.load(folder)
    assert all(np.max(np.abs(r.outputs["q_a1"] - r.inputs["goal1"])) < 0.5 for r in loaded.records)


@pytest.mark.parametrize(
    ("factor", "step", "asked"), [(100 / 1.9, 1e-9, True), (180 / np.pi, 360 / 4096, False)]
)
def test_percent_of_a_range_is_asked_about(
    run, tmp_path: Path, factor: float, step: float, asked: bool
) -> None:
    columns = {
        "timestamp": COUNTS["timestamp"],
        "elbow.goal": lambda t, g, q: factor * g,
        "elbow.pos": lambda t, g, q: step * np.round(factor * q / step),
    }
    _, _, words = proposed(run, one_joint(tmp_path / "logs", columns), "--robot", tmp_path / "arm.xml")
    assert ("percent" in words.split("are written")[1]) is asked


def test_a_speed_in_no_usual_unit_makes_the_angles_unit_doubtful(run, tmp_path: Path) -> None:
    columns = {
        "time": lambda t, g, q: t,
        "goal_elbow": lambda t, g, q: g / 3.0,
        "position_elbow": lambda t, g, q: q / 3.0,
        "velocity_elbow": lambda t, g, q: 0.43 * 8.0 * (g - q),
    }
    _, _, words = proposed(run, one_joint(tmp_path / "logs", columns), "--robot", tmp_path / "arm.xml")
    assert "unit of q_a1 rad ? " in words and "unit of goal1 rad ? " in words
    assert "In which unit is 'position_elbow'?" in words and "1 of 'velocity_elbow' is 0.775" in words


def test_degrees_of_a_joint_may_be_rad_of_its_motor(run, tmp_path: Path) -> None:
    columns = {"t": TORQUE["t"], "torque_cmd": TORQUE["torque_cmd"], "motor_angle": lambda t, g, q: 40 * q}
    folder = one_joint(tmp_path / "logs", columns)
    _, _, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert "unit of q_m1 deg ? " in words
    assert "Degrees of the joint, or rad of a motor behind its gear: 'motor_angle'?" in words
    (tmp_path / "motor.yaml").write_text("gear_ratio: 40\n")
    options = ("--robot", tmp_path / "arm.xml", "--motor", tmp_path / "motor.yaml", "--force")
    assert "unit of q_m1 rad yes " in proposed(run, folder, *options)[2]


@pytest.mark.parametrize(("kp", "believed"), [(998, False), (5, True)])
def test_gains_that_the_logs_contradict_are_no_start(run, tmp_path: Path, kp: int, believed: bool) -> None:
    folder = one_joint(tmp_path / "logs", COUNTS, f'<position joint="elbow" kp="{kp}" forcerange="-3 3"/>')
    _, model, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    found = model.get("components", [])
    assert ("behind its goal" in words) is not believed and bool(found) is not believed
    if found:  # the angle follows with 1/8 s, the file's damping is 0.6
        assert found[0]["parameters"]["k_p"]["nominal"] == pytest.approx(0.6 * 8, rel=0.15)
        assert found[0]["parameters"]["tau_max"]["nominal"] == 3


def test_records_are_cut_at_an_end_stop(run, tmp_path: Path) -> None:
    farthest = max(float(swing(seed)[2][:, 0].max()) for seed in range(3))
    columns = {"timestamp": COUNTS["timestamp"], "goal": lambda t, g, q: g, "position": lambda t, g, q: q}
    folder = one_joint(tmp_path / "logs", columns, high=0.99 * farthest)
    data, _, words = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert [record for record in data["records"] if "between" in record] and "end stop" in words
    for record in Dataset.load(folder).records:
        assert record.outputs["q_a1"].max() <= 0.9931 * farthest


@pytest.mark.parametrize(
    ("name", "times"),
    [("encoder_rad", 1.0), ("encoder_rad", 50.0), ("joint_angle", 1.0), ("motor_angle", 50.0)],
)
def test_an_encoder_at_the_joint_is_seen_behind_a_known_gear(
    run, tmp_path: Path, name: str, times: float
) -> None:
    (tmp_path / "sheet.yaml").write_text("gear_ratio: 50\n")
    columns = {"t": TORQUE["t"], "torque_cmd": TORQUE["torque_cmd"], name: lambda t, g, q: times * q}
    folder = one_joint(tmp_path / "logs", columns)
    options = ("--robot", tmp_path / "arm.xml", "--motor", tmp_path / "sheet.yaml")
    outputs = proposed(run, folder, *options)[0]["outputs"]
    assert outputs == [{"name": "q_m1" if times > 1 else "q_a1", "unit": "rad"}]


def test_a_ratio_is_that_of_the_joint_which_moves(run, tmp_path: Path) -> None:
    """A joint without a command has no number: the one ratio is the elbow's, whose encoder is at its joint."""
    (tmp_path / "sheet.yaml").write_text("gear_ratio: [20]\n")
    columns = TIME | {
        "shoulder_pan.pos_rad": lambda t, g, q: 1e-3 * np.random.default_rng(0).standard_normal(t.size),
        "elbow_flex.pos_rad": lambda t, g, q: q[:, 1],
        "elbow_flex.torque_cmd": lambda t, g, q: (g - q)[:, 1],
    }
    folder = write_logs(tmp_path / "logs", columns, ARM.format(actuators=""))
    options = ("--robot", tmp_path / "arm.xml", "--motor", tmp_path / "sheet.yaml")
    data, model, words = proposed(run, folder, *options)
    assert data["outputs"] == [{"name": "q_a1", "unit": "rad"}] and model["gear_ratio"] == [20.0]
    assert "q_a1" in words and "q_m2" not in words


def test_a_joint_that_moves_in_one_of_many_logs_is_found(run, tmp_path: Path, motions) -> None:
    t, u, q = motions[0]
    folder = write_csv(tmp_path / "x", [(t, u * (k == 9), q * (k == 9)) for k in range(10)], MS, records=10)
    done = run("init", folder)
    assert "stands still" not in done.out + done.err and "has no usable pair" not in done.err


def test_a_lerobot_dataset(run, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM.format(actuators=ACTUATORS))
    folder, names = tmp_path / "lerobot", ["shoulder_pan.pos", "elbow_flex.pos"]
    motions = (swing(seed) for seed in range(3))
    episodes = [(t, np.degrees(angle), np.degrees(goal)) for t, goal, angle in motions]
    write_lerobot(folder, episodes, {"observation.state": names, "action": names})
    data, *_ = proposed(run, folder, "--robot", tmp_path / "arm.xml")
    assert data["format"] == "lerobot" and [one["episode"] for one in data["records"]] == [0, 1, 2]
    assert data["columns"]["q_a2"]["column"] == "observation.state/elbow_flex.pos"
    assert data["columns"]["goal1"]["column"] == "action/shoulder_pan.pos"
    assert run("check", folder).code == 0


def test_a_log_in_which_nothing_moves_is_left_out(run, tmp_path: Path, motions) -> None:
    rest = (motions[0][0], motions[0][1], np.full_like(motions[0][2], 0.25))
    folder = write_csv(tmp_path / "logs", [motions[0], rest, motions[2]], MS)
    proposed(run, folder)
    assert [one["file"] for one in written(folder)[0]["records"]] == ["run1.csv", "run3.csv"]
    assert "run2.csv: no angle and no speed moves in it" in (folder / "dataset.yaml").read_text()


def test_a_bag_of_joint_states_and_a_command(run, tmp_path: Path, motions) -> None:
    pytest.importorskip("rosbags")
    from bags import array, joint_state, write_bag

    messages = []
    for time, volts, angle in zip(*motions[0], strict=True):
        stamp = round(1e9 * (time + 10.0))
        messages.append(("/joint_states", stamp, joint_state(stamp, {"elbow": angle}, velocity=False)))
        messages.append(("/voltage/command", stamp, array([volts])))
    (tmp_path / "logs").mkdir()
    write_bag(tmp_path / "logs" / "run1", messages)
    assert columns_of(proposed(run, tmp_path / "logs")[0]) == {
        "t": "/joint_states", "u1": "/voltage/command/data/0", "q_m1": "/joint_states/position/elbow",
    }  # fmt: skip


def test_logs_of_a_servo_bench_keep_their_switch(run, tmp_path: Path, motions) -> None:
    """Their columns have this package's names; a switch that is thrown is a channel, for it opens the terminals."""
    (tmp_path / "logs").mkdir()
    for k, (t, u, q) in enumerate(motions):
        on = (t > 0.1) & (k > 0)
        rows = zip(t.tolist(), u.tolist(), q.tolist(), on.tolist(), strict=True)
        entries = [
            {"timestamp": a, "load": round(885 * b / 12) % 65536, "input_volts": 12.0, "position": c,
             "torque_enable": d, "goal_position": 0.0}
            for a, b, c, d in rows
        ]  # fmt: skip
        (tmp_path / "logs" / f"run{k}.json").write_text(json.dumps({"kp": 8, "entries": entries}))
    (tmp_path / "logs" / "notes.json").write_text("{}")
    words = f"'hybrid-id init {tmp_path / 'logs'}' writes one for its logs"
    assert words in run("check", tmp_path / "logs").err
    data, model, words = proposed(run, tmp_path / "logs")
    assert [one["name"] for one in data["inputs"]] == ["duty1", "supply1", "enable1"]
    assert [one["file"] for one in data["records"]] == ["run0.json", "run1.json", "run2.json"]
    assert model["components"][0]["kind"] == "duty_supply" and "notes.json is no BAM log" in words
    assert run("check", tmp_path / "logs").code == 0


def test_a_log_in_place_of_a_dataset_is_sent_to_init(run, tmp_path: Path, motions) -> None:
    log = write_csv(tmp_path / "logs", motions, MS) / "run1.csv"
    done = run("check", log)
    assert done.code == 2 and f"is a log and no dataset; 'hybrid-id init {log}'" in done.err

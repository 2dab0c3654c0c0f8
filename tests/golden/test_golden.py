"""Numbers of the program's own records and commands, as they were when they were locked, and how far each may move.

`numbers.json` holds a value and a tolerance for every key of every case. What changes a number on purpose writes the
file anew, ``HYBRID_ID_GOLDEN=write python -m pytest tests/golden``, and says why in its commit. Estimates may move by a
twentieth of their standard error (what an optimizer leaves open), other numbers by a thousandth unless said otherwise.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servo_arm import described, records_of
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from hybrid_id import Backlash, Channel, Dataset, Record, Stribeck, one_link, replay, save_model
from hybrid_id.cli.app import app
from hybrid_id.components import Cogging
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.motor.torque_motor import TorqueMotor
from hybrid_id.components.transmission.flexibility import JointFlexibility

NUMBERS = Path(__file__).with_name("numbers.json")
ESTIMATE, OTHER = 0.05, 1e-3
"""Tolerances: of an estimate, in standard errors; of any other number, relative."""


def command(*words: object) -> dict[str, Any]:
    """What a command prints as JSON."""
    shown = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert shown.exit_code == 0, shown.output[-2000:]
    return json.loads(shown.stdout)


def equal(case: str, numbers: Mapping[str, float | tuple[float, float]], relative: float = OTHER) -> None:
    """Compare numbers, each with its absolute tolerance or the relative one, with what is locked."""
    assert numbers
    locked = json.loads(NUMBERS.read_text(encoding="utf-8")) if NUMBERS.exists() else {}
    pairs = {
        key: number if isinstance(number, tuple) else (float(number), relative * abs(float(number)))
        for key, number in numbers.items()
    }
    if os.environ.get("HYBRID_ID_GOLDEN") == "write":
        locked[case] = {key: f"{value:.9g} ± {tolerance:.2g}" for key, (value, tolerance) in pairs.items()}
        text = json.dumps(locked, indent=1, sort_keys=True, ensure_ascii=False)
        NUMBERS.write_text(text + "\n", encoding="utf-8")
        return
    assert set(locked[case]) == set(pairs)
    moved = {}
    for key, words in locked[case].items():
        value, tolerance = map(float, words.split("±"))
        if not abs(pairs[key][0] - value) <= tolerance + 1e-12:
            moved[key] = f"{pairs[key][0]:.9g} now, {words} locked"
    assert not moved, f"{case}: {moved}"


def estimates(result: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Values of all sets of a `result.json`, and the standard errors that they claim."""
    numbers = {}
    for fitted in result["sets"]:
        errors = [e or 1e-4 * abs(v) for e, v in zip(fitted["std_error"], fitted["values"], strict=True)]
        for name, value, error in zip(result["parameters"], fitted["values"], errors, strict=True):
            numbers[f"{fitted['set']}/{name}"] = (value, ESTIMATE * error)
            numbers[f"{fitted['set']}/{name}/std_error"] = (error, 0.02 * error)
    return numbers


def errors(result: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Normalised errors on the test records of a `result.json`; they follow the estimates."""
    return {f"nrmse/{name}": (value, 0.01 * value) for name, value in result["test_nrmse"].items()}


def scalars(folder: Path) -> dict[str, tuple[float, float]]:
    """First and last value of every scalar that TensorBoard shows of a run, by run and tag."""
    numbers = {}
    for file in sorted(folder.rglob("events.out.tfevents.*")):
        read = EventAccumulator(str(file))
        read.Reload()
        run = file.parent.relative_to(folder)
        for tag in read.Tags()["scalars"]:
            values = [event.value for event in read.Scalars(tag)]
            numbers[f"{run}:{tag}"] = (values[-1], 0.01 * abs(values[-1]) + 1e-9)
    assert numbers
    return numbers


def data_of(
    system, signals, *, noise=0.01, step=0.004, outputs=("q_m1",), units=("V", "rad"), name="u1"
) -> Dataset:
    """Records that a system answers to signals with, noise of a seed added; the last is a test record."""
    inputs = (Channel(name, units[0]),)
    channels = tuple(Channel(output, units[1], noise) for output in outputs)
    generator, records = np.random.default_rng(8), []
    for k, signal in enumerate(signals):
        t = step * np.arange(signal.size)
        blank = Record(f"run_{k}", t, {name: signal}, {output: 0 * t for output in outputs})
        (run,) = replay(Dataset("blank", inputs, channels, (blank,)), system)
        noisy = {o: run.outputs[o] + noise * generator.standard_normal(t.size) for o in outputs}
        records.append(replace(blank, outputs=noisy, role="test" if k == len(signals) - 1 else "train"))
    return Dataset("golden", inputs, channels, tuple(records), step)


def tones(
    amplitude: float, count: int, samples: int = 600, step: float = 0.004, slow: float = 1.0
) -> list[np.ndarray]:
    """Signals of three tones after a rest of 0.1 s."""
    t = step * np.arange(samples)
    waves = [
        sum(np.sin(slow * f * (1 + 0.1 * k) * (t - 0.1)) for f in (3.1, 7.7, 17.3)) for k in range(count)
    ]
    return [np.where(t < 0.1, 0.0, 0.5 * amplitude * wave) for wave in waves]


def study(folder: Path, dataset: Dataset, model, **sections: Any) -> Path:
    """A folder of records with a model and a study file."""
    dataset.save(folder / "data")
    save_model(model, folder / "data" / "model.yaml")
    (folder / "study.yaml").write_text(json.dumps({"dataset": str(folder / "data"), **sections}))
    return folder / "study.yaml"


def test_demo_and_what_follows_from_it(tmp_path) -> None:
    pytest.importorskip("mujoco")
    home, data = tmp_path / "demo", tmp_path / "demo" / "data"
    result = command("demo", "--out", home)
    equal("demo", {**estimates(result), **errors(result)})
    equal("demo on TensorBoard", scalars(home / "tensorboard"))

    found = command("check", data, "--model", data / "model.yaml")["identifiability"]
    numbers = {f"std/{c['text']}": c["relative_std"] for c in found["combinations"]}
    numbers |= {
        f"direction/{k}/{n}": d
        for k, one in enumerate(found["directions"])
        for n, d in one["relative"].items()
    }
    equal("check", {key: (value, OTHER * abs(value) + 1e-6) for key, value in numbers.items()})

    models = "--model", data / "model.yaml", "--model", home / "model.yaml"
    found = command("compare", data, *models, "--out", tmp_path / "compared")["models"]
    equal("compare", {
        f"{model}/{record}": (run["nrmse"]["q_m1"], 0.01 * run["nrmse"]["q_m1"])
        for model, runs in found.items() for record, run in runs.items()
    })  # fmt: skip

    found = command("export", home, "--to", "ranges", "--out", tmp_path / "ranges.json")["parameters"]
    bounds = {(name, end): found[name][end] for name in found for end in ("lower", "upper")}
    equal("export to ranges", {f"{name}/{end}": (b, 0.01 * abs(b)) for (name, end), b in bounds.items()})
    exported = command("export", home, "--to", "mjcf", "--out", tmp_path / "drive.xml", "--check", data)[
        "in_mujoco"
    ]
    there = {model: run["nrmse"] for model, run in exported["models"].items()}
    equal("export to MJCF", {model: (error, 0.02 * error) for model, error in there.items()})


def test_robot_demo(tmp_path) -> None:
    pytest.importorskip("mujoco")
    result = command("demo", "--robot", "--out", tmp_path / "robot")
    equal("robot demo", {**estimates(result), **errors(result)})


def test_paper_in_short(tmp_path) -> None:
    command("reproduce", "--quick", "--out", tmp_path / "paper")
    for stage in ("link1", "link1_flexible", "link2_high", "link2_low", "both_links"):
        result = json.loads((tmp_path / "paper" / "parts" / f"{stage}.json").read_text())["result"]
        numbers = {}
        for kind in ("values", "truths"):
            for k, row in enumerate(result[kind]):
                numbers |= {
                    f"{k}/{name}/{kind}": value for name, value in zip(result["names"], row, strict=True)
                }
        equal(f"paper, {stage}", {key: (value, 0.005 * abs(value)) for key, value in numbers.items()})
    for case in ("one_link", "backlash", "both_links"):
        result = json.loads((tmp_path / "paper" / "parts" / f"tracking_{case}.json").read_text())["result"]
        rms = {
            f"{key}/{k}": value
            for key in result
            for k, value in enumerate(np.ravel(result[key]))
            if key in ("rms", "peak")
        }
        equal(f"paper, tracking {case}", {key: (value, 0.01 * abs(value)) for key, value in rms.items()})


def held(system, *names: str):
    """The system with some parameters known."""
    return system.with_specs({name: replace(system.parameter(name).spec, estimate=False) for name in names})


DRIVE = one_link(50.0).with_values({"J": 2.1e-5, "F_c": 0.008, "F_v": 5e-5})
START = held(DRIVE, "P_m1", "P_m2").with_values({"J": 2.6e-5, "F_c": 0.012, "F_v": 8e-5})


def test_voltage_drive_and_what_it_lacks(tmp_path) -> None:
    machine = DRIVE.with_component("joint1/motor_friction", Stribeck(F_drop=0.006, v_s=15.0))
    given = study(tmp_path, data_of(machine, tones(2.5, 4)), START)
    result = command("identify", given, "--out", tmp_path / "identified")
    equal("voltage drive", {**estimates(result), **errors(result)})
    found = command("diagnose", given, "--out", tmp_path / "diagnosed", "--jobs", 1)
    assert found["verdict"] == "effects"
    (named,) = [effect for effect in found["effects"] if effect["selected"]]
    assert (named["name"], named["where"]) == ("stribeck_friction", "joint1/motor_friction")
    assert named["probability"] > 0.9
    size, error = named["parameters"]["F_drop"]
    gap = {f"gap/{key}": found["gap"][key] for key in ("nominal", "refit", "with_effect", "noise_floor")}
    equal("voltage drive, diagnosed", {"F_drop": (size, 2 * error), **gap}, relative=0.05)


def test_voltage_drive_with_play(tmp_path) -> None:
    machine = one_link(50.0, vertical=True).with_values({"J": 3e-5, "F_c": 0.006, "F_v": 5e-5, "G_l": 1.5})
    machine = machine.with_component("joint1/transmission", Backlash(gap=0.02))
    given = study(
        tmp_path,
        data_of(machine, tones(3.0, 3), outputs=("q_m1", "q_a1"), noise=0.002),
        held(machine, "P_m1", "P_m2").with_values({"J": 2.5e-5, "F_c": 0.008}),
    )
    result = command("identify", given, "--out", tmp_path / "identified")
    equal("voltage drive with play", {**estimates(result), **errors(result)})


def test_servo(tmp_path) -> None:
    loop = PositionServo(k_p=40.0, k_d=0.5, tau_max=6.0)
    machine = one_link(1.0).with_component("joint1/input", loop).with_component("joint1/motor", TorqueMotor())
    machine = held(machine, "k_t").with_values({"J": 0.2, "F_c": 0.4, "F_v": 0.8})
    data = data_of(
        machine, [0.1 * goal for goal in tones(2.0, 4, slow=0.5)],
        name="goal1", units=("rad", "rad"), noise=5e-4,
    )  # fmt: skip
    given = study(tmp_path, data, machine.with_values({"J": 0.25, "F_c": 0.6, "k_p": 40.0}))
    result = command("identify", given, "--out", tmp_path / "identified")
    equal("servo", {**estimates(result), **errors(result)})


def test_arm_with_a_flexible_joint(tmp_path) -> None:
    pytest.importorskip("mujoco")
    arm = described(tmp_path)
    machine = arm.with_component("joint2/transmission", JointFlexibility(compliance=0.02))
    start = machine.with_values({"compliance": 0.03})
    given = study(tmp_path / "study", records_of(machine, 3), start, identification={"pooled": True})
    result = command("identify", given, "--out", tmp_path / "identified")
    equal("arm with a flexible joint", {**estimates(result), **errors(result)})


def without_cogging(folder: Path, **sections: Any) -> Path:
    """A study of a drive with cogging, by a model that lacks it."""
    model = held(DRIVE, "P_m1", "P_m2")
    machine = model.with_component("joint1/motor", Cogging(T_c=0.0, T_s=2.5e-3, n=3.0))
    data = data_of(machine, tones(1.5, 4, samples=160), noise=0.02)
    return study(folder, data, model.with_values({"J": 2.6e-5, "F_c": 0.006}), **sections)


HYBRID = {
    "networks": [{"place": "joint1/motor", "inputs": ["sin 3", "cos 3"], "hidden": [4]}],
    "windows": [], "price": 1.0, "max_iterations": 8,
}  # fmt: skip


def test_training_with_an_effect_withheld(tmp_path) -> None:
    given = without_cogging(tmp_path, training={"width": 1.0, "fine": 6}, hybrid=HYBRID)
    found = command("train", given, "--out", tmp_path / "hybrid")
    assert not found["physics_alone"]
    numbers = {}
    for name, p in found["parameters"].items():
        numbers[f"{name}/physics"] = (p["physics"], ESTIMATE * p["physics_std_error"])
        numbers[f"{name}/hybrid"] = (p["hybrid"], p["hybrid_std_error"])
    for record, error in found["weighted_error"].items():
        numbers[f"{record}/physics"] = (error["physics"], 0.01 * error["physics"])
        numbers[f"{record}/hybrid"] = (error["hybrid"], 0.25 * error["hybrid"])
    equal("effect withheld", numbers)
    tags = {name.partition(":")[2] for name in scalars(tmp_path / "hybrid" / "tensorboard")}
    wanted = {"loss/train", "loss/validation", "gradient/norm", "fit/q_m1", "residual/share_r_motor1"}
    assert tags >= wanted | {f"parameters/joint1/{name}" for name in found["parameters"]}


def test_ablation(tmp_path) -> None:
    plan = {"residual": ["static"], "seeds": 2}
    given = without_cogging(tmp_path, training={"width": 1.0, "fine": 6}, hybrid=HYBRID, ablation=plan)
    found = command("ablate", given, "--out", tmp_path / "ablation")
    physics, hybrid = (arm["weighted_error"]["test"] for arm in found["arms"])
    splits = {
        f"{seed}/{role}/{name}": 1.0
        for seed, split in found["splits"].items()
        for role in split
        for name in split[role]
    }
    errors = {f"{k}/physics": (error, 0.01 * error) for k, error in enumerate(physics)}
    errors |= {f"{k}/hybrid": (error, 0.25 * error) for k, error in enumerate(hybrid)}
    equal("ablation", {**splits, **errors})


def test_adjoint_ends_where_least_squares_ends(tmp_path) -> None:
    given = study(
        tmp_path, data_of(DRIVE, tones(2.5, 2)), START,
        identification={"friction": "smooth", "width": 2.0, "substeps": 4, "pooled": True},
        training={"width": 2.0, "windows": []}, output={"figures": False, "report": False},
    )  # fmt: skip
    fitted = command("identify", given, "--out", tmp_path / "fitted")
    trained = command("train", given, "--out", tmp_path / "trained")
    locked = estimates(fitted)
    equal("adjoint = least squares", {key: (value, 4 * off) for key, (value, off) in locked.items()})
    for key, (value, _) in estimates(trained).items():
        assert abs(value - locked[key][0]) <= 4 * locked[key][1] * (1 if "std_error" not in key else 3), key

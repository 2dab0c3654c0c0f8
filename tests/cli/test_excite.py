"""`excite` on a model with a flexible gear, and on a robot."""

import json
from pathlib import Path

import numpy as np
import pytest
from drives import flexible_drive

from hybrid_id.systems.model_file import save_model


def test_it_says_which_part_of_the_band_it_takes(run, tmp_path: Path) -> None:
    save_model(flexible_drive(), tmp_path / "model.yaml", tmp_path)
    asked = f"excite --band 0.5 8 --tones 4 --duration 4 --starts 2 --amplitude 8 --out {tmp_path / 'u.csv'}"
    found = run(*f"{asked} --model {tmp_path / 'model.yaml'} --gear most".split())
    assert "the gear's deflection is" in found.out and "the largest of" in found.out
    made = json.loads((tmp_path / "u.json").read_text())
    assert made["band"] == made["gear_shares"][0]["band"]


@pytest.mark.parametrize("option", ["--gear most", "--speed 3"])
def test_options_that_need_a_model(run, tmp_path: Path, option: str) -> None:
    found = run(*f"excite {option} --out {tmp_path / 'u.csv'}".split())
    assert found.code == 2 and "--model" in found.err
    assert not list(tmp_path.iterdir())


ARM = """<mujoco><worldbody><body><joint name="swing" axis="0 1 0" range="-60 60" armature="0.02"/>
<inertial mass="0.4" pos="0.1 0 0" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> str:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\n")
    files = f"--model {tmp_path / 'model.yaml'} --out {tmp_path / 'u.csv'}"
    return f"excite {files} --tones 4 --starts 2 --sample-time 0.01"


def test_goals_of_a_robot(run, arm: str, tmp_path: Path) -> None:
    found = run(*f"{arm} --speed swing=3 --torque 2".split())
    assert found.code == 0 and "condition number" in found.out
    table = np.genfromtxt(tmp_path / "u.csv", delimiter=",", names=True)
    assert table.dtype.names == ("t", "goal1")
    made = json.loads((tmp_path / "u.json").read_text())
    assert made["joints"][0]["joint"] == "swing" and made["joints"][0]["peak_torque"] <= 0.9 * 2 + 1e-9
    assert np.abs(table["goal1"]).max() <= 0.9 * np.pi / 3


def test_a_short_signal_takes_the_tones_that_it_holds(run, arm: str, tmp_path: Path) -> None:
    short = arm.replace("--tones 4", "--duration 5") + " --speed 3 --torque 2"
    found = run(*short.split())
    assert found.code == 0, found.err
    assert "10 tones from 0.2 to 2 Hz" in found.out
    assert json.loads((tmp_path / "u.json").read_text())["tones"] == 10
    asked = run(*short.split(), "--tones", "20", "--force")
    assert asked.code == 2 and "fewer than 20 tones" in asked.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "'swing' has no largest speed"),
        ("", "--speed swing=VALUE, or one for all joints as --speed VALUE"),
        ("--speed 3", "'swing' has no largest torque"),
        ("--speed swim=3", "no joint 'swim'"),
        ("--speed fast", "'fast' is no number above 0"),
        ("--speed 3 --torque 2 --share 2", "--share"),
        ("--speed 3 --torque 2 --amplitude 2", "--amplitude"),
    ],
)
def test_what_no_motion_can_be_designed_with(run, arm: str, tmp_path: Path, options: str, words: str) -> None:
    found = run(*f"{arm} {options}".split())
    assert found.code == 2 and words in found.err
    assert not (tmp_path / "u.csv").exists()

"""A law is one file: laid into a copy of the package, it is fitted, suspected, exported and listed."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hybrid_id

LAW = '''
"""Friction of a film that is sheared by thermal activation."""

import torch

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Eyring(Friction):
    """``tau = F_e asinh(v / v_e)`` with F_e [N m], v_e [rad/s]; source: H. Eyring, J. Chem. Phys. 4, 1936."""

    kind = "eyring_friction"
    F_e = Parameter(1e-3, upper=1e3, unit="N m", doc="size")
    v_e = Parameter(1.0, lower=1e-3, upper=1e4, unit="rad/s", doc="speed from which it grows by the logarithm")
    effect = Effect(
        "eyring_friction",
        "grease that shears by thermal activation; usually below 10 % of the rated torque",
        "H. Eyring, Viscosity, plasticity, and diffusion as examples of absolute reaction rates, J. Chem. Phys. 4(4), "
        "1936",
        {"viscous_friction": "steady speeds up to the top: viscous friction grows evenly, this one ever less"},
    )

    def smooth(self, p, speed):
        return p.F_e * torch.asinh(speed / p.v_e)

    @staticmethod
    def starts(site):
        size, speed = 0.1 * site.torque * site.gearing, 0.1 * site.speed / site.gearing
        return [{"F_e": free(size, 0.0, 100.0 * size), "v_e": free(speed, 0.01 * speed, 10.0 * speed)}]
'''
USE = """
import json

from gapcase import small_case
from typer.testing import CliRunner

from hybrid_id.cli.app import app
from hybrid_id.components import CATALOGUE, Eyring
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.systems.model_file import load_model, save_model

listed = json.loads(CliRunner().invoke(app, ["effects", "--json"]).output)["effects"]
kinds = json.loads(CliRunner().invoke(app, ["components", "--json"]).output)["components"]
for name in set(CATALOGUE) - {"eyring_friction", "spring_load", "quadratic_drag"}:  # a short search
    del CATALOGUE[name]
truth = Eyring(F_e=0.01, v_e=2.0)
found = diagnose(*small_case(truth, "joint1/motor_friction"), max_effects=1)
save_model(found.model, "model.yaml")
exported = to_mjcf(load_model("model.yaml"))
print(json.dumps({
    "listed": next(one for one in listed if one["effect"] == "eyring_friction"),
    "component": next(one for one in kinds if one["kind"] == "eyring_friction"),
    "verdict": found.verdict,
    "selected": [(one.name, one.where) for one in found.selected],
    "F_e": found.selected[0].parameters["F_e"][0],
    "mjcf": exported.text,
}))
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What the package says of the law, once its file lies there."""
    home = tmp_path_factory.mktemp("package")
    package, tests = Path(hybrid_id.__file__).parent, Path(__file__).parents[1]
    shutil.copytree(package, home / "hybrid_id", ignore=shutil.ignore_patterns("__pycache__"))
    (home / "hybrid_id/components/friction/eyring.py").write_text(LAW.lstrip(), encoding="utf-8")
    where = os.pathsep.join([str(home), str(tests)])
    run = subprocess.run(
        [sys.executable, "-c", USE],
        capture_output=True,
        text=True,
        cwd=home,
        env={**os.environ, "PYTHONPATH": where},
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


def test_it_is_listed(said: dict) -> None:
    assert said["listed"]["where"] == "motor_friction, link_friction"
    assert said["listed"]["about"].startswith("grease")
    assert set(said["listed"]["mistaken_for"]) == {"viscous_friction"}
    assert said["component"]["parameters"] == "F_e [N m], v_e [rad/s]"


def test_it_is_suspected_and_fitted(said: dict) -> None:
    assert said["verdict"] == "effects"
    assert said["selected"] == [["eyring_friction", "joint1/motor_friction"]]
    assert said["F_e"] == pytest.approx(0.01, rel=0.3)


def test_it_is_exported(said: dict) -> None:
    assert "up to" in said["mjcf"], "how far MuJoCo's friction is off its curve"
    assert 'damping="' in said["mjcf"]

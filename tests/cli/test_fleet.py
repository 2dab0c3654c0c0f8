"""`fleet`: results, what is kept, and what is refused."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import look_at
from drives import make_records, multisine, rigid_drive

from hybrid_id import one_link
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.study import fleet as fleets
from hybrid_id.study.fleet import FleetStudy, RobotFit
from hybrid_id.systems.model_file import load_model, save_model

HEAVY = "robot_4"
ROBOTS = 6


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six robots with two short records each; the fourth has half as much inertia again."""
    folder, random = tmp_path_factory.mktemp("fleet"), np.random.default_rng(4)
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01),)
    truth = rigid_drive()
    for k in range(1, ROBOTS + 1):
        factors = {name: np.exp(0.02 * random.standard_normal()) for name in ("J", "F_c", "F_v")}
        factors["J"] *= 1.5 if f"robot_{k}" == HEAVY else 1.0
        own = truth.with_values({name: f * truth.parameter(name).spec.value for name, f in factors.items()})
        voltages = [multisine(seed, samples=400, amplitude=6.0 + seed) for seed in range(2)]
        records = make_records(own, voltages, noise={"q_m1": 0.01}, seeds=[10 * k, 10 * k + 1])
        Dataset(f"drive {k}", *channels, tuple(records), 0.002).save(folder / f"robot_{k}")
    start = truth.with_values({"J": 2.4e-5, "F_c": 0.008, "F_v": 6e-5})
    held = {name: replace(start.parameter(name).spec, estimate=False) for name in ("P_m1", "P_m2")}
    save_model(start.with_specs(held), folder / "model.yaml")
    return folder


@pytest.fixture(scope="module")
def result(robots: Path, run: type, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("result") / "fleet"
    said = run("fleet", robots, "--out", out)
    assert said.code == 0
    assert f"{HEAVY} stands out" in said.out and "above the fleet's mean" in " ".join(said.out.split())
    return out


def test_the_odd_robot_and_its_reason_are_in_all_files(result: Path, tmp_path: Path) -> None:
    found = json.loads((result / "fleet.json").read_text())
    (odd,) = found["odd"]
    assert odd["robot"] == HEAVY and odd["parameters"] == ["J"] and "inertia" in odd["why"][0]
    assert len(found["by_robot"]) == ROBOTS and found["parameters"]["J"]["spread"] < 3e-6
    with (result / "robots.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == ROBOTS * len(found["parameters"])
    assert [row["robot"] for row in rows if row["odd"] == "1"] == [HEAVY]
    assert sorted(path.name for path in (result / "robots").iterdir()) == [
        f"robot_{k}.json" for k in range(1, 7)
    ]
    text = (result / "report.html").read_text()
    assert HEAVY in text and "Who stands out" in text
    look_at(result / "report.html", tmp_path, figures=1)
    spec, inertia = load_model(result / "model.yaml").parameter("J").spec, found["parameters"]["J"]
    assert spec.value == spec.prior_mean == pytest.approx(inertia["mean"])  # expects one more robot
    assert spec.prior_std is not None and spec.prior_std >= inertia["spread"]


def test_a_parameter_that_is_zero_in_all_robots_is_expected_to_be_small() -> None:
    """And one that the model's prior holds keeps the value that the others' means belong to, with that prior."""
    drive = one_link(50.0)
    specs = {i.name: replace(i.spec, estimate=i.name in ("F_v", "P_m1")) for i in drive.table}
    specs["P_m1"] = replace(specs["P_m1"], prior_std=1e-5)
    system = drive.with_specs(specs)
    names = [system.table[k].name for k in system.estimated]
    at = {"P_m1": 1.001 * system.parameter("P_m1").spec.value, "F_v": 0.0}
    hessian, errors = (
        np.diag([sizes[name] for name in names]).tolist()
        for sizes in ({"P_m1": 1.0, "F_v": 1e14}, {"P_m1": 0.0, "F_v": 1e-14})
    )
    values = [at[name] for name in names]
    robots = [RobotFit(f"r{k}", ["a"], [values], [hessian], [errors], 1.0) for k in range(3)]
    expected = FleetStudy(system, tuple(robots), {}).fleet_model()
    assert expected.parameter("P_m1").spec.value == at["P_m1"]
    assert expected.parameter("P_m1").spec.prior_std == 1e-5
    friction = expected.parameter("F_v").spec
    assert friction.prior_mean == 0.0 and friction.prior_std is not None
    assert 0.0 < friction.value == friction.prior_std < 1e-6


def test_ctrl_c_keeps_what_is_done(
    robots: Path, run: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = fleets.fit_robot

    def stops(task: tuple, one: Dataset) -> fleets.RobotFit:
        if one.name == "robot_3":
            raise KeyboardInterrupt
        return fit(task, one)

    monkeypatch.setattr(fleets, "fit_robot", stops)
    said = run("fleet", robots, "--out", tmp_path / "fleet")
    assert (
        said.code == 130 and "2 of 6 robots are kept" in said.err and "the same command goes on" in said.err
    )
    assert not (tmp_path / "fleet" / "fleet.json").exists()


def test_wrong_folders_are_refused_in_a_sentence(robots: Path, run: type, tmp_path: Path) -> None:
    def copy(name: str, but: str = "robot_6") -> Path:
        shutil.copytree(robots, tmp_path / name, ignore=shutil.ignore_patterns(but))
        return tmp_path / name

    few = copy("few", "robot_[3-6]")
    bare = copy("bare", "model.yaml")
    for name in (long := "r" * 220, odd := "a\x1b[31m"):
        shutil.copytree(robots / "robot_6", copy(f"named {len(name)}") / name)
    (copy("linked") / "robot_7").symlink_to(robots / "robot_1")
    file = copy("other") / "robot_2" / "dataset.yaml"
    file.write_text(file.read_text().replace("q_m1", "q_a1"))
    for source, words in (
        (few, "holds 2 dataset folders"),
        (tmp_path / "none", "is no folder"),
        (bare, "does not exist; name the model of all robots with --model"),
        (tmp_path / f"named {len(long)}", "has a name of more than 200 signs"),
        (tmp_path / f"named {len(odd)}", "rename it"),
        (tmp_path / "linked", "put the folder itself there"),
        (tmp_path / "other", "q_a1"),
    ):
        said = run("fleet", source, "--out", tmp_path / "out")
        assert said.code == 2 and words in " ".join(said.err.split()) and "\x1b" not in said.err
        assert not (tmp_path / "out").exists()


def test_results_of_other_robots_are_not_overwritten(
    robots: Path, result: Path, run: type, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(result, out)
    found = json.loads((out / "fleet.json").read_text())
    (out / "fleet.json").write_text(json.dumps(found | {"robots": ["another"]}))
    said = run("fleet", robots, "--out", out)
    assert said.code == 2 and "holds a fleet of other robots" in said.err

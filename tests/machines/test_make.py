"""Case folders of all kinds: the format, the answers, repeatability by seed, and what is refused."""

import errno
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hybrid_id.errors import InputError
from hybrid_id.machines import arm, draw, draw_arm
from hybrid_id.machines import experiments as plans
from hybrid_id.machines import make as making
from hybrid_id.machines.make import family_and_level, make_case, make_cases
from hybrid_id.records.dataset import Dataset
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.model_file import load_model


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short records, and arms of two joints."""
    monkeypatch.setattr(plans, "LENGTHS", (700, 900))
    monkeypatch.setattr(draw, "LENGTHS", (600, 800))
    monkeypatch.setattr(arm, "JOINTS", (2, 2))
    monkeypatch.setattr(draw_arm, "LENGTH", 1.5)


def answers_of(case: Path) -> dict[str, Any]:
    return yaml.safe_load((case.parent / "answers" / f"{case.name}.yaml").read_text())


def test_clean_case_has_the_format_that_the_package_reads(tmp_path: Path) -> None:
    case = make_case(7, tmp_path, effect="stribeck_friction", system="one_link", level="strong")
    data, model, answers = Dataset.load(case), load_model(case / "model.yaml"), answers_of(case)
    assert (len(data.train), len(data.test), data.sample_time, model.name) == (6, 2, 0.002, "one_link")
    assert {channel.name for channel in data.outputs} == {"q_m1"} and data.test[0].note
    assert (answers["family"], answers["level"]) == ("single", "strong")
    (effect,) = answers["effects"]
    assert effect["name"] == "stribeck_friction" and "stribeck_friction" in effect["accept"]
    assert {"joint1/motor_friction", "joint1/link_friction"} <= set(effect["accept_where"])
    oracle = answers["oracle"]
    assert oracle["refit"] > 3 * oracle["noise_floor"] and oracle["with_effect"] == oracle["noise_floor"]
    assert sorted(path.name for path in case.parent.iterdir()) == ["answers", case.name]
    for record in data:  # at rest and without voltage for a tenth of a second
        start = record.signal("q_m1")[:50]
        assert np.all(record.signal("u1")[:50] == 0)
        assert abs(np.mean(start[:25]) - np.mean(start[25:])) < np.std(start)


@pytest.mark.parametrize("family", ["none", "parameters"])
def test_sound_case_is_re_fitted_to_its_noise_floor(family: str, tmp_path: Path) -> None:
    """In one the simulator is right as it stands, in the other its values are wrong."""
    answers = answers_of(make_case(4, tmp_path, family=family, system="one_link"))
    assert answers["effects"] == [] and answers["level"] == "none"
    oracle = answers["oracle"]
    assert oracle["refit"] < 1.1 * oracle["noise_floor"]
    if family == "none":
        assert 0.9 * oracle["refit"] < oracle["nominal"] < 1.05 * oracle["refit"]
    else:
        assert oracle["nominal"] > 1.5 * oracle["refit"]


def test_each_effect_of_a_pair_is_needed(tmp_path: Path) -> None:
    wish = {"family": "pair", "effect": "constant_torque", "system": "one_link"}
    answers = answers_of(make_case(5, tmp_path, **wish))
    assert len(answers["effects"]) == 2 and answers["effects"][0]["name"] == "constant_torque"
    for effect in answers["effects"]:
        assert effect["closes"] >= draw.DOMINANT and effect["share"] >= draw.ADDS


def test_winding_that_lags_is_nearly_as_good_an_answer_as_a_short_delay(tmp_path: Path) -> None:
    wish = {"effect": "delay", "system": "one_link", "level": "weak"}
    answers = answers_of(make_case(31, tmp_path, **wish))
    (rest,) = answers["notes"]["rest_of_gap_with_rival"]
    assert min(rest, key=rest.__getitem__) == "electrical_lag@1" and rest["electrical_lag@1"] < 0.5
    assert "cogging" not in answers["effects"][0]["accept"]


def test_messy_machine_has_a_dominant_effect_among_small_ones(tmp_path: Path) -> None:
    answers = answers_of(make_case(11, tmp_path, realism="messy", family="single", system="one_link"))
    first, *small = answers["effects"]
    assert first["role"] == "dominant" and len(small) >= draw.FEWEST
    assert first["closes"] >= draw.DOMINANT and all(one["role"] == "small" for one in small)
    assert all(first["closes"] >= draw.TWICE * one["closes"] for one in small)
    assert all(draw.LIFT[0] < one["lift"] < draw.LIFT[1] for one in small)
    assert sum(one["share"] for one in answers["effects"]) == pytest.approx(1.0, abs=0.01)


def test_messy_machine_that_lacks_nothing_has_drift_and_imperfect_encoders_alone(tmp_path: Path) -> None:
    case = make_case(3, tmp_path, realism="messy", family="parameters", system="one_link")
    answers, data = answers_of(case), Dataset.load(case)
    assert (len(data.train), len(data.test)) == (6, 2)
    oracle, about = answers["oracle"], answers["messy"]
    assert answers["effects"] == [] and oracle["refit"] <= draw.HARMLESS * oracle["noise_floor"]
    assert all(0.001 < std < 0.06 for std in about["drift_of_friction"])
    assert about["small_share"] == about["outside_share"] == 0 and about["encoders"]["ripple_over_noise"]


def test_arm_holds_records_a_description_and_answers_apart(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    case = make_case(27203, tmp_path, realism="arms", effect="constant_torque")
    data, model, truth = Dataset.load(case), load_model(case / "model.yaml"), answers_of(case)
    assert (len(data.train), len(data.test), len(model.joints)) == (4, 1, 2)
    first, *small = truth["effects"]
    assert (first["name"], first["role"]) == ("constant_torque", "dominant")
    assert first["where"] in first["accept_where"] and first["where"].split("/")[0] in ("j1", "j2")
    assert min(first["closes"], first["closes_train"]) >= draw_arm.DOMINANT
    assert all(one["role"] == "small" and one["closes_train"] < first["closes_train"] for one in small)
    assert truth["oracle"]["noise_floor"] < truth["oracle"]["refit"] < truth["oracle"]["nominal"]
    assert truth["arm"]["joints"] == 2 and first["size"]["bias"]
    text = (case / "arm.xml").read_text()
    assert text.count("<inertial") == 2 and text.count("<joint") == 2


def test_joints_are_numbered_as_engines_number_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A description nests what branches off: records are logged in its order of the joints."""
    monkeypatch.setattr(arm, "JOINTS", (7, 7))
    orders = set()
    for seed in range(12):
        one = arm.draw_arm(np.random.default_rng([27, seed, 0]))
        (tmp_path / "arm.xml").write_text(one.description())
        assert list(load_tree(tmp_path / "arm.xml").names) == [f"j{k + 1}" for k in range(7)]
        orders.add(tuple(link.parent for link in one.links))
    assert any(parents != tuple(range(-1, 6)) for parents in orders)


@pytest.mark.parametrize("realism", ["clean", "messy", "arms"])
def test_seed_decides_everything(realism: str, tmp_path: Path) -> None:
    if realism == "arms":
        pytest.importorskip("mujoco")
    wish = {"realism": realism, "family": "parameters", "name": "x"}
    made = [make_case(seed, tmp_path / str(i), **wish) for i, seed in enumerate((5, 5, 6))]
    texts = [{file.name: file.read_bytes() for file in case.iterdir()} for case in made]
    assert texts[0] == texts[1] and texts[0]["rec_00.csv.gz"] != texts[2]["rec_00.csv.gz"]
    assert answers_of(made[0]) == answers_of(made[1])


def test_families_are_drawn_as_often_as_they_say() -> None:
    for realism, chances in making.FAMILIES.items():
        drawn = [family_and_level(seed, realism, None, None, None)[0] for seed in range(400)]
        assert all(abs(drawn.count(name) / 400 - chance) < 0.06 for name, chance in chances.items())
    assert family_and_level(1, "clean", None, "CubicDrag", "strong") == ("unknown", "strong")
    assert family_and_level(1, "arms", None, "latch", "weak") == ("unknown", "weak")
    assert family_and_level(1, "clean", None, "cogging", "strong") == ("single", "strong")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"effect": "backlsh"}, "did you mean 'backlash'"),
        ({"effect": "CubicDrag", "family": "single"}, "outside the catalogue"),
        ({"effect": "cogging", "family": "unknown"}, "in the catalogue"),
        ({"effect": "viscous_friction", "system": "two_link"}, "cannot be met"),
        ({"realism": "real"}, "not known"),
        ({"realism": "messy", "level": "strong"}, "no level"),
        ({"realism": "arms", "system": "one_link"}, "leave --system"),
        ({"realism": "arms", "family": "pair"}, "not known"),
    ],
)
def test_what_is_not_known_or_leaves_no_choice_is_refused(
    tmp_path: Path, options: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_case(1, tmp_path, **options)


def test_without_mujoco_no_arm_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "find_spec", lambda name: None if name == "mujoco" else util.find_spec(name))
    with pytest.raises(InputError, match=r"not installed; install it with pip install 'hybrid_id\[robots\]'"):
        make_cases(1, 1, tmp_path, realism="arms")
    assert not list(tmp_path.iterdir())


def test_existing_case_is_kept(tmp_path: Path) -> None:
    (tmp_path / "c001").mkdir()
    with pytest.raises(InputError, match="exists already"):
        make_case(1, tmp_path, family="none", system="one_link")


def test_a_fault_in_one_case_is_told_and_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = making.draw_drive

    def broken_once(rng: np.random.Generator, name: str, *rest: Any, **more: Any) -> Any:
        if name == "c001":
            raise ZeroDivisionError("float division by zero")
        return honest(rng, name, *rest, **more)

    monkeypatch.setattr(making, "draw_drive", broken_once)
    with pytest.warns(UserWarning, match="case c001 of seed 7 is left out: ZeroDivisionError"):
        made = make_cases(2, 7, tmp_path, family="none", system="one_link")
    assert [path.name for path in made] == ["c002"]


def test_a_full_disk_ends_the_making_and_loses_no_case_from_the_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(making, "make_case", full)
    with pytest.raises(OSError, match="No space"):
        make_cases(1, 4, tmp_path)

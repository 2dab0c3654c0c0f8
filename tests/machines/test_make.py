"""Case folders: the format, the answers, repeatability by seed, and what is refused."""

import errno
from pathlib import Path

import numpy as np
import pytest
import yaml

from hybrid_id.errors import InputError
from hybrid_id.machines import experiments as plans
from hybrid_id.machines import grading
from hybrid_id.machines import make as making
from hybrid_id.machines.case import further_record
from hybrid_id.machines.case import record as measured_again
from hybrid_id.machines.draw import family_and_level, same_case
from hybrid_id.machines.experiments import noise_std
from hybrid_id.machines.make import make_case, make_cases
from hybrid_id.machines.physics.bench import replay
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model


def shorten(patch: pytest.MonkeyPatch) -> None:
    """Short records, and few sizes of an effect that are tried."""
    patch.setattr(plans, "LENGTHS", (700, 900))
    patch.setattr(grading, "FACTORS", np.geomspace(0.2, 8.0, 5))


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch)


def answers_of(case: Path) -> dict:
    return yaml.safe_load((case.parent / "answers" / f"{case.name}.yaml").read_text())


WISH = {"effect": "stribeck_friction", "system": "one_link", "level": "strong"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One case that several tests look at."""
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        return make_case(7, tmp_path_factory.mktemp("cases"), grading=False, **WISH)


def test_case_has_the_format_that_the_package_reads(case: Path) -> None:
    data, model, answers = Dataset.load(case), load_model(case / "model.yaml"), answers_of(case)
    assert (len(data.train), len(data.test)) == (6, 2)
    assert {channel.name for channel in data.outputs} == {"q_m1"}
    assert data.sample_time == 0.002
    assert set(record.note for record in data.test) - {""}
    assert model.name == "one_link"
    assert answers["family"] == "single"
    assert answers["effects"][0]["name"] == "stribeck_friction"
    assert answers["effects"][0]["accept_where"] == ["joint1/motor_friction", "joint1/link_friction"]
    oracle = answers["oracle"]
    assert oracle["refit"] / oracle["noise_floor"] > 1.15
    assert sorted(path.name for path in case.parent.iterdir()) == ["answers", case.name]


def test_record_starts_at_rest_without_voltage(tmp_path: Path) -> None:
    case = make_case(3, tmp_path, family="none", system="two_link")
    for record in Dataset.load(case):
        for k in (1, 2):
            assert np.all(record.signal(f"u{k}")[:50] == 0)
            start = record.signal(f"q_m{k}")[:50]
            moving = record.signal(f"q_m{k}")
            assert np.std(start) < 0.05 * np.ptp(moving)
            assert abs(np.mean(start[:25]) - np.mean(start[25:])) < np.std(start)


@pytest.mark.parametrize("family", ["none", "parameters"])
def test_sound_case_is_re_fitted_to_its_noise_floor(family: str, tmp_path: Path) -> None:
    """In one the simulator is right as it stands, in the other its values are wrong."""
    case = make_case(4, tmp_path, family=family, system="one_link")
    answers = answers_of(case)
    assert answers["effects"] == []
    assert answers["level"] == "none"
    oracle = answers["oracle"]
    assert oracle["refit"] < 1.1 * oracle["noise_floor"]
    if family == "none":
        assert 0.9 * oracle["refit"] < oracle["nominal"] < 1.05 * oracle["refit"]
    else:
        assert oracle["nominal"] > 2 * oracle["refit"]


def test_seed_decides_everything(tmp_path: Path) -> None:
    made = [make_case(seed, tmp_path / str(i), family="none", name="x") for i, seed in enumerate((5, 5, 6))]
    texts = [
        [
            (case / name).read_bytes()
            for name in ("model.yaml", "dataset.yaml", "rec_00.csv.gz", "rec_07.csv.gz")
        ]
        for case in made
    ]
    assert texts[0] == texts[1]
    assert texts[0][0] != texts[2][0]


def test_several_cases_are_numbered(tmp_path: Path) -> None:
    made = make_cases(2, 20, tmp_path, family="none", system="one_link")
    assert [path.name for path in made] == ["c001", "c002"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"effect": "backlsh"}, "effect 'backlsh' is not known"),
        ({"system": "three_link"}, "system 'three_link' is not known"),
        (
            {"effect": "CubicDrag", "family": "single"},
            "'CubicDrag' is outside the catalogue; leave family out",
        ),
        (
            {"effect": "cogging", "family": "unknown"},
            "'cogging' is in the catalogue; give family single or pair",
        ),
        ({"effect": "viscous_friction", "system": "two_link"}, "cannot be met on a two_link machine"),
    ],
)
def test_unknown_name_is_refused(tmp_path: Path, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_case(1, tmp_path, **options)


def test_an_effect_outside_the_catalogue_says_its_family() -> None:
    assert family_and_level(1, None, "CubicDrag", "strong") == ("unknown", "strong")
    assert family_and_level(1, None, "cogging", "strong") == ("single", "strong")


def test_existing_case_is_kept(tmp_path: Path) -> None:
    (tmp_path / "c001").mkdir()
    with pytest.raises(InputError, match="exists already"):
        make_case(1, tmp_path, family="none", system="one_link")


def test_machine_of_a_case_goes_on_the_bench_again(case: Path) -> None:
    source = answers_of(case)["made_by"]
    again = same_case(source["seed"], source["draw"], **WISH)
    for measured, repeated in zip(Dataset.load(case), measured_again(again).dataset, strict=True):
        assert np.array_equal(measured.signal("q_m1"), repeated.signal("q_m1"))
    time = 0.002 * np.arange(400)
    command = np.where(time < 0.1, 0.0, 1.5 * again.robot.supply * np.sin(6 * time))
    more = further_record(again, 1, command, 0.002, seed=7)
    assert np.all(np.abs(more.signal("u1")) <= again.robot.supply) and more.role == "train"
    clean = replay(again.plant(), more.signal("u1")[:, None, None], sample_time=0.002)[:, 0, 0]
    error = np.std(more.signal("q_m1") - clean)
    assert error < 0.1 * np.ptp(clean)
    assert error == pytest.approx(noise_std(again.campaign.encoders)[0], rel=0.5)
    with pytest.raises(InputError, match="needs the sample time"):
        further_record(again, 1, command, 0.001, seed=7)


def test_winding_that_lags_is_as_good_an_answer_as_a_short_delay(tmp_path: Path) -> None:
    case = make_case(31, tmp_path, effect="delay", system="one_link", level="weak", engine="in_house")
    answers = answers_of(case)
    rest = answers["notes"]["rest_of_gap_with_rival"]
    assert min(rest, key=rest.__getitem__) == "electrical_lag@1"
    assert rest["electrical_lag@1"] < 0.5
    assert "cogging" not in answers["effects"][0]["accept"]


def test_a_full_disk_ends_the_making_and_loses_no_case_from_the_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(making, "make_case", full)
    with pytest.raises(OSError, match="No space"):
        make_cases(1, 4, tmp_path)

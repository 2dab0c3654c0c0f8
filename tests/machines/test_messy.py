"""Messy machines: what they are made of, their answers, and that clean cases stay what they were."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from hybrid_id.errors import InputError
from hybrid_id.machines import experiments as plans
from hybrid_id.machines import messy
from hybrid_id.machines.draw import same_case
from hybrid_id.machines.effects.friction import PreslidingDahl, StribeckGaussian, WithheldCoulomb
from hybrid_id.machines.effects.load import Bias
from hybrid_id.machines.effects.transmission import SoftGear
from hybrid_id.machines.make import make_case
from hybrid_id.machines.messy import FEWEST, LEADERS, family_of
from hybrid_id.machines.mixtures import Mixtures, Simulator
from hybrid_id.machines.physics.bench import Encoders, Flaws
from hybrid_id.machines.robots import draw_robot
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messy, "LENGTHS", (600, 800))


def drift_only(folder: Path) -> Path:
    return make_case(3, folder, realism="messy", family="parameters", system="one_link")


def test_machine_that_lacks_nothing_has_drift_and_imperfect_encoders_alone(tmp_path: Path) -> None:
    case = drift_only(tmp_path)
    answers = yaml.safe_load((tmp_path / "answers" / f"{case.name}.yaml").read_text())
    data, model = Dataset.load(case), load_model(case / "model.yaml")
    assert (len(data.train), len(data.test), model.name) == (6, 2, "one_link")
    assert answers["family"] == "parameters" and answers["effects"] == [] and answers["level"] == "none"
    oracle, about = answers["oracle"], answers["messy"]
    assert oracle["refit"] <= messy.HARMLESS * oracle["noise_floor"] and oracle["nominal"] > oracle["refit"]
    assert all(0.001 < std < 0.06 for std in about["drift_of_friction"])
    assert about["small_share"] == about["outside_share"] == 0 and about["encoders"]["ripple_over_noise"]
    source = answers["made_by"]
    again = same_case(source["seed"], source["draw"], realism="messy", family="parameters", system="one_link")
    assert again.model == yaml.safe_load((case / "model.yaml").read_text())


def test_seed_decides_a_messy_machine(tmp_path: Path) -> None:
    one, other = (drift_only(tmp_path / name) for name in ("a", "b"))
    for file in ("model.yaml", "rec_00.csv.gz"):
        assert (one / file).read_bytes() == (other / file).read_bytes()


def test_families_of_messy_machines_are_drawn() -> None:
    drawn = [family_of(seed, None, None) for seed in range(300)]
    assert set(drawn) == {"single", "pair", "unknown"}
    assert 0.15 < drawn.count("unknown") / 300 < 0.28
    assert family_of(1, None, "CubicDrag") == "unknown" and family_of(1, None, "cogging") == "single"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"realism": "real"}, "realism 'real' is not known"),
        ({"realism": "messy", "level": "strong"}, "neither level nor MuJoCo"),
        ({"realism": "messy", "engine": "mujoco"}, "neither level nor MuJoCo"),
    ],
)
def test_what_a_messy_machine_leaves_no_choice_of_is_refused(
    tmp_path: Path, options: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_case(1, tmp_path, **options)


def test_effects_that_exclude_each_other_never_meet() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        robot = draw_robot(rng, "one_link")
        leaders = messy._leaders(rng, robot, "pair", [])
        effects = [*leaders, *messy._small(rng, robot, leaders)]
        assert len(leaders) >= LEADERS["pair"] and len(effects) >= len(leaders) + FEWEST
        assert sum(effect.replaces for effect in effects) <= 1
        assert sum(isinstance(effect, PreslidingDahl | WithheldCoulomb) for effect in effects) <= 1
        assert len({type(effect) for effect in effects}) == len(effects)


def test_lanes_of_a_mixture_are_the_machines_one_by_one() -> None:
    rng = np.random.default_rng(4)
    robot = draw_robot(rng, "one_link")
    effects = [kind.draw(rng, robot, 0) for kind in (StribeckGaussian, Bias, SoftGear)]
    mixtures = Mixtures(robot, effects, plans.draw_campaign(rng, robot, lengths=(300, 400)))
    drift = np.full((1, 8), 1.02)
    sizes = [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.5, 0.4, 0.0), (0.5, 0.0, 1.0)]
    together = mixtures.record(sizes, drift)
    for own, measured in zip(sizes, together, strict=True):
        alone = mixtures.record([own], drift)[0]
        np.testing.assert_allclose(measured.angles, alone.angles, atol=1e-9)
    right = Simulator(2, sizes[2], mixtures.true, free=(0, 1))
    lacking = Simulator(2, sizes[0], mixtures.true)
    fits = mixtures.fit([right, lacking], together, rounds=4)
    assert fits[0].train < fits[1].train
    assert fits[0].test < 1.3 * mixtures.floors([sizes[2]], [together[2]])[0]


def test_encoders_miss_counts_and_are_eccentric_and_late() -> None:
    true, before = np.array([[1.0], [2.0]]), np.array([[0.8], [1.0]])
    lost = np.zeros((3, 2, 1))
    lost[1, 0] = 0.5
    flaws = Flaws(np.array([0.0, 0.1]), np.array([0.0, 0.3]), np.array([0.25, 0.0]), lost)
    seen = Encoders(np.full(2, 1e-9), np.zeros((3, 2, 1)), flaws=flaws).read(1, true, before)
    assert seen[:, 0] == pytest.approx([1.0 - 0.25 * 0.2 + 0.5, 2.0 + 0.1 * (np.sin(2.3) - np.sin(0.3))])


def test_clean_cases_of_a_seed_are_those_of_before_there_were_messy_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 900))
    case = make_case(5, tmp_path, family="none", system="one_link", engine="in_house", name="x")
    digest = hashlib.sha256(
        (case / "model.yaml").read_bytes() + Dataset.load(case).train[0].signal("q_m1").tobytes()
    )
    assert digest.hexdigest()[:16] == "df0ee36293ff2b14"

"""Campaigns of the twins: what is drawn, what is written, and that the truth replays the records."""

import copy
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.machines.twin.campaign import (
    make_campaign,
    make_campaigns,
    model_description,
    replay,
    write_campaign,
)
from hybrid_id.machines.twin.demo import DEMO
from hybrid_id.machines.twin.settings import DRIFTING, PARAMETERS, LinkTwin, read_settings
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.systems.model_file import ModelFile, build_model

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
CONFIG = read_yaml(CONFIGS / "twin_link1.yaml")
STAGES = {
    "twin_link1": 10,
    "twin_link1_flexible": 10,
    "twin_link2_high": 8,
    "twin_link2_low": 9,
    "twin_both_links": 12,
}  # numbers of experiments in the paper


@pytest.fixture
def short() -> dict:
    """Two experiments of one second, with the sizes of the real twin."""
    config = copy.deepcopy(CONFIG)
    config |= {"duration": 1.0, "substeps": 2}
    config["excitation"] = {
        "starts": 1,
        "experiments": [
            {"band": [1.1, 8.9], "tones": 5, "peak": 10.0},
            {"band": [2.2, 10.1], "tones": 5, "peak": 6.0, "role": "test"},
        ],
    }
    return config


def test_a_seed_repeats_and_another_differs(short: dict) -> None:
    (first, truths), (second, others) = make_campaigns(short, [4, 5])
    again, same = make_campaign(short, 4)
    assert truths == same and truths != others
    for a, b, c in zip(first, again, second, strict=True):
        np.testing.assert_array_equal(a.outputs["q_m1"], b.outputs["q_m1"])
        np.testing.assert_array_equal(a.inputs["u1"], c.inputs["u1"])
        assert np.any(a.outputs["q_m1"] != c.outputs["q_m1"])


def test_records_are_as_the_settings_say(short: dict) -> None:
    dataset, truths = make_campaign(short, 0)
    assert [record.role for record in dataset] == ["train", "test"]
    quantum = 2 * np.pi / short["disturbances"]["encoder_counts"]
    for record, truth, plan in zip(dataset, truths, short["excitation"]["experiments"], strict=True):
        voltage, angle = record.inputs["u1"], record.outputs["q_m1"]
        assert record.n_samples == 500
        assert not voltage[:50].any() and voltage[50:].any()
        assert 0.95 * plan["peak"] < np.abs(voltage).max() <= plan["peak"] * (1 + 1e-12)
        np.testing.assert_allclose(angle / quantum, np.round(angle / quantum), atol=1e-6)
        assert abs(angle[:50].mean() - truth["q_0"]) < 4 * dataset.outputs[0].noise_std / np.sqrt(50)


def test_truth_drifts_run_by_run_within_its_bounds(short: dict) -> None:
    truths = [truth for _, runs in make_campaigns(short, range(20)) for truth in runs]
    ratios = np.array([[truth[name] / short["truth"][name] for name in PARAMETERS] for truth in truths])
    drifting = np.isin(PARAMETERS, DRIFTING)
    assert np.all(ratios[:, ~drifting] == 1)
    assert np.all(np.abs(ratios[:, drifting] - 1) <= 0.03)
    assert np.all(ratios[:, drifting].std(axis=0) > 0.01)
    assert np.abs(np.corrcoef(ratios[:, drifting].T) - np.eye(5)).max() < 0.6, "each factor is its own"


def test_replaying_the_truth_leaves_noise_and_random_torques(short: dict) -> None:
    dataset, truths = make_campaign(short, 1)
    floor = dataset.outputs[0].noise_std
    for record, output in zip(dataset, replay(dataset, truths, substeps=2), strict=True):
        assert 0.8 * floor < np.std(record.outputs["q_m1"] - output["q_m1"]) < 1.2 * floor


def test_without_disturbances_only_rounding_is_left(short: dict) -> None:
    short["disturbances"] |= {"torque_noise": 0.0, "encoder_noise": 0.0, "friction_drift": 0.0}
    dataset, truths = make_campaign(short, 1)
    for record, output in zip(dataset, replay(dataset, truths, substeps=2), strict=True):
        assert np.abs(record.outputs["q_m1"] - output["q_m1"]).max() <= np.pi / 128 * (1 + 1e-9)
        gradient = np.gradient(output["q_m1"], 0.002)
        assert np.abs(gradient - output["v_m1"])[5:-5].max() < 4


def test_replay_takes_records_of_unequal_length(short: dict) -> None:
    dataset, truths = make_campaign(short, 2)
    long, cut = dataset.records[0], dataset.records[1].between(0.0, 0.5)
    outputs = replay([long, cut], truths, substeps=2)
    assert [len(output["q_m1"]) for output in outputs] == [long.n_samples, cut.n_samples]
    whole = replay(dataset, truths, substeps=2)[1]
    np.testing.assert_allclose(outputs[1]["v_m1"], whole["v_m1"][: cut.n_samples], atol=1e-9)


def brief(name: str) -> dict:
    """The first two experiments of a stage, cut to half a second, of few tones."""
    config = read_yaml(CONFIGS / f"{name}.yaml") | {"duration": 0.6, "substeps": 2}
    experiments = copy.deepcopy(config["excitation"]["experiments"][:2])
    for experiment in experiments:
        for sines in (experiment[u] for u in ("u1", "u2")) if "u1" in experiment else (experiment,):
            sines.update(band=[2.0, 8.0], tones=3, peak=1.5 * sines["peak"])
    config["excitation"] = {"starts": 1, "experiments": experiments}
    return config


@pytest.mark.parametrize("name", STAGES)
def test_stage_has_the_paper_s_number_of_experiments(name: str) -> None:
    twin = read_settings(read_yaml(CONFIGS / f"{name}.yaml"))
    assert twin.name == name and len(twin.excitation.experiments) == STAGES[name]
    peaks = [sines.peak for plan in twin.excitation.experiments for sines in plan.voltages if sines]
    assert max(peaks) <= 24, "the supply"


@pytest.mark.parametrize("name", STAGES)
def test_stage_repeats_by_seed_and_its_truth_replays_it(name: str) -> None:
    config = brief(name)
    dataset, truths = make_campaign(config, 3)
    again, same = make_campaign(config, 3)
    other, _ = make_campaign(config, 4)
    assert truths == same
    floors = {channel.name: channel.noise_std for channel in dataset.outputs}
    for record, twice, next_seed, output in zip(
        dataset, again, other, replay(dataset, truths, config=config, substeps=2), strict=True
    ):
        for channel, measured in record.outputs.items():
            np.testing.assert_array_equal(measured, twice.outputs[channel])
            assert np.any(measured != next_seed.outputs[channel])
            assert 0.8 * floors[channel] < np.std(measured - output[channel]) < 2 * floors[channel]
            assert np.ptp(measured) > 20 * floors[channel]


@pytest.mark.parametrize("name", STAGES)
def test_model_of_a_stage_can_be_built_and_holds_what_the_paper_holds(name: str) -> None:
    config = read_yaml(CONFIGS / f"{name}.yaml")
    for priors in (False, True):
        system = build_model(ModelFile.model_validate(model_description(config, 0, priors=priors)))
        assert list(system.gear_ratio) == np.atleast_1d(config["gear_ratio"]).tolist()
        estimated = sum(info.spec.estimate for info in system.table)
        known = config["model"]["parameters"].values()
        held = [k for k in known if not k.get("estimate", True) and not (priors and "prior_std" in k)]
        assert estimated == len(config["truth"]) - len(held)


def test_link_encoder_adds_the_link_s_angle() -> None:
    config = brief("twin_link1_flexible")
    config["disturbances"]["link_encoder"] = {"counts": 20000, "noise": 1e-4}
    dataset, truths = make_campaign(config, 0)
    assert [channel.name for channel in dataset.outputs] == ["q_m1", "q_a1"]
    for record, output in zip(dataset, replay(dataset, truths, config=config, substeps=2), strict=True):
        assert np.std(record.outputs["q_a1"] - output["q_a1"]) < 2 * dataset.outputs[1].noise_std
        deflection = record.outputs["q_m1"] / 156 - record.outputs["q_a1"]
        assert np.ptp(deflection) > 0.01, "the link moves apart from its motor"


def test_held_joint_stays_in_its_pose() -> None:
    config = brief("twin_both_links") | {"held": 1}
    config["excitation"]["experiments"][0]["pose"] = [0.5, -0.4]
    config["disturbances"] |= {"start_angle": 0.0}
    dataset, truths = make_campaign(config, 0)
    (first, _) = replay(dataset, truths, config=config, substeps=2)
    assert np.all(first["q_m1"] == 0.5 * 156) and not first["v_m1"].any()
    assert first["q_m2"][0] == -0.4 * 84 and np.ptp(first["q_m2"]) > 1


def test_ripple_of_the_torque_is_seen_and_small() -> None:
    config = brief("twin_link2_low")
    config["disturbances"] |= {"torque_noise": 0.0, "encoder_counts": 10**6, "encoder_noise": 0.0}
    dataset, truths = make_campaign(config, 0)
    for record, output in zip(dataset, replay(dataset, truths, config=config, substeps=2), strict=True):
        moved = np.abs(record.outputs["q_m1"] - output["q_m1"]).max()
        assert 1e-5 < moved < 0.05


def test_folder_holds_records_models_and_truth(short: dict, tmp_path: Path) -> None:
    dataset, truths = write_campaign(tmp_path / "twin", short, 3)
    loaded = Dataset.load(tmp_path / "twin")
    for made, read in zip(dataset, loaded, strict=True):
        np.testing.assert_allclose(read.outputs["q_m1"], made.outputs["q_m1"], atol=1e-5)
        np.testing.assert_allclose(read.inputs["u1"], made.inputs["u1"], atol=1e-6)
    truth = read_yaml(tmp_path / "twin" / "truth.yaml")
    assert truth["seed"] == 3
    assert list(truth["records"].values()) == truths
    LinkTwin.model_validate(truth["settings"])
    assert read_yaml(tmp_path / "twin" / "model.yaml") == model_description(short, 3)
    with_priors = read_yaml(tmp_path / "twin" / "model_priors.yaml")["parameters"]
    assert {name for name, entry in with_priors.items() if "prior_std" in entry} == {"P_m1", "P_m2"}


@pytest.mark.parametrize("seed", range(5))
def test_start_values_are_off_but_inside_their_bounds(seed: int) -> None:
    model = model_description(CONFIG, seed)
    (friction,) = model["components"]
    entries = model["parameters"] | friction["parameters"]
    assert tuple(entries) == PARAMETERS
    for name, entry in entries.items():
        truth = CONFIG["truth"][name]
        assert entry["lower"] < entry["nominal"] < entry["upper"]
        assert entry["lower"] < truth < entry["upper"]
        assert abs(entry["nominal"] / truth - 1) <= 0.5 + 1e-6
        assert "prior_std" not in entry
    assert model["parameters"]["P_m1"]["nominal"] == 19.059e-3  # Table 1
    assert model["parameters"]["P_m2"]["nominal"] == 0.0254


def test_demo_is_ready_to_identify(tmp_path: Path) -> None:
    dataset, truths = write_campaign(tmp_path / "demo", DEMO, 0)
    assert len(dataset.train) == 5 and len(dataset.test) == 1 and len(truths) == 6
    assert {path.name for path in (tmp_path / "demo").iterdir()} >= {
        "dataset.yaml",
        "model.yaml",
        "truth.yaml",
    }


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["truth"].pop("J"), "truth.J"),
        (lambda c: c["disturbances"].update(torque_nose=0.1), "torque_nose"),
        (lambda c: c["disturbances"].update(friction_drift=1.5), "friction_drift"),
        (lambda c: c["model"]["parameters"].pop("f_3"), "f_3"),
        (lambda c: c["excitation"].update(experiments=[]), "experiments"),
        (lambda c: c.update(rest=2.0), "duration.*rest"),
        (lambda c: c["excitation"]["experiments"][0].update(band=[0.2, 400.0]), "Hz"),
    ],
)
def test_bad_settings_are_refused_by_name(short: dict, change, words: str) -> None:
    change(short)
    with pytest.raises(InputError, match=words):
        make_campaign(short, 0)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("twin_link1", lambda c: c.update(machine="three_link"), "machine.*three_link.*one_link_flexible"),
        ("twin_link1", lambda c: c["truth"].update(f_111=0.1), "truth.f_111.*did you mean 'f_11'"),
        ("twin_link1", lambda c: c["truth"].update(f_12=-0.1), "truth.f_12' is -0.1"),
        (
            "twin_link1",
            lambda c: c["disturbances"].update(link_encoder={"counts": 9, "noise": 0.1}),
            "link_encoder",
        ),
        ("twin_link1_flexible", lambda c: c["truth"].update(k=0.0), "truth.k.*must be positive"),
        ("twin_link1_flexible", lambda c: c["truth"].pop("alpha"), "truth.alpha.*missing"),
        ("twin_both_links", lambda c: c["truth"].update(P_4=0.4), "mass matrix"),
        ("twin_both_links", lambda c: c.update(held=3), "held"),
        ("twin_both_links", lambda c: c.update(gear_ratio=156.0), "gear_ratio"),
        ("twin_both_links", lambda c: c["model"]["parameters"].pop("P_3"), "model.parameters.P_3.*missing"),
        ("twin_both_links", lambda c: c["excitation"]["experiments"][0].update(u3={}), "u3"),
        (
            "twin_both_links",
            lambda c: c["disturbances"]["torque_ripple"].update(share=-1.0),
            "torque_ripple.share",
        ),
    ],
)
def test_bad_settings_of_a_stage_are_refused_in_one_sentence(name: str, change, words: str) -> None:
    config = read_yaml(CONFIGS / f"{name}.yaml")
    change(config)
    with pytest.raises(InputError, match=words) as caught:
        read_settings(config)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("settings of the twin: key")

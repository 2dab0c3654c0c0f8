"""Twins: what is drawn, what is written, that the truth replays the records, and what controllers see."""

import copy
from pathlib import Path

import numpy as np
import pytest
from paper.twins import config as config_of

from hybrid_id.errors import InputError
from hybrid_id.machines.physics.stick_slip import integrate
from hybrid_id.paper.twin import (
    DRIFTING,
    KINDS,
    Plant,
    make_campaign,
    model_description,
    read_settings,
    replay,
    write_campaign,
)
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.systems.model_file import ModelFile, build_model

STAGES = ("link1", "link1_flexible", "link2_high", "link2_low", "both_links")
CONFIG = config_of("link1")
PARAMETERS = KINDS["one_link"].parameters


@pytest.fixture
def short() -> dict:
    """Two experiments of one second, with the sizes of the real twin."""
    config = copy.deepcopy(CONFIG) | {"duration": 1.0, "substeps": 2}
    config["excitation"] = {
        "starts": 1,
        "experiments": [
            {"band": [1.1, 8.9], "tones": 5, "peak": 10.0},
            {"band": [2.2, 10.1], "tones": 5, "peak": 6.0, "role": "test"},
        ],
    }
    return config


def brief(stage: str) -> dict:
    """The first two experiments of a stage, cut to half a second, of few tones."""
    config = config_of(stage) | {"duration": 0.6, "substeps": 2}
    experiments = config["excitation"]["experiments"][:2]
    for experiment in experiments:
        for sines in (experiment[u] for u in ("u1", "u2")) if "u1" in experiment else (experiment,):
            sines.update(band=[2.0, 8.0], tones=3, peak=1.5 * sines["peak"])
    config["excitation"] = {"starts": 1, "experiments": experiments}
    return config


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


def test_truth_drifts_run_by_run_within_its_bounds() -> None:
    twin = read_settings(CONFIG)
    truths = [twin.draw_truth((0.0,), np.random.default_rng(seed)) for seed in range(40)]
    ratios = np.array([[truth[name] / CONFIG["truth"][name] for name in PARAMETERS] for truth in truths])
    drifting = np.isin(PARAMETERS, DRIFTING)
    assert np.all(ratios[:, ~drifting] == 1)
    assert np.all(np.abs(ratios[:, drifting] - 1) <= 0.03)
    assert np.all(ratios[:, drifting].std(axis=0) > 0.01)
    assert np.abs(np.corrcoef(ratios[:, drifting].T) - np.eye(5)).max() < 0.6, "each factor is its own"


@pytest.mark.parametrize("stage", STAGES)
def test_stage_repeats_by_seed_and_its_truth_replays_it(stage: str) -> None:
    config = brief(stage)
    (dataset, truths), (again, same), (other, _) = (make_campaign(config, seed) for seed in (3, 3, 4))
    assert truths == same
    floor = dataset.outputs[0].noise_std
    replays = replay(config, dataset.records, truths)
    for record, twice, next_seed, output in zip(dataset, again, other, replays, strict=True):
        for channel, measured in record.outputs.items():
            np.testing.assert_array_equal(measured, twice.outputs[channel])
            assert np.any(measured != next_seed.outputs[channel])
            assert 0.8 * floor < np.std(measured - output[channel]) < 2 * floor
            assert np.ptp(measured) > 20 * floor
        for channel, voltage in record.inputs.items():
            np.testing.assert_array_equal(voltage, next_seed.inputs[channel])


@pytest.mark.parametrize("stage", STAGES)
def test_model_of_a_stage_can_be_built_and_holds_what_the_paper_holds(stage: str) -> None:
    config = config_of(stage)
    known = config["model"]["parameters"]
    for priors in (False, True):
        system = build_model(ModelFile.model_validate(model_description(config, 0, priors=priors)))
        assert list(system.gear_ratio) == np.atleast_1d(config["gear_ratio"]).tolist()
        for name, entry in known.items():
            spec, truth = system.parameter(name).spec, config["truth"][name]
            prior = priors and "prior_std" in entry
            assert spec.estimate == (entry.get("estimate", True) or prior)
            assert (spec.prior_std is not None) == prior
            assert spec.lower < truth < spec.upper and spec.lower < spec.value < spec.upper
            off = spec.value / truth - 1 if "nominal" not in entry else spec.value / entry["nominal"] - 1
            assert abs(off) <= (config["model"]["start_error"] if "nominal" not in entry else 0) + 1e-6


def test_folder_holds_records_models_and_truth(short: dict, tmp_path: Path) -> None:
    dataset, truths = write_campaign(tmp_path / "twin", short, 3)
    loaded = Dataset.load(tmp_path / "twin")
    for made, read in zip(dataset, loaded, strict=True):
        np.testing.assert_allclose(read.outputs["q_m1"], made.outputs["q_m1"], atol=1e-5)
        np.testing.assert_allclose(read.inputs["u1"], made.inputs["u1"], atol=1e-6)
    truth = read_yaml(tmp_path / "twin" / "truth.yaml")
    assert truth["seed"] == 3
    assert list(truth["records"].values()) == truths
    assert dict(read_settings(truth["settings"]).truth) == short["truth"]
    assert read_yaml(tmp_path / "twin" / "model.yaml") == model_description(short, 3)
    with_priors = read_yaml(tmp_path / "twin" / "model_priors.yaml")["parameters"]
    assert {name for name, entry in with_priors.items() if "prior_std" in entry} == {"P_m1", "P_m2"}


@pytest.mark.parametrize(
    ("stage", "change", "words"),
    [
        ("link1", lambda c: c["truth"].pop("J"), "truth.J' is missing"),
        ("link1", lambda c: c["disturbances"].update(torque_nose=0.1), "torque_nose' is unknown"),
        ("link1", lambda c: c["disturbances"].update(friction_drift=1.5), "friction_drift"),
        ("link1", lambda c: c["model"]["parameters"].pop("f_3"), "model.parameters.f_3' is missing"),
        ("link1", lambda c: c["excitation"].update(experiments=[]), "experiments"),
        ("link1", lambda c: c.update(rest=20.0), "duration.*rest"),
        ("link1", lambda c: c.update(machine="three_link"), "machine.*three_link.*one_link_flexible"),
        ("link1", lambda c: c["truth"].update(f_111=0.1), "truth.f_111.*did you mean 'f_11'"),
        ("link1", lambda c: c["truth"].update(f_12=-0.1), "truth.f_12' must be.*found -0.1"),
        ("link1_flexible", lambda c: c["truth"].update(k=0.0), "truth.k' must be greater than 0"),
        ("both_links", lambda c: c["truth"].update(P_4=0.4), "mass matrix"),
        ("both_links", lambda c: c.update(gear_ratio=156.0), "gear_ratio"),
        ("both_links", lambda c: c["excitation"]["experiments"][0].update(u3={}), "u3"),
        (
            "both_links",
            lambda c: c["disturbances"]["torque_ripple"].update(share=-1.0),
            "torque_ripple.share",
        ),
    ],
)
def test_bad_settings_are_refused_in_one_sentence(stage: str, change, words: str) -> None:
    config = config_of(stage)
    change(config)
    with pytest.raises(InputError, match=words) as caught:
        make_campaign(config, 0)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("settings of the twin: key")


def test_a_plant_repeats_by_seed_and_steps_as_the_campaigns_do() -> None:
    config = config_of("both_links") | {"substeps": 2}
    plants = Plant(config, [3, 4]), Plant(config, [4])
    for k in range(20):
        for plant in plants:
            plant.step(np.repeat([[6.0], [2.0]], len(plant.reading.T), 1) * np.cos(0.1 * k))
        np.testing.assert_allclose(plants[0].reading[:, 1:], plants[1].reading, atol=1e-9)
    assert np.any(plants[0].reading[:, 0] != plants[0].reading[:, 1])
    config["disturbances"] |= {"torque_noise": 0.0, "encoder_noise": 0.0, "friction_drift": 0.0}
    plant, twin = Plant(config, [0]), read_settings(config)
    readings, inputs = [plant.reading], np.zeros((31, 4, 1))
    inputs[:, 0, 0], inputs[:, 1, 0] = 6 * np.cos(0.1 * np.arange(31)), 2 * np.cos(0.1 * np.arange(31))
    for k in range(30):
        plant.step(inputs[k, :2])
        readings.append(plant.reading)
    machine, start = twin.begin([config["truth"]], ripple=True)
    states = integrate(machine, start, inputs, 0.002 * np.arange(31), substeps=2)[:, ::2]
    np.testing.assert_allclose(plant.link_angles * [[156.0], [84.0]], states[-1], atol=1e-12)
    assert np.abs(np.array(readings) - states).max() <= np.pi / 128 + 1e-9

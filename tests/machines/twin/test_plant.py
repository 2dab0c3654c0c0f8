"""The twin under a controller."""

import numpy as np
import pytest
from machines.twin.twins import CONFIGS

from hybrid_id.machines.physics.stick_slip import integrate
from hybrid_id.machines.twin.plant import Plant
from hybrid_id.machines.twin.settings import read_settings
from hybrid_id.records.yaml_file import read_yaml

ARM = read_yaml(CONFIGS / "twin_both_links.yaml") | {"substeps": 2}


def run(plant: Plant, n_steps: int) -> list[dict[str, np.ndarray]]:
    return [plant.step(np.array([[6.0], [2.0]]) * np.cos(0.1 * k)) for k in range(n_steps)]


def test_runs_repeat_by_seed_side_by_side_or_alone() -> None:
    both, alone = Plant(ARM, [3, 4]), Plant(ARM, [4])
    for two, one in zip(run(both, 20), run(alone, 20), strict=True):
        for name in ("q_m1", "q_m2"):
            assert two[name][1] == pytest.approx(one[name][0], abs=1e-9)
    assert both.truths[1] == alone.truths[0] != both.truths[0]
    assert np.all(np.abs(both.states["v_m2"]) > 1)


def test_steps_are_those_of_the_campaigns() -> None:
    config = ARM | {"disturbances": ARM["disturbances"] | {"torque_noise": 0.0, "encoder_noise": 0.0}}
    plant = Plant(config, [0], pose=[0.0, 0.8])
    start = np.array(list(plant.states.values()))
    assert start[2, 0] == pytest.approx(0.8 * 84, abs=1.0)
    measured = [plant.measure(), *run(plant, 30)]
    inputs = np.zeros((31, 4, 1))
    inputs[:, 0, 0], inputs[:, 1, 0] = 6 * np.cos(0.1 * np.arange(31)), 2 * np.cos(0.1 * np.arange(31))
    states = integrate(plant._mechanism, start, inputs, 0.002 * np.arange(31), substeps=2)[:, :, 0]
    np.testing.assert_allclose(states[-1], [plant.states[name][0] for name in plant.states], atol=1e-12)
    quantum = read_settings(config).disturbances.encoder.quantum
    for name, row in (("q_m1", 0), ("q_m2", 2)):
        readings = np.array([reading[name][0] for reading in measured])
        assert np.abs(readings - states[:, row]).max() <= quantum / 2 + 1e-9

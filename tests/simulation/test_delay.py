"""A delay shifts the held command, by whole and by broken samples, and the records tell it."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from drives import STEP, measure, multisine, rigid_drive

from hybrid_id.components import CommonDelay, Delay, SensorDelay
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, two_link

DRIVE = rigid_drive()
VOLTAGE = np.concatenate([np.zeros(20), 4.0 * np.sin(np.arange(200) / 9.0)])


def delayed(seconds: float) -> System:
    return DRIVE.with_component("joint1/input", Delay(T_d=seconds))


def run(system, voltage: np.ndarray) -> np.ndarray:
    record = Record("run", STEP * np.arange(len(voltage)), {"u1": voltage}, {"q_m1": np.zeros_like(voltage)})
    batch = make_batch(system, [record], noise_std={"q_m1": 1.0}, estimate_start=False)
    with torch.no_grad():
        return simulate(system, Engine(substeps=2), batch).y[0, :, 0].numpy()


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_whole_samples_shift_the_command(samples: int) -> None:
    shifted = np.concatenate([np.zeros(samples), VOLTAGE[: len(VOLTAGE) - samples]])
    np.testing.assert_allclose(run(delayed(samples * STEP), VOLTAGE), run(DRIVE, shifted), atol=1e-9)


def test_broken_samples_mix_two() -> None:
    mixed = 0.75 * VOLTAGE + 0.25 * np.concatenate([[0.0], VOLTAGE[:-1]])
    np.testing.assert_allclose(run(delayed(0.25 * STEP), VOLTAGE), run(DRIVE, mixed), atol=1e-9)


def test_fit_finds_a_delay_from_none() -> None:
    voltage = multisine(1, samples=400, amplitude=7.0)
    y = run(delayed(2.6 * STEP), voltage) + 0.01 * np.random.default_rng(1).standard_normal(400)
    record, start = Record("run", STEP * np.arange(400), {"u1": voltage}, {"q_m1": y}), delayed(0.0)
    (found,) = fit(start, make_batch(start, [record], noise_std={"q_m1": 0.01}))
    assert found.values[found.names.index("T_d")] == pytest.approx(2.6 * STEP, abs=1e-4)


ARM = two_link((50.0, 40.0))


def test_common_delay_holds_back_the_commands_of_all_joints() -> None:
    channels = {"u1": VOLTAGE, "u2": 0.5 * np.roll(VOLTAGE, 3)}
    shifted = {name: np.concatenate([np.repeat(u[:1], 2), u[:-2]]) for name, u in channels.items()}
    late = ARM.with_component("joint2/input", CommonDelay(T_d=2 * STEP))
    for name, found in measured(late, channels).items():
        np.testing.assert_allclose(found, measured(ARM, shifted)[name], atol=1e-9)
    own = late.with_component("joint1/input", Delay(T_d=0.0))
    shifted["u1"] = channels["u1"]
    np.testing.assert_allclose(measured(own, channels)["q_m1"], measured(ARM, shifted)["q_m1"], atol=1e-9)
    with pytest.raises(InputError, match="common_delay is listed at joint1/input, joint2/input"):
        late.with_component("joint1/input", CommonDelay())


def measured(system: System, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    blank = {name: np.zeros_like(VOLTAGE) for name in ("q_m1", "q_m2")}
    record = Record("run", STEP * np.arange(len(VOLTAGE)), channels, blank)
    batch = make_batch(system, [record], noise_std=dict.fromkeys(blank, 1.0), estimate_start=False)
    with torch.no_grad():
        y = simulate(system, Engine(substeps=2), batch).y[0]
    return {name: y[:, k].numpy() for k, name in enumerate(blank)}


def test_common_delay_shifts_broken_samples_and_has_no_kinks() -> None:
    time, step = torch.arange(12, dtype=torch.float64), torch.full((12,), STEP, dtype=torch.float64)
    history, slopes = [(0.3 * (10.0 - k - time)).sin() for k in range(9)], {}
    for samples in (0.4, 1.0 - 1e-9, 1.0 + 1e-9, 3.0 - 1e-9, 3.0 + 1e-9, 3.7):
        late = torch.full_like(time, samples * STEP).requires_grad_()
        found = CommonDelay().held(SimpleNamespace(T_d=late), history, step)
        torch.testing.assert_close(found, (0.3 * (10.0 - samples - time)).sin(), atol=2e-3, rtol=0.0)
        (slopes[samples],) = torch.autograd.grad(found.sum(), late)
    for whole in (1.0, 3.0):
        torch.testing.assert_close(slopes[whole - 1e-9], slopes[whole + 1e-9], rtol=1e-6, atol=1e-6)


def test_channels_without_a_past_are_refused() -> None:
    with pytest.raises(InputError, match="joint1 has a delay, but its channels have no past"):
        measure(delayed(STEP), {"u1": VOLTAGE})


def test_sensor_delay_shows_what_was_there_before() -> None:
    late = DRIVE.with_component("joint1/input", SensorDelay(T_r=4 * STEP))
    # the phase of 9 Hz is right to (w T_r)^3 / 12, a sixtieth of it; corners of the speed are rounded
    for channel, share in (("q_m1", 0.03), ("v_m1", 0.1)):
        true, read = (measure(s, {"u1": VOLTAGE}, outputs=[channel])[channel] for s in (DRIVE, late))
        shifted = np.concatenate([np.zeros(4), true[:-4]])
        assert np.abs(read - shifted).max() < share * np.abs(true - shifted).max()


def test_sensor_delay_of_one_joint_leaves_the_other_of_an_arm_alone() -> None:
    arm = two_link((50.0, 40.0))
    late = arm.with_component("joint1/input", SensorDelay(T_r=0.01))
    channels, outputs = {"u1": VOLTAGE, "u2": 0.5 * VOLTAGE}, ["q_m1", "q_a1", "q_m2"]
    before, after = (measure(system, channels, outputs=outputs) for system in (arm, late))
    np.testing.assert_allclose(after["q_m2"], before["q_m2"], rtol=1e-9)
    np.testing.assert_allclose(50.0 * after["q_a1"], after["q_m1"], rtol=1e-9)
    assert np.abs(after["q_m1"] - before["q_m1"]).max() > 0.01 * np.ptp(before["q_m1"])


def test_fit_finds_a_sensor_delay() -> None:
    voltage = multisine(1, samples=400, amplitude=7.0)
    truth, start = (DRIVE.with_component("joint1/input", SensorDelay(T_r=t)) for t in (2.6 * STEP, STEP))
    y = run(truth, voltage) + 0.01 * np.random.default_rng(1).standard_normal(400)
    record = Record("run", STEP * np.arange(400), {"u1": voltage}, {"q_m1": y})
    (found,) = fit(start, make_batch(start, [record], noise_std={"q_m1": 0.01}))
    assert found.values[found.names.index("T_r")] == pytest.approx(2.6 * STEP, abs=1e-4)

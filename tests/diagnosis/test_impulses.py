"""Pulses on a simulated arm of two links whose model is off: the right joint, in time, and none invented."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from drives import batch_of, measure

from hybrid_id.components import TorqueCommand, TorqueMotor
from hybrid_id.diagnosis.impulses import Detector, calibrate, missing_torques
from hybrid_id.errors import InputError
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, two_link

STEP, SAMPLES = 0.004, 1500
NEAR = 0.05
SMOOTH = Engine(friction="smooth", width=0.2, substeps=4)
PULSES = {  # record: joint, time [s], size [N m], width [s]
    "pushed0": [(1, 1.7, 0.6, 0.06), (2, 3.9, -0.5, 0.09)],
    "pushed1": [(2, 2.4, 0.5, 0.05), (1, 4.6, -0.6, 0.1)],
}


def arm() -> System:
    """Two direct drives with gravity and friction, about as large as DFKI's."""
    system = two_link(vertical=True)
    for k in (1, 2):
        system = system.with_component(f"joint{k}/input", TorqueCommand())
        system = system.with_component(f"joint{k}/motor", TorqueMotor())
    values = {"P_1": 0.11, "P_2": 0.053, "P_3": 0.032, "P_4": 0.05, "G_l1": 2.25, "G_l2": 1.57}
    return system.with_values(values | {f"F_cm{k}": 0.2 for k in (1, 2)} | {f"F_vm{k}": 0.02 for k in (1, 2)})


def waves(seed: int) -> np.ndarray:
    """Torques (2, T) of six slow tones with random phases."""
    generator = np.random.default_rng(seed)
    time, tones = STEP * np.arange(SAMPLES), np.geomspace(0.2, 2.0, 6)[:, None]
    phases = generator.uniform(0, 2 * np.pi, (2, 6, 1))
    return np.array([[0.3], [0.15]]) * np.sin(2 * np.pi * tones * time + phases).sum(1)


def made(names: Iterable[str], seed: int) -> list[Record]:
    """Records of the arm with its encoders' noise, the first with this seed; they hold the commanded torques only."""
    names, time, outputs = list(names), STEP * np.arange(SAMPLES), ("q_m1", "q_m2")
    commanded = np.stack([waves(seed + k) for k in range(len(names))])
    acting = commanded.copy()
    for k, name in enumerate(names):
        for joint, middle, size, width in PULSES.get(name, []):
            acting[k, joint - 1] += size * np.exp(-0.5 * ((time - middle) / width) ** 2)
    channels = {"tau1": acting[:, 0], "tau2": acting[:, 1]}
    batch = batch_of(arm(), channels, outputs=outputs, step=STEP, rows=len(names))
    found = simulate(arm(), SMOOTH, batch).y.numpy()
    records = []
    for k, name in enumerate(names):
        generator = np.random.default_rng(100 + seed + k)
        noisy = {n: found[k, :, j] + 3e-4 * generator.standard_normal(SAMPLES) for j, n in enumerate(outputs)}
        records.append(Record(name, time, {"tau1": commanded[k, 0], "tau2": commanded[k, 1]}, noisy))
    return records


def today() -> System:
    """The arm as its user believes it to be."""
    off = {"F_cm1": 0.15, "F_vm2": 0.03, "G_l1": 2.1, "P_2": 0.057}
    return arm().with_values(off)


def prepared(records: Sequence[Record]) -> Batch:
    return make_batch(today(), records, noise_std={"q_m1": 3e-4, "q_m2": 3e-4})


@pytest.fixture(scope="module")
def detector() -> Detector:
    return calibrate(today(), SMOOTH, prepared(made((f"quiet{k}" for k in range(3)), 0)))


def test_every_pulse_is_found_in_time_at_its_joint(detector: Detector) -> None:
    found = detector.find(prepared(made(PULSES, 10)))
    expected = {(r, f"joint{joint}"): rest for r, pulses in PULSES.items() for joint, *rest in pulses}
    assert len(found) == len(expected)
    for pulse in found:
        time, size, _ = expected[pulse.record, pulse.joint]
        assert abs(pulse.time - time) < NEAR
        assert pulse.size == pytest.approx(size, rel=0.35)
        assert pulse.width in detector.widths
        assert 0.0 < pulse.std < 0.2


def test_no_pulse_is_claimed_where_none_was(detector: Detector) -> None:
    assert detector.find(prepared(made((f"held{k}" for k in range(3)), 20))) == []


def test_missing_torque_is_the_torque_that_acted() -> None:
    """With the true model and without noise it is what was added to the command."""
    channels = waves(3)
    acting = channels.copy()
    acting[1, 700:720] += 0.4
    settings = {"step": STEP, "engine": SMOOTH, "outputs": ("q_m1", "q_m2", "v_m1", "v_m2")}
    states = measure(arm(), {"tau1": acting[0], "tau2": acting[1]}, **settings)
    angles = {name: states[name] for name in ("q_m1", "q_m2")}
    record = Record("one", STEP * np.arange(SAMPLES), {"tau1": channels[0], "tau2": channels[1]}, angles)
    batch = make_batch(arm(), [record], noise_std=dict.fromkeys(angles, 1e-4))
    x = batch.x.clone()
    for name, values in states.items():
        x[0, :, arm().state_names.index(name)] = x.new_tensor(values)
    torque = missing_torques(arm(), SMOOTH, replace(batch, x=x))[0].torque
    np.testing.assert_allclose(torque, (acting - channels).T[:-1], atol=2e-3)


def test_one_unperturbed_record_or_a_short_one_is_refused(detector: Detector) -> None:
    with pytest.raises(InputError, match="at least two unperturbed records"):
        calibrate(today(), SMOOTH, prepared(made(["quiet"], 0)))
    whole, quiet = made(["short", "quiet"], 0)
    cut = Record(
        "short",
        whole.time[:150],
        {n: v[:150] for n, v in whole.inputs.items()},
        {n: v[:150] for n, v in whole.outputs.items()},
    )
    with pytest.raises(InputError, match="'short' is too short to look for pulses"):
        detector.find(prepared([cut]))
    with pytest.raises(InputError, match="narrower than the sample time"):
        calibrate(today(), SMOOTH, prepared([whole, quiet]), widths=(0.002,))

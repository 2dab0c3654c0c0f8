"""At which joint and side a torque acts that no law explains: where it was put, and nowhere where there is none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drives import flexible_drive, multisine

from hybrid_id.components import LoggedLoad
from hybrid_id.diagnosis.locate import Disturbance, acts_at, disturbances
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, two_link

STEP, SAMPLES, NOISE = 0.004, 1500, 1e-4
ARM = two_link((156.0, 84.0)).with_values(
    {
        "P_1": 1.101, "P_2": 0.136, "P_3": 0.148, "P_4": 0.068, "P_m1m1": 0.019, "P_m2m1": 0.0254,
        "P_m1m2": 0.0426, "P_m2m2": 0.0107, "F_cm1": 0.011, "F_vm1": 5e-5, "F_cm2": 0.0024, "F_vm2": 2e-5,
    }
)  # fmt: skip


def seen(system: System, outputs: tuple[str, ...], where: str, size: float) -> list[Disturbance]:
    """What disturbances say where something of no law acts at a place: a load [N m], or volts that no record holds."""
    rng, engine, noise = np.random.default_rng(4), Engine(compiled=True), dict.fromkeys(outputs, NOISE)
    joint, place = where.split("/")
    machine = system.with_component(where, LoggedLoad()) if place == "load" else system
    records = []
    for k in range(3):
        volts = {
            f"u{j.number}": multisine(10 * k + j.number, samples=SAMPLES, amplitude=12.0, step=STEP)
            for j in system.joints
        }
        hidden = size * np.interp(np.arange(SAMPLES), np.arange(0, SAMPLES + 20, 20), rng.standard_normal(76))
        channel = f"w{joint[5:]}" if place == "load" else f"u{joint[5:]}"
        inputs = volts | {channel: hidden + volts.get(channel, 0.0)}
        still = {name: np.zeros(SAMPLES) for name in outputs}
        played = Record("run", STEP * np.arange(SAMPLES), inputs, still)
        y = simulate(machine, engine, make_batch(machine, [played], noise_std=noise)).y[0].numpy()
        measured = {n: y[:, i] + NOISE * rng.standard_normal(SAMPLES) for i, n in enumerate(outputs)}
        records.append(replace(played, name=f"run{k}", inputs=volts, outputs=measured))
    batch = make_batch(system, records, noise_std=noise)
    model = SimpleNamespace(system=system, result=SimpleNamespace(engine=engine))
    return disturbances(SimpleNamespace(records=lambda _: batch), model)  # type: ignore[arg-type]


@pytest.mark.parametrize("joint", ["joint1", "joint2"])
def test_the_joint_of_an_arm_is_told(joint: str) -> None:
    found = seen(ARM, ("q_m1", "q_m2"), f"{joint}/load", {"joint1": 0.3, "joint2": 0.05}[joint])
    assert acts_at(found) == (joint, None)
    assert found[0].share > 0.3 and found[0].behind == 0.0


@pytest.mark.parametrize(("place", "size"), [("load", 0.3), ("motor", 1.0)])
def test_two_encoders_tell_the_side_of_a_compliant_gear(place: str, size: float) -> None:
    assert acts_at(seen(flexible_drive(), ("q_m1", "q_a1"), f"joint1/{place}", size)) == ("joint1", place)


def test_one_encoder_tells_no_side() -> None:
    found = seen(flexible_drive(), ("q_m1",), "joint1/load", 0.3)
    assert [(one.joint, one.side) for one in found] == [("joint1", "joint")]
    assert acts_at(found) == ("joint1", None)


def test_noise_alone_acts_nowhere() -> None:
    found = seen(ARM, ("q_m1", "q_m2"), "joint1/load", 0.0)
    assert acts_at(found) == (None, None)

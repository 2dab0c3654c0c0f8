"""An arm of three servos for tests: its description, and records that a system answers goals with."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hybrid_id import Dataset
from hybrid_id.diagnosis.diagnose import Answer, answered
from hybrid_id.records.dataset import Channel
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.by_joint import alone, moving_records, with_others_measured
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

STEP, NOISE = 0.01, 1e-3
TIME = STEP * np.arange(300)
ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body quat="0 1 0 0"><joint name="pan" axis="0 0 1" armature="0.02" damping="0.1" frictionloss="0.05"/>
<inertial mass="0.5" pos="0.02 0 0.05" diaginertia="0.001 0.001 0.001"/>
<body pos="0 0 0.1"><joint name="lift" axis="0 1 0" armature="0.015" damping="0.08" frictionloss="0.04"/>
<inertial mass="0.4" pos="0 0 0.1" diaginertia="0.001 0.001 0.0003"/>
<body name="elbow_link" pos="0 0 0.2">
<joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" frictionloss="0.03"/>
<inertial mass="0.2" pos="0 0 0.08" diaginertia="0.0004 0.0004 0.0001"/>
</body></body></body></worldbody><actuator><position joint="pan" kp="6" kv="0.1"/>
<position joint="lift" kp="8"/><position joint="elbow" kp="3"/></actuator></mujoco>"""


def described(folder: Path) -> System:
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    return load_model(folder / "model.yaml")


def tones(rng: np.random.Generator, frequencies: tuple[float, ...]) -> np.ndarray:
    """Sines of random phases, one of each frequency [Hz]."""
    return sum(np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6.28)) for f in frequencies)


def records_of(system: System, count: int = 4) -> Dataset:
    """Goals and the motor angles that a system answers with, the last record a test record."""
    return simulated(
        system,
        count,
        np.random.default_rng(5),
        ("goal", "rad", "q_m"),
        lambda rng: 0.4 * tones(rng, (0.4, 0.9, 1.7)) * np.minimum(TIME / 0.3, 1.0),
    )


def simulated(
    system: System,
    count: int,
    rng: np.random.Generator,
    channels: tuple[str, str, str],
    command: Callable[[np.random.Generator], np.ndarray],
) -> Dataset:
    """Records of all joints with the angles that a system answers with, and noise; the last one a test record.

    Args:
        system: the machine.
        count: of records.
        rng: of commands and noise.
        channels: what joints are commanded by, its unit, and which angle is logged.
        command: of a joint in a record.
    """
    records, (told, unit, seen) = [], channels
    joints = range(1, len(system.joints) + 1)
    for k in range(count):
        inputs = {f"{told}{j}": command(rng) for j in joints}
        blank = Record(f"run_{k}", TIME, inputs, {f"{seen}{j}": 0.0 * TIME for j in joints})
        batch = make_batch(system, [blank], noise_std={f"{seen}{j}": 1e-6 for j in joints})
        angles = simulate(system, Engine("dry", 4, compiled=True), batch).y[0].numpy()
        angles = angles + NOISE * rng.standard_normal(angles.shape)
        outputs = {f"{seen}{j}": angles[:, j - 1] for j in joints}
        records.append(Record(blank.name, TIME, inputs, outputs, "train" if k < count - 1 else "test"))
    inputs = tuple(Channel(f"{told}{j}", unit) for j in joints)
    outputs = tuple(Channel(f"{seen}{j}", "rad", NOISE) for j in joints)
    return Dataset("arm", inputs, outputs, tuple(records), STEP)


def of_joint(dataset: Dataset, nominal: System, joint: int) -> Answer:
    """What a joint, by its number from 0, says by itself."""
    records = with_others_measured(moving_records(dataset, joint), nominal, joint)
    return answered(records, alone(nominal, joint))

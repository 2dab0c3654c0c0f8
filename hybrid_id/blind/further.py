"""A further experiment on the machine of a case: the same machine and encoders, with a command of one's own."""

from collections.abc import Sequence

import numpy as np

from hybrid_id.blind.campaign import SAMPLE_TIME
from hybrid_id.blind.case import Case
from hybrid_id.blind.physics.bench import Encoders, Program, run
from hybrid_id.errors import InputError
from hybrid_id.records.record import Record

NAME = "further"


def further_record(
    case: Case, joint: int, command: Sequence[float], sample_time: float, *, seed: int
) -> Record:
    """Measure the machine of a case under an open-loop voltage.

    Noise is new, of the case's size; the small random torques are those of its first record.

    Args:
        case: by `draw.same_case`.
        joint: whose motor gets the voltage, from 1; the others get none.
        command: voltage (T,) [V]; the supply limits it.
        sample_time: [s]; has to be that of the case.
        seed: of the noise.
    """
    if abs(sample_time - SAMPLE_TIME) > 1e-9:
        raise InputError(f"a further record of {case.name} needs the sample time {SAMPLE_TIME} s of its case")
    campaign, joints, samples = case.campaign, case.robot.joints, len(command)
    rng = np.random.default_rng([seed, 2])
    feed = np.zeros((samples, joints, 1))
    feed[:, joint - 1, 0] = command
    still, limit = np.zeros((joints, 1)), np.full((joints, 1), case.robot.supply)
    pushed = campaign.program.disturbance[:, :, 0]
    torque = np.stack([np.resize(pushed[:, i], samples) for i in range(joints)], axis=1)[..., None]
    std = campaign.encoders.jitter.std(axis=(0, 2))
    jitter = rng.standard_normal((samples, len(std), 1)) * std[:, None]
    encoders = Encoders(campaign.encoders.quantum, jitter, campaign.encoders.link)
    program = Program(feed, np.zeros_like(feed), still, still, still, limit, torque)
    volts, measured = run(case.plant(), program, encoders, sample_time=SAMPLE_TIME)
    outputs = [f"q_m{i + 1}" for i in range(joints)] + ["q_a1"] * encoders.link
    return Record(
        name=NAME,
        time=np.round(SAMPLE_TIME * np.arange(samples), 6),
        inputs={f"u{i + 1}": volts[:, i, 0] for i in range(joints)},
        outputs={name: np.round(measured[:, i, 0], 7) for i, name in enumerate(outputs)},
        role="train",
        note="further experiment",
    )

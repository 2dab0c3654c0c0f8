"""What chance decides in a twin: parameters of a run, random torques, noise of the encoders."""

from collections.abc import Sequence

import numpy as np

from hybrid_id.twin.rotor import NO_RIPPLE, TorqueRipple
from hybrid_id.twin.sections import Encoder
from hybrid_id.twin.settings import Twin

Truth = dict[str, float]


def levels(twin: Twin) -> np.ndarray:
    """True f_11 of each motor (n_motors,), by which torques of disturbances are measured."""
    return np.array([twin.truth["f_11" + motor] for motor in twin.kind.motors])


def ripples(twin: Twin) -> list[TorqueRipple]:
    """The torque ripple of each motor."""
    ripple = twin.disturbances.torque_ripple
    return [
        TorqueRipple(ripple.share * level, ripple.periods) if ripple else NO_RIPPLE for level in levels(twin)
    ]


def draw_torques(twin: Twin, n_samples: int, random: np.random.Generator) -> np.ndarray:
    """Random torques (n_motors, T) of one run [N m]."""
    noise = twin.disturbances.torque_noise * levels(twin)[:, None]
    return random.normal(scale=noise, size=(len(noise), n_samples))


def encoders(twin: Twin) -> dict[str, Encoder]:
    """The encoder of each measured angle."""
    encoders = {f"q_m{i + 1}": twin.disturbances.encoder for i in range(len(twin.kind.motors))}
    link = twin.disturbances.link_encoder
    return encoders | ({"q_a1": link} if link else {})


def draw_truth(twin: Twin, pose: Sequence[float], random: np.random.Generator) -> Truth:
    """Parameters of one run, drifted, and the start angle of each motor."""
    truth = {name: twin.truth[name] for name in twin.kind.parameters}
    drift = twin.disturbances.friction_drift
    for name in twin.kind.drifting:
        truth[name] *= random.uniform(1 - drift, 1 + drift)
    limit = twin.disturbances.start_angle
    for motor, angle, ratio in zip(twin.kind.motors, pose, twin.gear_ratios, strict=True):
        truth[f"q_0{motor}"] = ratio * angle + random.uniform(-limit, limit)
    return truth


def read_encoder(angle: np.ndarray, encoder: Encoder, random: np.random.Generator) -> np.ndarray:
    """Reading of an encoder [rad]: white noise, then rounding to the nearest count."""
    noisy = angle + random.normal(scale=encoder.noise, size=angle.shape)
    return encoder.quantum * np.round(noisy / encoder.quantum)

"""Computed torque with models of growing completeness, in closed loops with the twins (paper, Figs 4, 5, 8 and 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import PlainValidator
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from hybrid_id.machines.physics.stick_slip import advance
from hybrid_id.paper.twin import read_settings
from hybrid_id.systems.chain import System

TABLE_1 = {"P_m1m1": 19.059e-3, "P_m2m1": 0.0254, "P_m1m2": 42.62e-3, "P_m2m2": 0.0107}
"""Motor constants of the data sheets, as the paper prints them, in the units of the reading notes."""
MODELS = ("MM", "IFLRM", "IFRM")
FRICTION = ("f_11", "f_12", "f_21", "f_22", "f_3")
INERTIAS = {"J": 1, "P_1": 1, "P_2": 2, "P_3": 2, "P_4": 2}
"""The link that each inertia belongs to."""
WIDTH = 1.0
"""Desired speed at which dry friction is compensated to 76 % [rad/s, motor]."""
SMOOTHING = 0.01
"""Standard deviation [s] of the Gaussian that smooths the motion planned for a motor behind a gear with play."""
Array = Annotated[np.ndarray, PlainValidator(lambda kept: np.array(kept, float))]
"""What a file of results holds as lists, with null for what is not a number."""


def reference(
    joints: Sequence[Sequence[tuple[float, float]]], *, duration: float, sample_time: float, fade: float
) -> np.ndarray:
    """Sums of sines that set in smoothly from rest at zero: joint angles, speeds, accelerations, ``(3, T, n_joints)``.

    Args:
        joints: for each joint its sines, each (amplitude [rad], frequency [Hz]).
        duration: length [s].
        sample_time: step [s].
        fade: time over which the motion sets in [s]; angle, speed and acceleration start at zero.
    """
    time = sample_time * np.arange(round(duration / sample_time))
    s = np.clip(time / fade, 0.0, 1.0)
    # smoothest polynomial with three derivatives zero at both ends
    rise = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    rate, curvature = 140 * s**3 * (1 - s) ** 3 / fade, 420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / fade**2
    motions = []
    for sines in joints:
        a, w = (np.array(values)[:, None] for values in zip(*sines, strict=True))
        w = 2 * np.pi * w
        x, v = (a * np.sin(w * time)).sum(0), (a * w * np.cos(w * time)).sum(0)
        acceleration = rise * (-(w**2) * a * np.sin(w * time)).sum(0) + 2 * rate * v + curvature * x
        motions.append([rise * x, rise * v + rate * x, acceleration])
    return np.moveaxis(np.array(motions), 0, 2)


class ComputedTorque:
    """``u = (M (a_d + K_v e_v + K_p e_q) + c + friction) / (torque per unit of u)``, for B variants of a model at once.

    Angles and speeds are the motors'. Behind a rigid gear M and c are taken at the measured state, so that with the
    right model the error obeys ``e'' + K_v e' + K_p e = 0``; dry friction is taken at the desired speed, which does
    not chatter. Behind a spring the motor must lead its link: the torque that the link's motion needs gives the
    spring's deflection (the inverse of eq. 12), and the motor follows the angle planned so.

    Source: computed torque as in the paper's section III.C; J. Y. S. Luh, M. W. Walker, R. P. C. Paul, IEEE Trans.
    Automatic Control 25(3), 1980.

    Args:
        system: the identified model: rigid gears, or one link behind a spring.
        theta: parameters of the variants in table order, ``(n_p, B)``.
        motion: of the links, see :func:`reference`.
        sample_time: its step [s].
        bandwidth: of the error's dynamics [rad/s]: ``K_p = bandwidth^2``, ``K_v = 2 bandwidth``.
        limit: largest voltage.
    """

    def __init__(
        self,
        system: System,
        theta: Tensor,
        motion: np.ndarray,
        *,
        sample_time: float,
        bandwidth: float,
        limit: float,
    ) -> None:
        self.system, self.limit, self.kp, self.kv = system, limit, bandwidth**2, 2.0 * bandwidth
        self.views = system.views(list(theta))
        self.lanes = theta.shape[1]
        self.rotors = [system.speed_rows.index(joint.positions[0] + 1) for joint in system.joints]
        planned = []
        for joint, wanted in zip(system.joints, torch.as_tensor(motion).unbind(2), strict=True):
            link = wanted[..., None].expand(-1, -1, self.lanes)
            if joint.rigid:
                planned.append(joint.gear_ratio * link)
            else:
                planned += [joint.gear_ratio * (link + self._lead(link, sample_time)), link]
        self.plan = torch.stack(planned, 1)
        """Angles, speeds and accelerations of every rotor and link, ``(3, n_speeds, T, B)``."""

    @torch.no_grad()
    def command(self, k: int, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Voltages of sample ``k``, limited, ``(n_joints, B)``.

        Args:
            k: number of the sample.
            angles: motor angles as the encoders read them [rad], ``(n_joints, B)``.
            speeds: motor speeds [rad/s].
        """
        planned = self.plan[:, :, k]
        x = list(planned[:2].transpose(0, 1).flatten(0, 1))  # angle and speed of each rotor and link
        accelerations = list(planned[2])
        for joint, s, q, v in zip(
            self.system.joints, self.rotors, *map(torch.as_tensor, (angles, speeds)), strict=True
        ):
            error = self.kp * (planned[0, s] - q) + self.kv * (planned[1, s] - v)
            accelerations[s] = accelerations[s] + error
            if joint.rigid:
                x[2 * s], x[2 * s + 1] = q, v
        along = planned[1]
        idle, driven = (self._voltages(value * torch.ones_like(x[0])) for value in (0.0, 1.0))
        balances = self.system.balances(
            x, idle, self.views, list(along.abs()), list((along > 0).to(along.dtype))
        )
        reactions, commands = balances.reactions(accelerations), []
        for joint, s in zip(self.system.joints, self.rotors, strict=True):
            balance, direction = balances.speeds[s], torch.tanh(along[s] / WIDTH)
            torque, unit = (joint.drive.torque(x, u, self.views) for u in (idle, driven))
            force = (
                balance.inertia * accelerations[s] + reactions[s] + direction * balance.level - balance.smooth
            )
            commands.append(force / (unit - torque))
        return torch.stack(commands).clamp(-self.limit, self.limit).numpy()

    def _voltages(self, value: Tensor) -> dict[str, Tensor]:
        return dict.fromkeys((f"u{joint.number}" for joint in self.system.joints), value)

    @torch.no_grad()
    def _lead(self, link: Tensor, step: float) -> Tensor:
        """Deflection of the spring with which one link gets the torque that it needs, and its rates, ``(3, T, B)``."""
        (joint,) = self.system.joints
        angle, speed, acceleration = link
        forward = (speed > 0).to(speed.dtype)
        ahead, behind = torch.ones_like(angle), -torch.ones_like(angle)
        for _ in range(55):  # bisection between 1 rad on either side
            middle = 0.5 * (ahead + behind)
            x = [joint.gear_ratio * (angle + middle), joint.gear_ratio * speed, angle, speed]
            magnitudes = [x[1].abs(), speed.abs()]
            idle = self._voltages(torch.zeros_like(angle))
            balance = self.system.balances(x, idle, self.views, magnitudes, [forward, forward]).speeds[1]
            direction = torch.tanh(joint.gear_ratio * speed / WIDTH)
            short = balance.inertia * acceleration + direction * balance.level > balance.smooth
            behind, ahead = torch.where(short, middle, behind), torch.where(short, ahead, middle)
        smooth = gaussian_filter1d(0.5 * (ahead + behind).numpy(), SMOOTHING / step, axis=0, mode="nearest")
        rate = np.gradient(smooth, step, axis=0)
        return torch.as_tensor(np.stack([smooth, rate, np.gradient(rate, step, axis=0)]))


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """Closed loops of m models, j joints, n seeds.

    Attributes:
        models: their names.
        time: ``(T,)`` s.
        desired: joint angles ``(T, j)`` rad.
        angle: of the first seed ``(T, j, m)`` rad.
        rms: ``(m, j, n)`` rad.
        peak: ``(m, j, n)`` rad.
        saturated: share of samples at the limit, ``(m, j, n)``.
    """

    models: tuple[str, ...]
    time: Array
    desired: Array
    angle: Array
    rms: Array
    peak: Array
    saturated: Array


def three_models(system: System, inertias: Mapping[str, float], error: float, seeds: Sequence[int]) -> Tensor:
    """Parameters of MM, IFLRM and IFRM for every seed, ``(n_p, 3 n)``, models outermost.

    MM has the motor constants of Table 1 and each link's inertia off by the same share, up or down by seed.

    Args:
        system: the identified model.
        inertias: the machine's true ones, from which the mathematical model's are off.
        error: that share.
        seeds: one for each run.
    """
    names = [info.name for info in system.table]
    theta = system.theta().detach()[:, None].repeat(1, 3 * len(seeds))
    bare = [k for k, name in enumerate(names) if name.removesuffix("m1").removesuffix("m2") in FRICTION]
    theta[bare, : 2 * len(seeds)] = 0.0
    for lane, seed in enumerate(seeds):
        signs = inertia_signs(seed)
        for k, name in enumerate(names):
            if name in inertias:
                theta[k, lane] = inertias[name] * (1.0 + error * signs[INERTIAS[name] - 1])
            elif name in ("P_m1", "P_m2") or name in TABLE_1:
                theta[k, lane] = TABLE_1[name if name in TABLE_1 else f"{name}m1"]
    return theta


def inertia_signs(seed: int) -> np.ndarray:
    """Whether the mathematical model of a seed has too much (1) or too little (-1) inertia, link by link."""
    return np.random.default_rng([seed, 77]).choice([-1.0, 1.0], 2)


def compare_controllers(
    plan: Mapping[str, Any],
    case: str,
    config: Mapping[str, Any],
    systems: Mapping[str, System],
    seeds: Sequence[int],
) -> TrackingResult:
    """Computed torque with several models on the same machines, seed by seed.

    Args:
        plan: gains, limits and references, see `tracking` in `configs/reproduce.yaml`.
        case: which of its references.
        config: settings of the twin.
        systems: the models by name; one alone is compared with what the paper takes of it, see `three_models`.
        seeds: of the twins' disturbances.
    """
    step, count = config["sample_time"], len(seeds)
    motion = reference(plan["cases"][case], duration=plan["duration"], sample_time=step, fade=plan["fade"])
    if len(systems) > 1:
        models = {name: (s, s.theta().detach()[:, None].repeat(1, count)) for name, s in systems.items()}
    else:
        (system,) = systems.values()
        inertias = {name: config["truth"][name] for name in INERTIAS if name in config["truth"]}
        variants = three_models(system, inertias, plan["inertia_error"], seeds).split(count, 1)
        models = {name: (system, theta) for name, theta in zip(MODELS, variants, strict=True)}
    controllers = [
        ComputedTorque(
            system, theta, motion, sample_time=step, bandwidth=plan["bandwidth"], limit=plan["limit"]
        )
        for system, theta in models.values()
    ]
    planned = np.concatenate([c.plan[:2, c.rotors].numpy() for c in controllers], axis=-1)
    # all disturbances of the campaigns but that of the start angle
    twin = read_settings({**config, "disturbances": {**config["disturbances"], "start_angle": 0.0}})
    own = len(twin.excitation.experiments) + 1
    generators = [np.random.default_rng([seed, own]) for _ in models for seed in seeds]
    truths = [twin.draw_truth([0.0] * motion.shape[2], random) for random in generators]
    machine, x = twin.begin(truths, ripple=True)
    mode, rotors = machine.initial_mode(x), slice(0, 2 * motion.shape[2], 2)
    links, ratios = rotors, np.array(twin.gear_ratios)[:, None]
    if twin.machine == "one_link_flexible":
        links, ratios = slice(2, 3), 1.0
    # the filter that differentiates the encoder's angle sees the deviation from the planned motion alone, so that the
    # planned speed comes without its lag
    keep = np.exp(-2 * np.pi * plan["cutoff"] * step)
    last = drift = np.zeros_like(x[rotors])
    angles, voltages = [], []
    for k in range(motion.shape[1]):
        angles.append(x[links] / ratios)
        readings = [
            twin.disturbances.read(q, random) for q, random in zip(x[rotors].T, generators, strict=True)
        ]
        q = np.array(readings).T
        deviation = q - planned[0, :, k]
        drift = keep * drift + (1.0 - keep) * (deviation - last) / step if k else drift
        last, v = deviation, planned[1, :, k] + drift
        lanes = zip(controllers, *(np.split(values, len(models), axis=1) for values in (q, v)), strict=True)
        voltages.append(np.concatenate([c.command(k, angle, speed) for c, angle, speed in lanes], axis=1))
        torques = np.array([twin.draw_torques(1, random)[:, 0] for random in generators]).T
        inputs = np.concatenate((voltages[-1], torques))
        x, mode = advance(machine, x, mode, inputs, step, substeps=twin.substeps)
    angle, voltage = np.array(angles), np.array(voltages)
    error = motion[0][..., None] - angle

    def by_model(values: np.ndarray) -> np.ndarray:
        """(j, m n) to (m, j, n)."""
        return values.reshape(values.shape[0], len(models), count).swapaxes(0, 1)

    return TrackingResult(
        tuple(models),
        time=step * np.arange(motion.shape[1]),
        desired=motion[0],
        angle=angle[..., ::count],
        rms=by_model(np.sqrt(np.mean(error**2, 0))),
        peak=by_model(np.abs(error).max(0)),
        saturated=by_model(np.mean(np.abs(voltage) >= plan["limit"] * (1 - 1e-9), 0)),
    )

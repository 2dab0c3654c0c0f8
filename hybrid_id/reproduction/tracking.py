"""Computed torque with models of growing completeness, on the twins (paper, Figs 4, 5, 8 and 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from hybrid_id.control import ComputedTorque, Reference, sines, track
from hybrid_id.machines.twin.paper import TABLE_1
from hybrid_id.machines.twin.plant import Plant
from hybrid_id.reproduction.plan import TrackingPlan
from hybrid_id.reproduction.result import TrackingResult
from hybrid_id.systems.chain import System

MODELS = ("MM", "IFLRM", "IFRM")
FRICTION = ("f_11", "f_12", "f_21", "f_22", "f_3")
INERTIAS = {"J": 1, "P_1": 1, "P_2": 2, "P_3": 2, "P_4": 2}
"""The link that each inertia belongs to."""


class TwinPlant:
    """A twin as what :func:`hybrid_id.control.track` drives; runs start exactly where the reference does."""

    def __init__(self, config: Mapping[str, Any], seeds: Sequence[int]) -> None:
        calm = {**config, "disturbances": {**config["disturbances"], "start_angle": 0.0}}
        self.plant = Plant(calm, seeds)
        self.ratios = np.atleast_1d(config["gear_ratio"])
        self.reading = self._angles(self.plant.measure())

    def measure(self) -> np.ndarray:
        """Motor angles of the last sample [rad], ``(n_joints, B)``."""
        return self.reading

    def true_angles(self) -> np.ndarray:
        """Link angles [rad], ``(n_joints, B)``."""
        states = self.plant.states
        if "q_a1" in states:
            return states["q_a1"][None]
        return self._angles(states) / self.ratios[:, None]

    def step(self, command: np.ndarray) -> None:
        """Hold the voltages for a sample."""
        self.reading = self._angles(self.plant.step(command))

    def _angles(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        return np.stack([values[f"q_m{i + 1}"] for i in range(len(self.ratios))])


def three_models(
    system: System, inertias: Mapping[str, float], error: float, seeds: Sequence[int]
) -> torch.Tensor:
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


def compare_models(
    plan: TrackingPlan, case: str, config: Mapping[str, Any], system: System, seeds: Sequence[int]
) -> TrackingResult:
    """MM, IFLRM and IFRM on the same machine, seed by seed."""
    reference = reference_of(plan, case, config)
    inertias = {name: config["truth"][name] for name in INERTIAS if name in config["truth"]}
    theta = three_models(system, inertias, plan.inertia_error, seeds)
    control = ComputedTorque(system, reference, bandwidth=plan.bandwidth, limit=plan.limit, theta=theta)
    found = track(control, TwinPlant(config, list(seeds) * len(MODELS)), reference, cutoff=plan.cutoff)
    return _result(MODELS, plan, reference, found.angle, found.command, len(seeds))


def compare_gears(
    plan: TrackingPlan, config: Mapping[str, Any], models: Mapping[str, System], seeds: Sequence[int]
) -> TrackingResult:
    """Controllers with different models of the gear on the machine with backlash."""
    reference = reference_of(plan, "backlash", config)
    runs = []
    for system in models.values():
        theta = system.theta().detach()[:, None].repeat(1, len(seeds))
        control = ComputedTorque(system, reference, bandwidth=plan.bandwidth, limit=plan.limit, theta=theta)
        runs.append(track(control, TwinPlant(config, seeds), reference, cutoff=plan.cutoff))
    angle = np.concatenate([run.angle for run in runs], 2)
    voltage = np.concatenate([run.command for run in runs], 2)
    return _result(tuple(models), plan, reference, angle, voltage, len(seeds))


def reference_of(plan: TrackingPlan, case: str, config: Mapping[str, Any]) -> Reference:
    """The desired motion of a case at the sample time of its machine."""
    return sines(plan.cases[case], duration=plan.duration, sample_time=config["sample_time"], fade=plan.fade)


def _result(
    models: tuple[str, ...],
    plan: TrackingPlan,
    reference: Reference,
    angle: np.ndarray,
    voltage: np.ndarray,
    count: int,
) -> TrackingResult:
    error = reference.angle[..., None] - angle

    def by_model(values: np.ndarray) -> np.ndarray:
        """(j, m n) to (m, j, n)."""
        return values.reshape(values.shape[0], len(models), count).swapaxes(0, 1)

    return TrackingResult(
        models, reference.time, reference.angle,
        angle[..., ::count], voltage[..., ::count],
        by_model(np.sqrt(np.mean(error**2, 0))), by_model(np.abs(error).max(0)),
        by_model(np.mean(np.abs(voltage) >= plan.limit * (1 - 1e-9), 0)),
    )  # fmt: skip

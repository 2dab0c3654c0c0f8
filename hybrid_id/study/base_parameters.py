"""How well records excite the base parameters of a robot, from their motion alone and before any fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.robots.base_parameters import (
    BaseParameters,
    base_parameters,
    inertial_parameters,
    whole_regressor,
)
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.systems.by_joint import measured_motion
from hybrid_id.systems.chain import System

TORQUE_ERROR = 0.05
"""Error of a joint's torque that the predicted standard errors assume, as a share of its root mean square."""
INDEPENDENT = 0.02
"""Time [s] after which such an error is another one: torque errors are no white noise at the sample rate."""
UNSURE = 0.3
"""Standard error of a base parameter, as a share of its value, from which it is not well excited: of the 30 % rule."""
NULL = 1e-10
"""Share of the largest singular value below which a direction is not excited at all."""


@dataclass(frozen=True, eq=False)
class BaseParameterCheck:
    """Base parameters of a robot, and how the motion of records excites them.

    Attributes:
        base: the combinations.
        values: of the model's start values, ``(n_b,)`` in kg, kg m or kg m^2.
        std: predicted standard errors, ``(n_b,)``; inf where the motion does not excite one. See :data:`TORQUE_ERROR`,
            :data:`INDEPENDENT`; dry and viscous friction of every joint is taken to be estimated as well.
        condition_number: of the weighted regressor with columns of length 1, friction among them; inf where a
            combination is not excited.
        missing: why nothing is said of the motion; empty where something is.
    """

    base: BaseParameters
    values: np.ndarray
    std: np.ndarray
    condition_number: float
    missing: str = ""

    @property
    def relative_std(self) -> np.ndarray:
        """Standard errors over the values; inf where a value is 0."""
        size = np.abs(self.values)
        return np.divide(self.std, size, out=np.full_like(size, np.inf), where=size > 0)

    @property
    def unsure(self) -> np.ndarray:
        """Which base parameters the motion excites too little, ``(n_b,)``: standard errors of :data:`UNSURE` or more.

        One whose value is 0 has no relative error, and is judged by whether it is excited at all.
        """
        return np.where(self.values != 0.0, self.relative_std >= UNSURE, np.isinf(self.std))


def check_base_parameters(dataset: Dataset, system: System) -> BaseParameterCheck:
    """Base parameters of a robot, and how the train records' own angles, speeds and accelerations excite them.

    Args:
        dataset: records of the whole robot.
        system: a robot with a tree.

    Raises:
        InputError: the model has no description of a robot.
    """
    tree = tree_of(system)
    base = base_parameters(tree)
    phi = inertial_parameters(tree)
    values = base.grouping @ phi
    motions = []
    try:
        for record in dataset.train or dataset.records:
            motion = [measured_motion(record, system, k) for k in range(len(tree.joints))]
            every = max(round(INDEPENDENT / record.sample_time), 1)
            motions.append(np.stack([np.stack(rows, 1)[::every] for rows in zip(*motion, strict=True)]))
    except InputError as error:
        return BaseParameterCheck(base, values, np.full(len(values), np.inf), np.inf, str(error))
    w, columns = regressors(tree, base, motions)
    size = TORQUE_ERROR * np.sqrt(np.mean((w @ phi) ** 2, axis=0))
    size = np.maximum(size, 1e-6 * size.max())
    weighted = (columns / size[:, None]).reshape(-1, columns.shape[2])
    length = np.linalg.norm(weighted, axis=0)  # columns of length 1, errors of 1
    moving = length > 0.0
    std = np.full(len(length), np.inf)
    _, singular, directions = np.linalg.svd(weighted[:, moving] / length[moving], full_matrices=False)
    seen = singular > NULL * singular[0]
    with np.errstate(divide="ignore"):
        variance = (directions[seen] ** 2 / singular[seen, None] ** 2).sum(0)
    hidden = (directions[~seen] ** 2).sum(0) > NULL
    std[moving] = np.where(hidden, np.inf, np.sqrt(variance) / length[moving])
    whole = bool(moving.all()) and bool(seen.all())
    condition = float(singular[0] / singular[-1]) if whole else np.inf
    return BaseParameterCheck(base, values, std[: len(values)], condition)


def tree_of(system: System) -> RigidBodyTree:
    """A robot's tree with the inertias, rotors and gravity that the model's values say.

    Raises:
        InputError: the model has no description of a robot.
    """
    if system.tree is None:
        raise InputError("Base parameters belong to a robot; give a model that names its description.")
    views = system.views([value.reshape(1) for value in system.theta().detach()])
    tree = system.tree.with_bodies([body.held() for body in system.arm.bodies(views).values()])
    tree = tree.falling(system.arm.gravity(views))
    joints = tuple(
        replace(known, armature=float(joint.inertia[1].rotor(views[joint.inertia[0]], r)) * r**2)
        for known, joint, r in zip(tree.joints, system.joints, system.gear_ratio, strict=True)
    )
    return replace(tree, joints=joints)


def regressors(
    tree: RigidBodyTree, base: BaseParameters, motions: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Whole regressor, and torques by each base parameter, then by each joint's dry and viscous friction.

    Args:
        tree: of the robot.
        base: its base parameters.
        motions: positions, speeds and accelerations, ``(3, T_k, n)`` each.

    Returns:
        ``(T, n, 11 n)`` and ``(T, n, n_b + 2 n)``.
    """
    w = np.concatenate([whole_regressor(tree, *motion) for motion in motions])
    v = np.concatenate([motion[1] for motion in motions])
    friction = (rows[:, :, None] * np.eye(v.shape[1]) for rows in (np.sign(v), v))  # of each joint alone
    return w, np.concatenate([w[..., list(base.independent)], *friction], axis=2)

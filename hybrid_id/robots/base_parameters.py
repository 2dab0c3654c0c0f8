"""Base parameters: the combinations of a robot's inertial parameters that act on its joints at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hybrid_id.robots.tree import TEN, RigidBodyTree

ROTOR = "Ia"
"""Inertia of a joint's rotor, seen at the joint [kg m^2 or kg]."""
STATES = 50
"""Random states for each column, at which the regressor is looked at."""
DEPENDENT = 1e-8
"""Share of a column that is left beside the others, below which it depends on them."""
_ORDER = (("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz"), ("m",), (ROTOR,))
"""Joint by joint inertias and moments, then masses, then rotors: the first of those that act alike stands for all."""


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Combinations ``beta = K phi`` with ``tau = W phi = W_b beta`` for every motion; W_b are columns of W.

    Attributes:
        names: of the inertial parameters phi, each with its joint, ``Izz_elbow`` (11 n).
        independent: columns of W that are W_b (n_b).
        grouping: K, one row a base parameter ``(n_b, 11 n)``.
        without_effect: names of the parameters that no torque depends on.
    """

    names: tuple[str, ...]
    independent: tuple[int, ...]
    grouping: np.ndarray
    without_effect: tuple[str, ...]

    def coefficients(self, number: int) -> dict[str, float]:
        """The parameters of one combination, what stands for it first."""
        first, row = self.independent[number], self.grouping[number]
        order = [first, *(k for k in np.flatnonzero(row).tolist() if k != first)]
        return {self.names[k]: float(row[k]) for k in order}

    def text(self, number: int, most: int = 0) -> str:
        """One combination as a sum; of more terms than ``most`` the first ones and how many there are more."""
        terms = list(self.coefficients(number).items())
        shown = terms[:most] if 0 < most < len(terms) else terms
        words = shown[0][0] + "".join(
            f" {'-' if factor < 0 else '+'} {'' if abs(factor) == 1 else f'{abs(factor):.4g} '}{name}"
            for name, factor in shown[1:]
        )
        return words if len(shown) == len(terms) else f"{words} + {len(terms) - len(shown)} more"


def whole_regressor(tree: RigidBodyTree, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Regressor W of links and rotors along a motion, ``(T, n, 11 n)``: each joint's ten columns, then its rotor's.

    Args:
        tree: of the robot.
        q: positions [rad or m], ``(T, n)``.
        v: speeds [rad/s or m/s], ``(T, n)``.
        a: accelerations [rad/s^2 or m/s^2], ``(T, n)``.
    """
    columns = [[torch.as_tensor(c) for c in np.asarray(rows, float).T.copy()] for rows in (q, v, a)]
    angles, speeds, accelerations = columns
    rows = tree.regressor(tree.poses(angles), speeds, accelerations)
    n, each = len(rows), len(TEN)
    found, gearing = np.zeros((len(q), n, n, each + 1)), np.array(tree.gearing)
    shafts = a @ gearing.T  # a coupled motor turns with several joints
    for i, row in enumerate(rows):
        for k, value in enumerate(row):
            found[:, i, k // each, k % each] = value.numpy() if isinstance(value, Tensor) else value
        found[:, i, :, each] = shafts * gearing[:, i]
    return found.reshape(len(q), n, n * (each + 1))


def base_parameters(tree: RigidBodyTree) -> BaseParameters:
    """The combinations of inertial parameters that the torques of a robot depend on, its rotors included.

    From W at random states within the joints' limits: a column that depends linearly on earlier ones joins them. The
    order makes the combinations the usual ones.

    Source: M. Gautier, Numerical Calculation of the Base Inertial Parameters of Robots, J. Robotic Systems 8(4), 1991.
    Differs from it by Gram-Schmidt orthogonalisation, done twice, in place of the QR decomposition.

    Args:
        tree: of the robot.
    """
    n, rng = len(tree.joints), np.random.default_rng(0)
    low, high = np.array([_reach(*joint.limits) for joint in tree.joints]).T
    count = STATES * (len(TEN) + 1)
    q = rng.uniform(low, high, (count, n))
    v, a = rng.standard_normal((2, count, n))
    w = whole_regressor(tree, q, v, a).reshape(count * n, -1)
    symbols = [*TEN, ROTOR]
    names = tuple(f"{symbol}_{joint}" for joint in tree.names for symbol in symbols)
    order = [
        k * len(symbols) + symbols.index(symbol) for group in _ORDER for k in range(n) for symbol in group
    ]
    length = np.linalg.norm(w, axis=0)
    basis, independent = np.empty((len(w), 0)), []
    for column in order:
        left = w[:, column]
        for _ in range(2):
            left = left - basis @ (basis.T @ left)
        rest = float(np.linalg.norm(left))
        if rest > DEPENDENT * max(float(length[column]), DEPENDENT * float(length.max())):
            basis = np.column_stack([basis, left / rest])
            independent.append(column)
    independent.sort()
    grouping = np.linalg.lstsq(w[:, independent], w, rcond=None)[0]
    grouping[np.abs(grouping) < 1e-7] = 0.0
    near = np.round(grouping)
    grouping = np.where(np.abs(grouping - near) < 1e-7, near, grouping)
    silent = tuple(name for name, row in zip(names, grouping.T, strict=True) if not row.any())
    return BaseParameters(names, tuple(independent), grouping, silent)


def _reach(low: float, high: float) -> tuple[float, float]:
    """A joint's range [rad or m], of at most one turn: no angle beyond it tells more."""
    if np.isinf(low):
        low = min(-np.pi, high - 2.0 * np.pi)
    return low, min(high, low + 2.0 * np.pi)


def inertial_parameters(tree: RigidBodyTree) -> np.ndarray:
    """Vector phi of a tree of plain numbers, ``(11 n,)``, in the order of :func:`whole_regressor`."""
    each = zip(tree.inertias(), tree.joints, strict=True)
    return np.array([float(value) for one, joint in each for value in (*one.ten, joint.armature)])

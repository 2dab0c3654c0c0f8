"""Random robots, and rows of one sample."""

import numpy as np
import torch


def rows(values):
    return [torch.tensor([value], dtype=torch.float64) for value in values]


def numbers(found):
    return np.array([float(value) for value in found])


def random_text(seed):
    """A random MJCF of 1 to 8 joints: branches, slides, several joints in a body, fixed bodies, zeros elsewhere."""
    rng = np.random.default_rng(seed)
    count, parents = int(rng.integers(1, 9)), []

    def words(values):
        return " ".join(f"{value:.17g}" for value in values)

    bodies = []
    for k in range(count):
        parents.append(int(rng.integers(-1, k)) if k else -1)
        kind = "slide" if rng.random() < 0.3 else "hinge"
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else rng.normal(size=3)
        spread = rng.uniform(0.1, 1.0, 3)
        inertia = rng.uniform(0.01, 0.1) * (spread.sum() - spread)
        bodies.append(
            f'<body name="b{k}" pos="{words(rng.normal(size=3))}" quat="{words(rng.normal(size=4))}">'
            f'<joint name="j{k}" type="{kind}" axis="{words(axis)}" pos="{words(0.3 * rng.normal(size=3))}" '
            f'ref="{rng.normal():.17g}" armature="{rng.uniform(0, 0.1):.17g}"/>'
            f'<inertial mass="{rng.uniform(0.1, 3):.17g}" pos="{words(0.2 * rng.normal(size=3))}" '
            f'quat="{words(rng.normal(size=4))}" diaginertia="{words(inertia)}"/>'
            f'<body name="f{k}" pos="{words(rng.normal(size=3))}"><inertial mass="0.2" pos="0 0.1 0" '
            'diaginertia="0.01 0.02 0.02"/></body>{children}</body>'
        )

    def nested(parent):
        return "".join(
            bodies[k].replace("{children}", nested(k)) for k in range(count) if parents[k] == parent
        )

    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{words(rng.normal(size=3))}"/>'
        f"<worldbody>{nested(-1)}</worldbody></mujoco>"
    )

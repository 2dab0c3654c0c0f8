"""A tree of 23 joints with 285 unknowns: its gradients and their time: humanoid.py [--seconds 4]

Two legs of six joints and a waist on a fixed pelvis, two arms of five on the torso; masses, centres, inertias and
lengths are drawn about those of an adult of 55 kg. Unknown are stiffness of the loop, armature, viscous and dry
friction and encoder zero of each joint (115), and the ten inertial parameters of each of 17 bodies (170).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybrid_id.components import BodyInertia, Component, MotorEncoder
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.builders import robot
from hybrid_id.systems.chain import System

STEP, NOISE = 0.0025, 3e-4
LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist")
AXES = {"yaw": "0 0 1", "roll": "1 0 0"}
LENGTH = {"knee": 0.4, "ankle_pitch": 0.4, "elbow": 0.28, "wrist": 0.25}
"""From the joint before [m]; the others are 5 cm apart."""
WEIGHT = {"hip_pitch": 7.0, "knee": 3.5, "shoulder_yaw": 1.8, "elbow": 1.2, "waist": 22.0}
"""Mass of what hangs between this joint and the next [kg]; the others weigh 0.8."""
BODIES = 17
"""Of which all ten inertial parameters are unknown: the heaviest."""


def text(rng: np.random.Generator) -> str:
    """MJCF of the tree."""

    def limb(side: str, names: tuple[str, ...], start: str) -> str:
        found = ""
        for name in names:
            place = start if name == names[0] else f"0 0 {-LENGTH.get(name, 0.05):g}"
            found += body(f"{side}_{name}", place, AXES.get(name.rpartition("_")[2], "0 1 0"))
        return found + "</body>" * len(names)

    def body(name: str, place: str, axis: str) -> str:
        kind = name.removeprefix("left_").removeprefix("right_")
        mass = WEIGHT.get(kind, 0.8) * rng.uniform(0.8, 1.2)
        size = 0.1 if mass < 1.0 else 0.3
        x, y, z = mass * size**2 * rng.uniform(0.05, 0.1, 3)
        centre = rng.uniform(-0.02, 0.02, 3)
        centre[2] += 0.15 if kind == "waist" else -0.3 * size
        strong = np.sqrt(mass)
        return (
            f'<body name="{name}" pos="{place}"><joint name="{name}" axis="{axis}" armature="{0.02 * strong:g}" '
            f'damping="{strong:g}" frictionloss="{0.4 * strong:g}"/><inertial mass="{mass:g}" '
            f'pos="{centre[0]:g} {centre[1]:g} {centre[2]:g}" diaginertia="{x:g} {y:g} {z:g}"/>'
        )

    legs = limb("left", LEG, "0 0.1 0") + limb("right", LEG, "0 -0.1 0")
    arms = limb("left", ARM, "0 0.2 0.4") + limb("right", ARM, "0 -0.2 0.4")
    names = [f"{side}_{name}" for side in ("left", "right") for name in LEG]
    names += ["waist", *(f"{side}_{name}" for side in ("left", "right") for name in ARM)]
    stiff = ("hip", "knee", "waist")
    gains = {name: 300 if any(one in name for one in stiff) else 120 for name in names}
    drives = "".join(f'<position joint="{name}" kp="{kp}" kv="3"/>' for name, kp in gains.items())
    world = f"{legs}{body('waist', '0 0 0.1', '0 0 1')}{arms}</body>"
    return f"<mujoco><worldbody>{world}</worldbody><actuator>{drives}</actuator></mujoco>"


def model(rng: np.random.Generator) -> System:
    """The tree with its 285 unknowns."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "humanoid.xml"
        path.write_text(text(rng))
        tree = load_tree(path)
    parts: list[tuple[str, Component]] = [
        (key.rpartition("/")[0], part)
        for key, part in robot(tree).components.items()
        if isinstance(part, Component)
    ]
    n = len(tree.joints)
    parts += [
        (f"joint{k}/sensor", MotorEncoder(offset=Bounded(0.0, -0.3, 0.3, "rad"))) for k in range(1, n + 1)
    ]
    heavy = sorted(tree.bodies, key=lambda one: -float(one.inertia.mass))[:BODIES]
    parts += [(f"joint{one.joint + 1}/load", BodyInertia(one.name)) for one in heavy]
    system = System([1.0] * n, parts, name="robot", tree=tree)
    known = ("k_p", "J_m", "F_v", "F_c", "offset")
    wanted = {
        i.name: replace(i.spec, estimate=i.symbol in known or "/body_inertia" in i.component)
        for i in system.table
    }
    return system.with_specs(wanted)


def timed(what: str, run: Callable[[], Any]) -> Any:
    """What is computed, twice: with the compiler's time, and without."""
    for label in ("with compiling", "again"):
        busy, start = time.process_time(), time.perf_counter()
        found = run()
        print(
            f"{what} {label}: {time.process_time() - busy:.2f} s, wall {time.perf_counter() - start:.2f} s",
            flush=True,
        )
    return found


def main() -> None:
    """Time of a simulation, and of all gradients; how many of them are finite and not zero."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=2323)
    parser.add_argument("--seconds", type=float, default=4.0)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    rng = np.random.default_rng(asked.seed)
    system = model(rng)
    print(f"{len(system.joints)} joints, {len(system.estimated)} unknowns")
    t = np.arange(0.0, asked.seconds, STEP)
    rate, phase = rng.uniform(1.0, 12.0, (2, 23, 1)), rng.uniform(0.0, 6.28, (2, 23, 1))
    goal = 0.15 * (np.sin(rate * t + phase) - np.sin(phase)).sum(0)
    inputs = {f"goal{k + 1}": goal[k] for k in range(23)}
    blank = Record("run", t, inputs, {f"q_m{k + 1}": 0.0 * t for k in range(23)})
    noise = dict.fromkeys(blank.outputs, NOISE)
    batch = make_batch(system, [blank], noise_std=noise, signal_share=0.0)
    theta = system.theta().detach()[:, None]
    engine = with_substeps(system, compiled_for(system, Engine()), batch, theta)
    x = timed("simulation", lambda: simulate(system, engine, batch)).x
    found = timed(
        "gradients", lambda: evaluate(system, engine, batch, x, theta, system.estimated, loss=Loss(), chunk=1)
    )
    columns = found.jacobian[0].flatten(0, 1)[:, len(system.state_names) :]
    finite, moved = torch.isfinite(columns).all(0), columns.abs().amax(0) > 0
    print(f"{int(finite.sum())} of {len(finite)} finite, {int(moved.sum())} not zero; engine {engine}")


if __name__ == "__main__":
    main()

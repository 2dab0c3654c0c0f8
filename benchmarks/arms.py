"""Cost of a 2 ms step of an arm with sensitivities by ten parameters a joint, against the number of its joints.

Both simulate a chain of servos on one thread, from rest, over the same goals:

- compiled: the package's compiled engine: free run, Jacobians of every sample and their chain, which gives the
  sensitivities of all states by ``10 n`` parameters (stiffness of the loop, dry and viscous friction, rotor; mass,
  centre and two stretches of the link) and by the first state as well;
- MuJoCo: ``1 + 10 n`` runs of ``mj_step`` by ``mujoco.rollout``, which loops in C: forward differences, the cost of
  changing the model left out.

Equal error: each is compared with its own solution at steps of 0.05 ms (RK4), as the friction laws differ: MuJoCo's
gives way. MuJoCo takes the cheapest of its integrators and steps whose root mean square error of the angles is not
above the package's; where none is, the most accurate one stands in. Beside it the ratio at MuJoCo's default step of
2 ms (implicitfast), whatever its error. Processor time, medians of repetitions in turns.

Usage: ``python -m benchmarks.arms``; writes `arms.md`, `arms.json` and `docs/arms.png`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

HERE = Path(__file__).resolve().parent
JOINTS = (1, 2, 4, 6, 8, 12)
STEP, SAMPLES, ROWS = 0.002, 500, 8
FINE = 5e-5
"""Step of the solutions that errors are measured against [s]."""
REPEATS = 5
CHOICES = [
    (name, STEP / parts)
    for parts in (1, 2, 4, 8, 16)
    for name in ("implicitfast", "Euler", "implicit", "RK4")
]
"""Integrators of MuJoCo and their steps [s]."""
MASSES = ("c_m", "x_c", "y_c", "z_c", "s_x", "s_z")


def chain(n: int) -> str:
    """MJCF of a chain of n servos about changing axes, lighter towards its end."""
    text, closing = "", ""
    for k in range(n):
        size = 0.9**k
        axis = ("0 0 1", "0 1 0", "1 0 0")[k % 3]
        text += (
            f'<body name="link{k + 1}" pos="{0.0 if k == 0 else 0.08 * size:.4f} 0 0.02"><joint name="joint{k + 1}" '
            f'axis="{axis}" armature="{0.02 * size:.4f}" damping="{0.5 * size:.4f}" frictionloss="{0.06 * size:.4f}"/>'
            f'<inertial mass="{0.15 * size:.4f}" pos="0.04 0.01 0.01" diaginertia="2e-4 1.6e-4 1.2e-4"/>'
        )
        closing += "</body>"
    drives = "".join(f'<position joint="joint{k + 1}" kp="{20 * 0.9**k:.4f}"/>' for k in range(n))
    return f"<mujoco><worldbody>{text}{closing}</worldbody><actuator>{drives}</actuator></mujoco>"


def goals(n: int) -> np.ndarray:
    """Goals [rad] of every record, ``(ROWS, SAMPLES, n)``: two tones a joint."""
    rng, t = np.random.default_rng(n), STEP * np.arange(SAMPLES)
    rate, phase = rng.uniform(2.0, 9.0, (2, ROWS, n)), rng.uniform(0.0, 2 * np.pi, (2, ROWS, n))
    waves = np.sin(rate[..., None] * t + phase[..., None]) - np.sin(phase)[..., None]
    return 0.3 * waves.sum(0).transpose(0, 2, 1)


def ours(path: Path, command: np.ndarray) -> dict[str, Any]:
    """Time of a step with all sensitivities [s], and the error of the angles [rad], of the compiled engine."""
    from hybrid_id.components import BodyInertia
    from hybrid_id.records.record import Record
    from hybrid_id.robots.description import load_tree
    from hybrid_id.simulation.lifted import condense, linearise
    from hybrid_id.simulation.prepare import make_batch
    from hybrid_id.simulation.rollout import simulate
    from hybrid_id.simulation.stability import with_substeps
    from hybrid_id.simulation.step import Engine
    from hybrid_id.systems.builders import robot

    n = command.shape[2]
    system = robot(load_tree(path))
    for k in range(n):
        system = system.with_component(f"joint{k + 1}/load", BodyInertia(f"link{k + 1}"))
    specs = {i.name: replace(i.spec, estimate=True) for i in system.table if i.symbol in MASSES}
    system = system.with_specs(specs)
    wanted = {"k_p", "F_c", "F_v", "J_m", *MASSES}
    free = [k for k, info in enumerate(system.table) if info.symbol in wanted]
    time_axis, still = STEP * np.arange(SAMPLES), np.zeros(SAMPLES)
    outputs = {f"q_m{k + 1}": still for k in range(n)}
    records = [
        Record(f"run{r}", time_axis, {f"goal{k + 1}": command[r, :, k] for k in range(n)}, outputs)
        for r in range(ROWS)
    ]
    batch = make_batch(system, records, noise_std=dict.fromkeys(outputs, 1e-3), signal_share=0.0)
    theta = system.theta().detach()[:, None].expand(-1, ROWS).contiguous()
    engine = with_substeps(system, Engine(compiled=True), batch, theta)

    def run() -> torch.Tensor:
        free_run = simulate(system, engine, batch)
        parts = linearise(system, engine, free_run.x, batch.u, batch.dt, theta, free, batch.outputs)
        return condense(parts, free_run.x)

    start = time.perf_counter()
    run()
    first = time.perf_counter() - start
    fine = simulate(system, replace(engine, substeps=round(STEP / FINE)), batch).y
    error = float((simulate(system, engine, batch).y - fine).square().mean().sqrt())
    return {
        "run": run, "error": error, "substeps": engine.substeps, "first": first, "free": len(free),
        "angles": fine.numpy(),
    }  # fmt: skip


def mujoco_runs(
    path: Path, command: np.ndarray, name: str, step: float
) -> tuple[Callable[[], np.ndarray], Callable[[], np.ndarray]]:
    """What runs all records by MuJoCo with one thread, and what then gives the angles, ``(ROWS, SAMPLES, n)``."""
    import mujoco as known
    from mujoco import rollout

    mujoco: Any = known
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = step
    model.opt.integrator = int(getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}"))
    data, every = mujoco.MjData(model), round(STEP / step)
    held = np.repeat(command[:, :-1], every, axis=1)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros((ROWS, mujoco.mj_stateSize(model, full)))
    states = np.empty((ROWS, held.shape[1], start.shape[1]))

    def run() -> np.ndarray:
        rollout.rollout(model, data, start, held, state=states)
        return states

    def angles() -> np.ndarray:
        found = run()[:, every - 1 :: every, 1 : 1 + model.nq]
        return np.concatenate([np.zeros((ROWS, 1, model.nq)), found], 1)

    return run, angles


def seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


def compared(n: int, folder: Path) -> dict[str, Any]:
    """Both contestants on one arm, in turns."""
    path, command = folder / f"arm{n}.xml", goals(n)
    path.write_text(chain(n))
    mine = ours(path, command)
    fine = mujoco_runs(path, command, "RK4", FINE)[1]()
    errors = {
        (name, step): float(np.sqrt(np.mean((mujoco_runs(path, command, name, step)[1]() - fine) ** 2)))
        for name, step in CHOICES
    }
    good = [choice for choice in CHOICES if errors[choice] <= mine["error"]]
    runs = {choice: mujoco_runs(path, command, *choice)[0] for choice in {*good, *CHOICES[:1], CHOICES[-1]}}
    best = min(errors, key=lambda choice: errors[choice])
    runs.setdefault(best, mujoco_runs(path, command, *best)[0])
    cheapest = min(good, key=lambda choice: seconds(runs[choice])) if good else best
    steps, models = ROWS * (SAMPLES - 1), 1 + mine["free"]
    turns = [
        (seconds(mine["run"]), seconds(runs[cheapest]), seconds(runs[CHOICES[0]])) for _ in range(REPEATS)
    ]
    return {
        "joints": n, "parameters": mine["free"], "substeps": mine["substeps"], "error": mine["error"],
        "first_seconds": mine["first"],
        "compiled_us": 1e6 * statistics.median(t[0] for t in turns) / steps,
        "mujoco_us": 1e6 * statistics.median(t[1] for t in turns) * models / steps,
        "mj_step_us": 1e6 * statistics.median(t[2] for t in turns) / steps,
        "integrator": cheapest[0], "mujoco_step_ms": 1e3 * cheapest[1], "mujoco_error": errors[cheapest],
        "reached": bool(good), "default_error": errors[CHOICES[0]],
        "ratio": statistics.median(t[1] * models / t[0] for t in turns),
        "ratio_at_2_ms": statistics.median(t[2] * models / t[0] for t in turns),
        "model_difference": float(np.sqrt(np.mean((mine["angles"] - fine) ** 2))),
    }  # fmt: skip


def write(rows: list[dict[str, Any]]) -> None:
    """The table, the figures and the plot."""
    (HERE / "arms.json").write_text(json.dumps(rows, indent=1) + "\n")
    head = (__doc__ or "").split("Usage")[0].strip()
    text = "# Arms: sensitivities against the number of joints\n\n![time](../docs/arms.png)\n\n"
    text += f"    python -m benchmarks.arms\n\n{head}\n\n"
    text += (
        "| joints | parameters | compiled | error | MuJoCo, differences | its integrator and step | its error | "
        "ratio | `mj_step` at 2 ms | its error | ratio at 2 ms |\n" + "| --- " * 11 + "|\n"
    )
    for one in rows:
        text += (
            f"| {one['joints']} | {one['parameters']} | {one['compiled_us']:.1f} µs | {1e6 * one['error']:.2g} µrad | "
            f"{one['mujoco_us']:.0f} µs | {one['integrator']}, {one['mujoco_step_ms']:.3g} ms"
            f"{'' if one['reached'] else ' (its best)'} | {1e6 * one['mujoco_error']:.2g} µrad | "
            f"{one['ratio']:.1f} | {one['mj_step_us']:.2f} µs | {1e6 * one['default_error']:.2g} µrad | "
            f"{one['ratio_at_2_ms']:.1f} |\n"
        )
    (HERE / "arms.md").write_text(text)
    _plot(rows)


def _plot(rows: list[dict[str, Any]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axis, joints = figure.subplots(), [one["joints"] for one in rows]
    axis.loglog(joints, [one["compiled_us"] for one in rows], "o-", label="compiled engine")
    axis.loglog(joints, [one["mujoco_us"] for one in rows], "s-", label="MuJoCo, equal error")
    at_default = [one["mj_step_us"] * (1 + one["parameters"]) for one in rows]
    axis.loglog(joints, at_default, "s--", mfc="none", label="MuJoCo, 2 ms")
    axis.set(xlabel="joints", ylabel="time of a 2 ms step [µs]", xticks=joints, xticklabels=joints)
    axis.minorticks_off()
    figure.legend(frameon=False, loc="outside upper center", ncols=3, fontsize="small", columnspacing=1.0)
    figure.savefig(HERE.parent / "docs" / "arms.png", dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--joints", type=int, nargs="*", default=list(JOINTS), help="arms to run; others stay as they were"
    )
    torch.set_num_threads(1)
    kept = HERE / "arms.json"
    rows = {one["joints"]: one for one in json.loads(kept.read_text())} if kept.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        for n in parser.parse_args().joints:
            rows[n] = compared(n, Path(folder))
            print(rows[n], flush=True)
            write([rows[k] for k in sorted(rows)])


if __name__ == "__main__":
    main()

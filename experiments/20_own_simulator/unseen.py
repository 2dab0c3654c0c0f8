"""Error of MJCF files in MuJoCo on motions that nobody recorded: unseen.py ROBOT LOGS FILE.xml ...

Each motion runs freely from its first angle at rest, driven by the logged commands alone. Printed is the RMS error
over the standard deviation of the angle, a column a motion and their mean, of an arm the mean over its joints. Of the
last two files, the re-fitted and the corrected model, the ratio of these errors follows.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student

from robots import JOINTS, COBOT_JOINTS  # isort: skip

mujoco: Any = import_module("mujoco")  # has no types
READ = {  # the logs' columns -> time [s], commands, angles [rad]
    "lift": lambda a: (a[:, 0] / 1e3, a[:, 1:2], np.radians(a[:, 2:3])),
    "band": lambda a: (a[:, 0], a[:, 1:2], a[:, 2:3]),
    "servo": lambda a: (a[:, 0], a[:, 1:2], (a[:, 2:3] - 2048) * 2 * np.pi / 4096),
    "arm": lambda a: (a[:, 0], np.radians(a[:, 7:13]), np.radians(a[:, 1:7])),
    "cobot": lambda a: (a[:, 0], a[:, 1:7], a[:, 7:13]),
}


def run(
    model: Any, names: Sequence[str], time: np.ndarray, commands: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Angles [rad] of a free run, (T, joints)."""
    data, step = mujoco.MjData(model), time[1] - time[0]
    at = [model.joint(name).qposadr[0] for name in names]
    data.qpos[at] = start
    angles = np.empty((time.size, len(names)))
    for k in range(time.size):
        angles[k] = data.qpos[at]
        data.ctrl[: len(names)] = commands[k]
        mujoco.mj_step(model, data, round(step / model.opt.timestep))
    return angles


def ratio(before: ArrayLike, after: ArrayLike) -> str:
    """Ratio of two models' errors on the same motions: geometric mean, 95 % interval, on how many it is above 1."""
    found = np.log(before) - np.log(after)
    half = student.ppf(0.975, found.size - 1) * found.std(ddof=1) / np.sqrt(found.size)
    low, middle, high = np.exp(found.mean() + half * np.array([-1, 0, 1]))
    return f"{middle:.3g} ({low:.3g} to {high:.3g}), above 1 on {(found > 0).sum()} of {found.size}"


def main(robot: str, logs: Path, files: list[str]) -> None:
    """A row a file, then the ratio of the last two."""
    names, rows = list({"arm": JOINTS, "cobot": COBOT_JOINTS}.get(robot, ("elbow",))), []
    for file in files:
        model, errors = mujoco.MjModel.from_xml_path(file), []
        for log in sorted(logs.glob("*.csv")):
            time, commands, measured = READ[robot](np.genfromtxt(log, delimiter=",", skip_header=1))
            off = run(model, names, time, commands, measured[0]) - measured
            errors.append(float(np.mean(np.sqrt(np.mean(off**2, axis=0)) / np.std(measured, axis=0))))
        rows.append(errors)
        shown = "".join(f"{error:10.5f}" for error in [*errors, float(np.mean(errors))])
        print(f"{file:24}{shown}")
    if len(rows) > 1:
        print(f"{files[-2]} / {files[-1]}: {ratio(*rows[-2:])}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])

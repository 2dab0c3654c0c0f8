"""Error in MuJoCo of MJCF files with servos, on the test records of a dataset: in_mrad.py DATASET FILE.xml ...

Free runs from the first angle at rest, driven by the goals alone; RMSE of each joint over all test records in mrad, and
their mean.
"""

import sys
from importlib import import_module
from typing import Any

import numpy as np
from unseen import run

from hybrid_id import Dataset

mujoco: Any = import_module("mujoco")  # has no types

for file in sys.argv[2:]:
    model, squares = mujoco.MjModel.from_xml_path(file), []
    names = [model.joint(k).name for k in range(model.njnt)]
    for record in Dataset.load(sys.argv[1]).test:
        measured = np.column_stack(list(record.outputs.values()))
        goals = np.column_stack(list(record.inputs.values()))
        squares.append((run(model, names, record.time, goals, measured[0]) - measured) ** 2)
    errors = 1e3 * np.sqrt(np.mean(np.concatenate(squares), axis=0))
    print(f"{file:16}", "".join(f"{error:8.2f}" for error in errors), f"{errors.mean():8.2f}")

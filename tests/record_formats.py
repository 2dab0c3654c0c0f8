"""One record of a drive in every format that is read, and the dataset file of each."""

from pathlib import Path

import numpy as np
import yaml

JOINTS = ("shoulder_pan", "elbow")
TIME = np.arange(200) / 50.0
VOLTS = np.where(TIME < 0.1, 0.0, 3.0 * np.sin(5.0 * TIME))
ANGLE = 0.4 * np.sin(1.3 * TIME) + 0.1
NANOSECONDS = 1_700_000_000_000_000_000 + np.round(1e9 * TIME).astype(np.int64)


def write_yaml(folder: Path, file: str, columns: dict, **entry: object) -> Path:
    """Write the dataset file of one record; return the folder."""
    values = {
        "name": "drive",
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": [{"name": "q_m1", "unit": "rad"}],
        "columns": columns,
        "records": [{"file": file, **entry}],
    }
    (folder / "dataset.yaml").write_text(yaml.safe_dump(values))
    return folder

"""The study file: what to identify, how, and where the results go. Every default of the commands stands here.

```yaml
dataset: ../my_robot               # paths are relative to this file
model: ../my_robot/model.yaml
identification: {starts: 4, loss: huber}
output: {folder: ../runs/my_robot}
```
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, model_validator

from hybrid_id.errors import InputError
from hybrid_id.records.schema import ResampleEntry
from hybrid_id.records.yaml_file import read_yaml, validate, write_yaml

MODEL_NAME = "model.yaml"


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Preprocessing(_Section):
    """What is done to the records before anything else.

    Attributes:
        records: names of the records to use; all where it is left out.
        between: only the samples stamped between these two [s].
        resample: bring jittered stamps to a uniform grid.
        signal_share: standard deviation added to each measurement's noise, as a share of the record's own.
    """

    records: list[str] | None = Field(default=None, min_length=1)
    between: tuple[float, float] | None = None
    resample: ResampleEntry | None = None
    signal_share: float = Field(default=0.004, ge=0, lt=1)


class Previous(_Section):
    """An earlier stage, whose identified values this one starts from.

    Attributes:
        model: the model file that the earlier stage has written.
        hold: names of parameters that keep the earlier value and are not estimated again.
    """

    model: Path
    hold: list[str] = []


class Identification(_Section):
    """How the parameters are found.

    Attributes:
        pooled: one set over all train records instead of one a record.
        loss: of the weighted residuals; `huber` and `l1` bear spikes.
        threshold: weighted residual from which `huber` grows linearly.
        starts: start points; the best end counts.
        max_iterations, tolerance: of the fit; converged when a step is under `tolerance` standard errors.
        friction: `dry` (the joint really stops), or `smooth` (tanh).
        substeps: least number of integration steps a sample; stability may ask for more.
        width: smoothing speed of `smooth` [rad/s].
        seed: of start points and bootstrap.
        device: `cpu` or `cuda`.
    """

    pooled: bool = False
    loss: Literal["l2", "huber", "l1"] = "l2"
    threshold: PositiveFloat = 3.0
    starts: PositiveInt = 1
    max_iterations: PositiveInt = 200
    tolerance: PositiveFloat = 0.01
    friction: Literal["dry", "smooth"] = "dry"
    substeps: PositiveInt = 1
    width: PositiveFloat = 0.5
    seed: int = Field(default=0, ge=0)
    device: str = "cpu"


class Training(_Section):
    """How `train` finds them by the adjoint method; pooled, loss, threshold and seed are those of the identification.

    Attributes:
        method: torchdiffeq's solver, rk4 or dopri5 say.
        gradient: `adjoint`, or `backprop` through the steps.
        substeps, fine: least number of steps a sample, and of a sample in which a speed comes near zero.
        width: speed over which friction is smoothed [rad/s].
        windows: stages before the whole records, each (length of a window [s], use one window in this many).
        max_iterations, tolerance: of each stage; converged when a step is under `tolerance` standard errors.
        validate_every: gradients between two looks at the test records.
    """

    method: str = "rk4"
    gradient: Literal["adjoint", "backprop"] = "adjoint"
    substeps: PositiveInt = 1
    fine: PositiveInt = 32
    width: PositiveFloat = 0.5
    windows: list[tuple[PositiveFloat, PositiveInt]] = [(0.2, 4)]
    max_iterations: PositiveInt = 100
    tolerance: PositiveFloat = 0.01
    validate_every: PositiveInt = 5


class Statistics(_Section):
    """What is said about the parameters.

    Attributes:
        level: confidence of the intervals.
    """

    level: float = Field(default=0.95, gt=0, lt=1)


class Output(_Section):
    """Where the results go, and which.

    Attributes:
        folder: of the results; `--out` stands in for it.
        figures: PNG pictures.
        tensorboard: event files.
        report: everything on one page, report.html.
    """

    folder: Path | None = None
    figures: bool = True
    tensorboard: bool = True
    report: bool = True


class StudyConfig(_Section):
    """All of a study file."""

    dataset: Path
    model: Path
    previous: Previous | None = None
    preprocessing: Preprocessing = Preprocessing()
    identification: Identification = Identification()
    training: Training = Training()
    statistics: Statistics = Statistics()
    output: Output = Output()

    @model_validator(mode="before")
    @classmethod
    def _model_beside_the_records(cls, values: Any) -> Any:
        if isinstance(values, dict) and "model" not in values and isinstance(values.get("dataset"), str):
            return values | {"model": str(beside(Path(values["dataset"])))}
        return values

    def save(self, path: Path, *, home: Path | None = None) -> None:
        """Write the whole config, defaults included.

        Args:
            path: The file.
            home: Folder that the file will lie in at last, to which paths are relative; its folder by default.
        """
        values = self.model_dump(mode="json", exclude={"output": {"folder"}})
        write_yaml(path, _with_paths(values, lambda p: os.path.relpath(p, home or path.parent)))


def load_config(path: Path, changes: Mapping[str, Any] | None = None) -> StudyConfig:
    """Read a study file.

    Args:
        path: The file; paths in it are relative to its folder.
        changes: Values that replace those of the file, `identification.starts` -> 4; None changes nothing.

    Raises:
        InputError: one sentence that names file and key.
    """
    values = read_yaml(path)
    validate(StudyConfig, values, path)  # the file's own faults first, under its own name
    moved = _with_paths(values, lambda p: str(path.parent / p))
    return validate(StudyConfig, _changed(moved, changes or {}), "options")


def study_config(source: Path, changes: Mapping[str, Any] | None = None) -> StudyConfig:
    """The config that a command works by: a study file's, or the defaults for a dataset.

    Args:
        source: Study file, dataset folder or dataset file.
        changes: As in `load_config`.

    Raises:
        InputError: neither a study nor a dataset, or a fault in them.
    """
    if not source.exists():
        raise InputError(f"{source} does not exist; give a dataset folder or a study file")
    if source.is_file():
        values = read_yaml(source)
        if "dataset" in values or not {"records", "outputs"} & set(values):
            return load_config(source, changes)
    return validate(StudyConfig, _changed({"dataset": str(source)}, changes or {}), "options")


def beside(dataset: Path) -> Path:
    """Where the model of a dataset lies unless somebody says otherwise."""
    return (dataset.parent if dataset.suffix in (".yaml", ".yml") else dataset) / MODEL_NAME


def _changed(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(values)
    for key, value in changes.items():
        if value is None:
            continue
        section, _, name = key.partition(".")
        result[section] = {**(result.get(section) or {}), name: value} if name else value
    return result


def _with_paths(values: Mapping[str, Any], move: Any) -> dict[str, Any]:
    """The values of a study with `move` applied to each path."""
    result = dict(values)
    for key in ("dataset", "model"):
        if isinstance(result.get(key), str):
            result[key] = move(result[key])
    for key, name in (("previous", "model"), ("output", "folder")):
        section = result.get(key)
        if isinstance(section, dict) and isinstance(section.get(name), str):
            result[key] = {**section, name: move(section[name])}
    return result

"""The study file: what to identify, how, and where the results go. Every default of the commands stands here.

```yaml
dataset: ../my_robot               # paths are relative to this file
model: ../my_robot/model.yaml
identification: {starts: 4, loss: huber}
output: {folder: ../runs/my_robot}
```
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, PrivateAttr, model_validator

from hybrid_id.config.sections import (
    Ablation,
    Gap,
    Hybrid,
    Identification,
    Output,
    Preprocessing,
    Previous,
    Section,
    Statistics,
    Training,
)
from hybrid_id.errors import InputError
from hybrid_id.records.yaml_file import FilePath, read_yaml, validate, write_yaml

MODEL_NAME = "model.yaml"


class StudyConfig(Section):
    """All of a study file.

    Attributes:
        dataset: folder with dataset.yaml, or a dataset file; paths are seen from the study file.
        model: model file; model.yaml beside the records where it is left out.
        previous: an earlier stage, whose identified values this one starts from.
        preprocessing: what is done to the records first.
        identification: how identify fits.
        training: how train fits.
        hybrid: residual networks beside the physics, for train.
        ablation: what ablate compares.
        gap: how diagnose searches.
        statistics: what is computed after a fit.
        output: where results go, and which.
    """

    model_config = ConfigDict(json_schema_extra={"required": ["dataset"]})
    dataset: FilePath
    model: FilePath
    previous: Previous | None = None
    preprocessing: Preprocessing = Preprocessing()
    identification: Identification = Identification()
    training: Training = Training()
    hybrid: Hybrid | None = None
    ablation: Ablation | None = None
    gap: Gap = Gap()
    statistics: Statistics = Statistics()
    output: Output = Output()
    _file: Path | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _model_beside_the_records(cls, values: Any) -> Any:
        if isinstance(values, dict) and "model" not in values and isinstance(values.get("dataset"), str):
            return values | {"model": str(beside(Path(values["dataset"])))}
        return values

    @contextmanager
    def at(self, key: str) -> Iterator[None]:
        """Let an InputError begin with the file and the key, for what only the dataset or the model can refuse."""
        try:
            yield
        except InputError as error:
            raise InputError(
                f"{'' if self._file is None else f'{self._file}: '}key '{key}': {error}"
            ) from None

    @property
    def reads(self) -> list[Path]:
        """Dataset and models, which no result may replace."""
        return [self.dataset, self.model, *([] if self.previous is None else [self.previous.model])]

    def save(self, path: Path, *, home: Path | None = None) -> None:
        """Write the whole config, defaults included.

        Args:
            path: The file.
            home: Folder that the file will lie in at last, to which paths are relative; its folder by default.
        """
        values = self.model_dump(mode="json", exclude={"output": {"folder"}})
        place = (home or path.parent).resolve()  # '..' leaves the folder that a link stands for
        write_yaml(path, _with_paths(values, lambda p: os.path.relpath(Path(p).resolve(), place)))


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
    config = validate(StudyConfig, _changed(moved, changes or {}), "options")
    config._file = path
    return config


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

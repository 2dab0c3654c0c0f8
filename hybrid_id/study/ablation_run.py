"""Cells of an ablation, computed one by one and kept as they are done."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid_id import __version__
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.study.ablation import Task, run_cell
from hybrid_id.study.ablation_cell import FAILED, CellResult, as_plain, from_plain
from hybrid_id.study.ablation_plan import Cell
from hybrid_id.study.fan_out import Failure, fan_out
from hybrid_id.systems.model_file import describe_model

CELL, MODEL = "cell.json", "model.yaml"


def run_cells(
    task: Task, cells: Sequence[Cell], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[CellResult]:
    """Compute cells, each as soon as it is done; one that breaks is a result that says so, and the rest goes on.

    Args:
        task: what they share.
        cells: which ones.
        jobs: processes on this machine.
        scheduler: address of an existing Dask cluster, which is taken instead.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    for number, result in fan_out(run_cell, task, cells, jobs=jobs, scheduler=scheduler):
        yield CellResult(cells[number], FAILED, result.message) if isinstance(result, Failure) else result


def key_of(task: Task, cell: Cell, program: str = __version__) -> str:
    """Digest of all that decides a cell: records, model, settings, and the program that computes it."""
    records = hashlib.sha256()
    for record in task.dataset:
        records.update(record.name.encode() + record.time.tobytes())
        for name, values in (*record.inputs.items(), *record.outputs.items()):
            records.update(name.encode() + values.tobytes())
    settings = (
        program, cell, task.split(cell.seed), task.engine, replace(task.options, seed=0), task.inputs,
        task.memory, task.lipschitz, task.horizon, task.signal_share, task.dataset.outputs,
        describe_model(task.system), records.hexdigest(),
    )  # fmt: skip
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def save_cell(folder: Path, result: CellResult, key: str) -> None:
    """Write a cell's folder under a temporary name and rename it, so that it is whole or not there."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".") as temporary:
        new, place = Path(temporary) / "new", folder / result.cell.name
        new.mkdir()
        plain = as_plain(result)
        content = {"program": f"hybrid_id {__version__}", "key": key, "seal": _seal(plain), "result": plain}
        (new / CELL).write_text(json.dumps(content), encoding="utf-8")
        write_yaml(new / MODEL, result.model)
        if place.exists():
            place.replace(Path(temporary) / "old")
        new.replace(place)


def load_cell(folder: Path, cell: Cell, key: str) -> CellResult | None:
    """The cell that an earlier run has kept; None where there is none, or one of other settings or edited."""
    try:
        content = json.loads((folder / cell.name / CELL).read_text(encoding="utf-8"))
        whole = content["key"] == key and content["seal"] == _seal(content["result"])
        return from_plain(content["result"]) if whole else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _seal(plain: dict[str, Any]) -> str:
    """Digest of a result as JSON holds it."""
    return hashlib.sha256(json.dumps(plain).encode()).hexdigest()

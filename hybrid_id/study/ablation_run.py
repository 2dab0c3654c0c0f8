"""Cells computed one by one, in processes of this machine, or on a Dask cluster; and kept as they are done."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import signal
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.study.ablation import Task, run_cell
from hybrid_id.study.ablation_cell import FAILED, CellResult, as_plain, from_plain
from hybrid_id.study.ablation_plan import Cell
from hybrid_id.systems.model_file import describe_model

CELL, MODEL = "cell.json", "model.yaml"
TIMEOUT = 20.0
"""Time [s] within which a Dask scheduler has to answer."""


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
    if scheduler is not None:
        yield from _on_dask(task, cells, scheduler)
    elif jobs > 1:
        yield from _in_processes(task, cells, jobs)
    else:
        yield from (attempt(task, cell) for cell in cells)


def attempt(task: Task, cell: Cell) -> CellResult:
    """A cell's result, or the reason why it has none."""
    torch.set_num_threads(1)
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # a terminal sends Ctrl-C to all; the first process decides
    try:
        return run_cell(task, cell)
    except Exception as error:  # whatever breaks one cell must not take the others along
        return _broken(cell, error)


def _broken(cell: Cell, error: BaseException | None) -> CellResult:
    words = f"{type(error).__name__}: {error}" if error is not None else "its worker was lost"
    return CellResult(cell, FAILED, words.splitlines()[0])


def _in_processes(task: Task, cells: Sequence[Cell], jobs: int) -> Iterator[CellResult]:
    left = {cell.name: cell for cell in cells}
    try:
        work = (delayed(attempt)(task, cell) for cell in cells)
        found = Parallel(jobs, return_as="generator_unordered", pre_dispatch="n_jobs")(work)
        for result in cast("Iterator[CellResult]", found):
            del left[result.cell.name]
            yield result
    except (
        BrokenProcessPool
    ):  # a process was killed: the rest in pools of their own, which tells the guilty cell
        for cell in left.values():
            try:
                yield from cast("list[CellResult]", Parallel(2)([delayed(attempt)(task, cell)]))
            except BrokenProcessPool as error:
                yield _broken(cell, error)


def _on_dask(task: Task, cells: Sequence[Cell], address: str) -> Iterator[CellResult]:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "The backend dask needs the package distributed; install hybrid-id[dask], or use --jobs."
        ) from None
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"No Dask scheduler answers at {address} ({reason}); start one there.") from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"The Dask scheduler at {address} has no worker; start some with 'dask worker {address}'."
            )
        shared = client.scatter(task, broadcast=True, hash=False)
        futures = {client.submit(attempt, shared, cell, pure=False): cell for cell in cells}
        try:
            for future in as_completed(list(futures), loop=client.loop, raise_errors=False):
                done = future.status == "finished"
                yield future.result() if done else _broken(futures[future], future.exception())  # type: ignore[misc]
        finally:
            client.cancel(list(futures))


def key_of(task: Task, cell: Cell) -> str:
    """Digest of all that decides a cell: records, model, settings, program."""
    records = hashlib.sha256()
    for record in task.dataset:
        records.update(record.name.encode() + record.time.tobytes())
        for name, values in (*record.inputs.items(), *record.outputs.items()):
            records.update(name.encode() + values.tobytes())
    settings = (
        __version__, cell, task.split(cell.seed), task.engine, replace(task.options, seed=0), task.inputs,
        task.memory, task.lipschitz, task.horizon, task.signal_share, task.dataset.outputs,
        describe_model(task.system), records.hexdigest(),
    )  # fmt: skip
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def save_cell(folder: Path, result: CellResult, key: str) -> None:
    """Write a cell's folder under a temporary name and rename it, so that it is whole or not there."""
    with tempfile.TemporaryDirectory(dir=folder, prefix=".") as temporary:
        new, place = Path(temporary) / "new", folder / result.cell.name
        new.mkdir()
        (new / CELL).write_text(json.dumps({"key": key, "result": as_plain(result)}), encoding="utf-8")
        write_yaml(new / MODEL, result.model)
        if place.exists():
            place.replace(Path(temporary) / "old")
        new.replace(place)


def load_cell(folder: Path, cell: Cell, key: str) -> CellResult | None:
    """The cell that an earlier run has kept; None where there is none, or where it was made from something else."""
    try:
        content = json.loads((folder / cell.name / CELL).read_text(encoding="utf-8"))
        return from_plain(content["result"]) if content["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError):
        return None

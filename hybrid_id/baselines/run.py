"""Baselines on cases: one case after the other, in processes, or on a cluster, each alone with its records."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_id.baselines.external import external
from hybrid_id.baselines.methods import bic, diagnosis, stribeck
from hybrid_id.errors import InputError
from hybrid_id.reading import LARGEST_RESULT, read_bytes, refuse_outside
from hybrid_id.records.dataset import Dataset
from hybrid_id.study.many import Failure, each
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

METHODS: Mapping[str, Callable[[Dataset, System], dict[str, Any]]] = {
    "diagnose": diagnosis,
    "bic": bic,
    "stribeck": stribeck,
}


@dataclass(frozen=True)
class Case:
    """All that a baseline gets to see: the files of a case, by name."""

    name: str
    files: Mapping[str, bytes]

    @property
    def digest(self) -> str:
        """Hash of names and contents."""
        found = hashlib.sha256()
        for name in sorted(self.files):
            found.update(name.encode() + hashlib.sha256(self.files[name]).digest())
        return found.hexdigest()


@dataclass(frozen=True)
class Settings:
    """How the cases are run.

    Attributes:
        method: one of `METHODS`, or ``external``.
        command: of an external program, see :func:`.external.external`.
        digest: of the program that it starts.
    """

    method: str
    command: str | None = None
    digest: str | None = None


def read_cases(folder: Path, manifest: Mapping[str, Any]) -> list[Case]:
    """The cases of a folder, as they were made.

    Raises:
        InputError: the files of one have changed since they were sealed.
    """
    found = [read_case(folder / name) for name in manifest["names"]]
    for case in found:
        if manifest.get("digests", {}).get(case.name, case.digest) != case.digest:
            raise InputError(
                f"{folder / case.name} does not hold the files that were sealed; make the cases anew"
            )
    return found


def read_case(folder: Path) -> Case:
    """The files of a case folder."""
    files = [path for path in sorted(folder.iterdir()) if path.is_file()]
    for path in files:
        refuse_outside(path, folder.parent, str(path), "make the cases anew")
    return Case(
        folder.name, {path.name: read_bytes(path, LARGEST_RESULT, "file of a case") for path in files}
    )


def run_cases(
    settings: Settings, cases: Sequence[Case], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number of each case and the method's answer, as soon as it is there.

    What the run says of itself is in ``run``; the answer to a case that broke holds nothing else, its reason in
    ``message``.

    Args:
        settings: which method, and how.
        cases: what it gets to see.
        jobs: processes of this machine.
        scheduler: address of a Dask cluster, which is taken instead.
    """
    for number, result in each(run_case, settings, cases, jobs=jobs, scheduler=scheduler):
        if isinstance(result, Failure):
            about = {"method": settings.method, "message": result.message}
            result = {"case": cases[number].name, "run": about}
        yield number, result


def run_case(settings: Settings, case: Case) -> dict[str, Any]:
    """A method's answer to one case, which it sees as a folder with nothing around it."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / case.name
        folder.mkdir()
        for name, content in case.files.items():
            (folder / name).write_bytes(content)
        system = load_model(folder / "model.yaml")
        dataset = Dataset.load(folder)
        wall, processor = time.perf_counter(), _processor_seconds()
        if settings.method == "external":
            said = external(folder, settings.command)
        else:
            said = METHODS[settings.method](dataset, system)
    about = {
        "method": settings.method,
        "message": "",
        "seconds": round(time.perf_counter() - wall, 3),
        "processor_seconds": round(_processor_seconds() - processor, 3),
    }
    return said | {"case": case.name, "run": about}


def _processor_seconds() -> float:
    """Processor time of this process and of the programs that it has run, compilers say [s]."""
    return sum(os.times()[:4])

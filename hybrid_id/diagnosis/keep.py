"""Fits of a search that are kept in a folder, so that a search which was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.validation import Validation
from hybrid_id.identification.result import FitResult
from hybrid_id.records.files import write_whole
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Kept:
    """Fits in a folder, a file each, under the digest of all that they were made from.

    Attributes:
        folder: where they are; it exists.
        program: version and commit: what another program has fitted is fitted again.
    """

    folder: Path
    program: str

    @property
    def count(self) -> int:
        """Number of fits that are kept."""
        return sum(1 for _ in self.folder.glob("*.npz"))

    def of(
        self,
        made_from: object,
        effects: tuple[Name, ...],
        start: System,
        fit: Callable[[], FittedModel | None],
    ) -> FittedModel | None:
        """A fit: read if it is kept, otherwise made and kept.

        Args:
            made_from: all that decides it.
            effects: of the model.
            start: the system that the fit starts from.
            fit: makes it; None where the model cannot be fitted.
        """
        digest = hashlib.sha256()
        _digest(digest, (self.program, made_from))
        path = self.folder / f"{digest.hexdigest()[:32]}.npz"
        if path.exists():
            with np.load(path) as arrays:
                return _read(arrays, effects, start)
        found = fit()
        if found is not None and not _same(found.system, _with_values(start, found.result)):
            return found  # not the start with other values: it would not be the same when it is read
        content = _written(found)
        write_whole(path, content)
        with np.load(io.BytesIO(content)) as arrays:  # what is read again is the same to the last bit
            return _read(arrays, effects, start)


def _written(model: FittedModel | None) -> bytes:
    arrays: dict[str, np.ndarray] = {}
    if model is not None:
        result, seen = model.result, model.validation
        about = {
            "names": result.names, "units": result.units, "status": result.status, "records": result.records,
            "cost": result.cost, "n_samples": result.n_samples, "iterations": result.iterations,
            "engine": asdict(result.engine), "history": result.history, "rows": len(result.residual),
            "effective": seen.effective, "judged": model.judged,
        }  # fmt: skip
        arrays = {
            "about": np.array(json.dumps(about)), "values": result.values, "x0": result.x0,
            "prior_precision": result.prior_precision,
            "blocks": seen.blocks, "sizes": seen.sizes, "row": seen.row, "record": seen.record,
        }  # fmt: skip
        for k, (jacobian, residual) in enumerate(zip(result.jacobian, result.residual, strict=True)):
            arrays |= {f"jacobian_{k}": jacobian, f"residual_{k}": residual}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _read(arrays: Mapping[str, np.ndarray], effects: tuple[Name, ...], start: System) -> FittedModel | None:
    if "about" not in arrays:
        return None
    about = json.loads(str(arrays["about"]))
    names, values = tuple(about["names"]), arrays["values"]
    result = FitResult(
        system=start.with_values(dict(zip(names, values.tolist(), strict=True))),
        names=names,
        values=values,
        units=tuple(about["units"]),
        status=about["status"],
        records=tuple(about["records"]),
        cost=about["cost"],
        n_samples=about["n_samples"],
        iterations=about["iterations"],
        jacobian=tuple(arrays[f"jacobian_{k}"] for k in range(about["rows"])),
        residual=tuple(arrays[f"residual_{k}"] for k in range(about["rows"])),
        prior_precision=arrays["prior_precision"],
        x0=arrays["x0"],
        engine=Engine(**about["engine"]),
        history=tuple(about["history"]),
    )
    seen = Validation(arrays["blocks"], arrays["sizes"], arrays["row"], about["effective"], arrays["record"])
    return FittedModel(effects, result, seen, about["judged"])


def _with_values(start: System, result: FitResult) -> System:
    return start.with_values(dict(zip(result.names, result.values.tolist(), strict=True)))


def _same(one: System, other: System) -> bool:
    digests = [hashlib.sha256() for _ in range(2)]
    for digest, system in zip(digests, (one, other), strict=True):
        _digest(digest, system)
    return digests[0].digest() == digests[1].digest()


def _digest(digest: Any, value: Any) -> None:
    """Feed a value into a digest: arrays and systems by their content, dataclasses field by field."""
    if isinstance(value, System):
        parts = {key: (part.kind, part.specs) for key, part in value.components.items()}
        _digest(digest, (value.name, value.gear_ratio, value.aliases, parts, value.state_dict()))
    elif isinstance(value, Tensor):
        _digest(digest, value.detach().cpu().numpy())
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        _digest(digest, {one.name: getattr(value, one.name) for one in fields(value)})
    elif isinstance(value, Mapping):
        _digest(digest, [(key, value[key]) for key in value])
    elif isinstance(value, tuple | list):
        digest.update(f"[{len(value)}".encode())
        for one in value:
            _digest(digest, one)
    else:
        digest.update(f"{type(value).__name__} {value!r};".encode())

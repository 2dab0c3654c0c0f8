"""What is kept so that a long run which was stopped goes on: finished fits in a folder, and where a training stands."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

from hybrid_id import __version__
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.identification.result import FitResult
from hybrid_id.records.files import write_whole
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

Arrays = dict[str, np.ndarray]
Found = TypeVar("Found")
WHOLE = ("values", "x0", "prior_precision")
"""Fields of a fit that are one array each."""
Report = Callable[..., bool | None]
"""What a fit calls after each iteration (:func:`hybrid_id.identification.fit.fit`): where it is true, the fit ends."""


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
        make: Callable[[], Found],
        pack: Callable[[Found], Arrays | None],
        unpack: Callable[[Mapping[str, np.ndarray]], Found],
    ) -> Found:
        """What was made: read if it is kept, otherwise made and kept.

        Args:
            made_from: all that decides it.
            make: makes it.
            pack: what is written of it; None for what is not kept.
            unpack: reads that again.
        """
        path = self.folder / f"{digest_of((self.program, made_from))[:32]}.npz"
        if path.is_file():
            try:
                with path.open("rb") as file, np.load(file) as arrays:
                    return unpack(arrays)
            except Exception:  # cut short, or written by something else, which can raise anything
                pass
        found = make()
        arrays = pack(found)
        if arrays is None:
            return found
        file = io.BytesIO()
        np.savez_compressed(file, allow_pickle=False, **arrays)
        write_whole(path, file.getvalue())
        file.seek(0)
        with np.load(file) as written:  # what is read again is the same to the last bit
            return unpack(written)

    def results(
        self,
        made_from: object,
        start: System,
        make: Callable[[Report], Sequence[FitResult]],
        progress: Report | None = None,
    ) -> list[FitResult]:
        """Fits of one system, read or made; what the progress has cut off is not kept.

        Args:
            made_from: all that decides them beside the system.
            start: the system that they start from.
            make: makes them; what it gets ends a fit as the progress does.
            progress: see :func:`hybrid_id.identification.fit.fit`.
        """
        cut = False

        def watched(*now: Any) -> bool:
            nonlocal cut
            cut |= bool(progress is not None and progress(*now))
            return cut

        def pack(found: Sequence[FitResult]) -> Arrays | None:
            if cut or not all(same_but_for_values(one, start) for one in found):
                return None
            parts = [pack_result(one).items() for one in found]
            return {f"{k}_{name}": array for k, part in enumerate(parts) for name, array in part}

        def unpack(arrays: Mapping[str, np.ndarray]) -> list[FitResult]:
            parts: dict[int, Arrays] = {}
            for key in arrays:
                number, _, name = key.partition("_")
                parts.setdefault(int(number), {})[name] = arrays[key]
            return [unpack_result(parts[k], start) for k in sorted(parts)]

        return self.of((start, made_from), lambda: list(make(watched)), pack, unpack)


def pack_result(result: FitResult) -> Arrays:
    """A fit as arrays, but for what its system has beside the estimated values."""
    rows = ("jacobian", "residual")
    about = {
        f.name: getattr(result, f.name) for f in fields(result) if f.name not in ("system", *WHOLE, *rows)
    }
    about |= {"engine": asdict(result.engine), "rows": len(result.residual)}
    arrays = {name: getattr(result, name) for name in WHOLE} | {"about": np.array(json.dumps(about))}
    for name in rows:
        arrays |= {f"{name}_{k}": row for k, row in enumerate(getattr(result, name))}
    return arrays


def unpack_result(arrays: Mapping[str, np.ndarray], start: System) -> FitResult:
    """The fit again, of the system that it started from."""
    read = json.loads(str(arrays["about"]))
    about: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in read.items()}
    values, rows = dict(zip(about["names"], arrays["values"].tolist(), strict=True)), range(about.pop("rows"))
    about |= {"engine": Engine(**about["engine"])} | {name: arrays[name] for name in WHOLE}
    return FitResult(
        **about,
        system=start.with_values(values),
        jacobian=tuple(arrays[f"jacobian_{k}"] for k in rows),
        residual=tuple(arrays[f"residual_{k}"] for k in rows),
    )


def same_but_for_values(result: FitResult, start: System) -> bool:
    """Whether a fit's system is the one that it started from with other values, as it is when it is read."""
    values = dict(zip(result.names, result.values.tolist(), strict=True))
    return _content(result.system) == _content(start.with_values(values))


def _content(system: System) -> tuple[Any, ...]:
    """All that makes a system, to be compared with another one's; its tree last, which most fits of a search share."""
    components = cast("dict[str, Component]", dict(system.components.items()))
    parts = {key: (part.kind, part.specs, part.options()) for key, part in components.items()}
    state = {
        key: (str(v.dtype), v.shape, v.cpu().numpy().tobytes()) for key, v in system.state_dict().items()
    }
    return system.name, system.gear_ratio, system.aliases, parts, system.seats, state, system.tree


def digest_of(value: Any) -> str:
    """Digest of a value's content: arrays, tensors, systems, dataclasses, mappings, lists, and what is written out."""
    digest = hashlib.sha256()
    _digest(digest, value)
    return digest.hexdigest()


def _digest(digest: Any, value: Any) -> None:
    """Feed a value into a digest: arrays and systems by their content, dataclasses field by field."""
    if isinstance(value, System):
        *about, tree = _content(value)
        more = None if tree is None else (digest_of_tree(tree), tree.points, tree.source, tree.held)
        _digest(digest, (*about, more))
    elif isinstance(value, Tensor):
        _digest(digest, value.detach().cpu().numpy())
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        _digest(digest, {one.name: getattr(value, one.name) for one in fields(value)})
    elif isinstance(value, Mapping):
        _digest(digest, [(key, value[key]) for key in sorted(value, key=repr)])
    elif isinstance(value, tuple | list):
        digest.update(f"[{len(value)}".encode())
        for one in value:
            _digest(digest, one)
    else:
        digest.update(f"{type(value).__name__} {value!r};".encode())


@functools.lru_cache(maxsize=64)
def digest_of_tree(tree: RigidBodyTree) -> str:
    """Digest of what equal trees share; a tree has thousands of numbers, and a search has one tree."""
    held_up = tree.believed and digest_of_tree(tree.believed)
    return digest_of((tree.joints, tree.bodies, tree.gravity, tree.couplings, held_up))


def write_checkpoint(path: Path, content: Mapping[str, Any], identity: list[str]) -> None:
    """Write a checkpoint of tensors, numbers and text, under a temporary name first.

    Args:
        path: the file.
        content: where the training stands.
        identity: kind of the training, and digest of all that decides its numbers.
    """
    temporary = path.with_name(path.name + ".tmp")
    program = f"hybrid_id {__version__}"
    state = dict(content)
    whole = {"program": program, "identity": identity, "digest": digest_of(state), "state": state}
    with temporary.open("wb") as file:
        torch.save(whole, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def read_checkpoint(
    path: Path, identity: list[str], make: Callable[[dict[str, Any]], Found], device: torch.device
) -> Found:
    """Read the checkpoint of a training of these records, model and settings.

    Args:
        path: the file.
        identity: see :func:`write_checkpoint`.
        make: makes of its content what stands in it.
        device: where the training goes on.
    """
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}; start without resuming.")
    try:
        content = torch.load(path, weights_only=True, map_location=device)
        if content["digest"] != digest_of(content["state"]):
            raise InputError(
                f"{path} is damaged or was altered, for its digest does not fit; start without resuming."
            )
        found, made = content["identity"], make(dict(content["state"]))
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{path} is no checkpoint of a training ({type(error).__name__}); start without resuming."
        ) from None
    if found != identity:
        raise InputError(
            f"{path} belongs to other records, another model or other settings; resume with those (config.yaml beside "
            "it holds them), or start anew."
        )
    return made

"""A training on disk: where it stands, and to which records and parameters it belongs."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, cast

import torch

from hybrid_id import __version__
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.identification.keep import digest_of, digest_of_tree
from hybrid_id.identification.optimizers import OptimizerState, QuasiNewtonState
from hybrid_id.simulation.batch import Batch
from hybrid_id.systems.chain import System

Content = TypeVar("Content")


def fingerprint(system: System, batches: Sequence[Batch], *settings: object) -> str:
    """What the numbers of a training depend on, as one hash: model, start values, networks, records, settings."""
    components, tree = cast("dict[str, Component]", dict(system.components.items())), system.tree
    parts = [(key, part.kind, sorted(part.options().items())) for key, part in components.items()]
    known = hashlib.sha256(repr((system.name, system.gear_ratio, parts, settings)).encode())
    for info in system.table:
        known.update(repr((info.name, info.spec)).encode())
    if tree is not None:
        known.update(digest_of((digest_of_tree(tree), tree.points, tree.held)).encode())
    for batch in batches:
        known.update(repr((batch.names, batch.outputs)).encode())
        for channel in (batch.dt, batch.y, batch.weight, *batch.u.values()):
            known.update(channel.detach().cpu().contiguous().numpy().tobytes())
    return known.hexdigest()


def write_checkpoint(path: Path, content: Mapping[str, Any], identity: list[str]) -> None:
    """Write a checkpoint of tensors, numbers and text, under a temporary name first.

    Args:
        path: the file.
        content: where the training stands.
        identity: kind and fingerprint of the training.
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
    path: Path, identity: list[str], make: Callable[[dict[str, Any]], Content], device: torch.device
) -> Content:
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


def as_content(state: OptimizerState) -> dict[str, Any]:
    """The fields of an optimiser's state."""
    return {f.name: getattr(state, f.name) for f in fields(state)}


def write_state(path: Path, state: QuasiNewtonState, identity: list[str]) -> None:
    """Write where a training of parameters stands."""
    write_checkpoint(path, as_content(state), identity)


def read_state(path: Path, identity: list[str], device: torch.device) -> QuasiNewtonState:
    """Read where a training of parameters stands."""
    return read_checkpoint(path, identity, lambda content: QuasiNewtonState(**content), device)

"""A training on disk: where it stands, and to which records and parameters it belongs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.first_order import Descent
from hybrid_id.identification.quasi_newton import State


def write_checkpoint(path: Path, content: Mapping[str, Any], identity: list[str]) -> None:
    """Write a checkpoint of tensors, numbers and text, under a temporary name first.

    Args:
        path: the file.
        content: where the training stands.
        identity: names of its records and parameters.
    """
    temporary = path.with_name(path.name + ".tmp")
    torch.save({"identity": identity, "state": dict(content)}, temporary)
    os.replace(temporary, path)


def read_checkpoint(path: Path, identity: list[str]) -> dict[str, Any]:
    """Read a checkpoint of the training of these records and parameters."""
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}; start without resuming.")
    try:
        content = torch.load(path, weights_only=True)
        found, state = content["identity"], dict(content["state"])
    except Exception as error:
        raise InputError(
            f"{path} is no checkpoint of a training ({type(error).__name__}); start without resuming."
        ) from None
    if found != identity:
        raise InputError(
            f"{path} belongs to other records or another model; resume with those, or start anew."
        )
    return state


def as_content(state: State | Descent) -> dict[str, Any]:
    """The fields of an optimiser's state."""
    return {f.name: getattr(state, f.name) for f in fields(state)}


def write_state(path: Path, state: State, identity: list[str]) -> None:
    """Write where a training of parameters stands."""
    write_checkpoint(path, as_content(state), identity)


def read_state(path: Path, identity: list[str]) -> State:
    """Read where a training of parameters stands."""
    return State(**read_checkpoint(path, identity))

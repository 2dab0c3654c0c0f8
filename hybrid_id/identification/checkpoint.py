"""A training on disk: where it stands, and to which records and parameters it belongs."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path

import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.quasi_newton import State


def write_state(path: Path, state: State, identity: list[str]) -> None:
    """Write a checkpoint, under a temporary name first.

    Args:
        path: the file.
        state: where the training stands.
        identity: names of its records and parameters.
    """
    content = {f.name: getattr(state, f.name) for f in fields(State)}
    temporary = path.with_name(path.name + ".tmp")
    torch.save({"identity": identity, "state": content}, temporary)
    os.replace(temporary, path)


def read_state(path: Path, identity: list[str]) -> State:
    """Read a checkpoint of the training of these records and parameters."""
    if not path.is_file():
        raise InputError(f"There is no checkpoint {path}; start without resuming.")
    try:
        content = torch.load(path, weights_only=True)
        found, state = content["identity"], State(**content["state"])
    except Exception as error:
        raise InputError(
            f"{path} is no checkpoint of a training ({type(error).__name__}); start without resuming."
        ) from None
    if found != identity:
        raise InputError(
            f"{path} belongs to other records or another model; resume with those, or start anew."
        )
    return state

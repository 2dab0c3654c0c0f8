"""Arguments and options that several commands share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_id.config import StudyConfig, study_config
from hybrid_id.config.sections import MOST_JOBS, MOST_SEED
from hybrid_id.errors import InputError

ABOVE = "Folders above it are made."
"""The rule of every --out, for its help."""

DatasetArgument = Annotated[
    Path,
    typer.Argument(metavar="DATASET", help="Folder with dataset.yaml, or a dataset file."),
]
SourceArgument = Annotated[
    Path,
    typer.Argument(metavar="CONFIG|DATASET", help="Study file, or a dataset to use with --model."),
]
ModelOption = Annotated[
    Path | None,
    typer.Option("--model", "-m", help="Model file; DATASET/model.yaml by default."),
]
OutOption = Annotated[Path | None, typer.Option("--out", "-o", help=f"Folder for the results. {ABOVE}")]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace results of an earlier run, once the new ones are complete.")
]
ForceFilesOption = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")]
SeedOption = Annotated[
    int | None,
    typer.Option(help="Seed of everything that is drawn at random.", min=0, max=MOST_SEED),
]
DeviceOption = Annotated[str | None, typer.Option(help="Where to compute: cpu or cuda.", show_default="cpu")]
WindowOption = Annotated[
    str | None,
    typer.Option(
        metavar="SECONDS|whole|strokes|auto",
        help="Horizon: free runs of this length from measured states, over whole records, or from rest to rest; "
        "auto: over whole records where they follow them.",
        show_default="auto",
    ),
]


PooledOption = Annotated[
    bool | None,
    typer.Option("--pooled/--per-record", help="One parameter set over all records, or one a record."),
]
JointOption = Annotated[
    str | None,
    typer.Option(help="Take this joint of a robot by itself, the others moving as they were measured."),
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Go on with the unfinished run in the folder of results.")
]


class Backend(StrEnum):
    """Where pieces of work are done."""

    joblib = "joblib"
    dask = "dask"


ProcessesOption = Annotated[
    int, typer.Option("--jobs", help="Processes of this machine.", min=1, max=MOST_JOBS)
]
BackendOption = Annotated[Backend, typer.Option(help="joblib: this machine; dask: an existing cluster.")]
SchedulerOption = Annotated[
    str | None, typer.Option(help="Address of the Dask scheduler, tcp://host:8786 say.")
]


def check_backend(backend: Backend, scheduler: str | None) -> None:
    """Refuse a cluster without an address, and an address without a cluster."""
    if (backend is Backend.dask) != (scheduler is not None):
        raise InputError("--backend dask and --scheduler ADDRESS belong together; give both, or neither")


def config_of(
    source: Path, model: Path | None, out: Path | None, window: str | None = None, **changes: Any
) -> StudyConfig:
    """The config that a command works by, with the options that replace values of the study file.

    Args:
        source: Study file, dataset folder or dataset file.
        model: Model file.
        out: Folder for the results.
        window: Length of the free runs, or its word.
        changes: Further values of the study file, `identification__starts`; None changes nothing.

    Raises:
        InputError: a fault in the study or in an option.
    """
    named = {name.replace("__", "."): value for name, value in changes.items()}
    named |= {
        "model": None if model is None else str(model),
        "output.folder": None if out is None else str(out),
    }
    if window is not None:
        from hybrid_id.study import Horizon

        horizon = Horizon.of(window)
        seconds = horizon.seconds if horizon is not None and horizon.kind == "windows" else window
        named["identification.window"] = seconds
    return study_config(source, named)


def use_device(name: str) -> str:
    """Return the device's name, or say in a sentence why it cannot be used."""
    import torch

    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(f"device '{name}' cannot be used ({reason}); use cpu") from None
    return name

"""`doctor`: whether this machine is fit for the work."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

import typer

from hybrid_id import __version__
from hybrid_id.cli.console import show, show_json
from hybrid_id.cli.options import JsonOption
from hybrid_id.errors import InputError

NEEDED = (
    "torch",
    "torchdiffeq",
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "pydantic",
    "matplotlib",
    "tensorboard",
    "typer",
)
OPTIONAL = {"mujoco": "blind", "dask": "dask", "rosbags": "logs", "h5py": "logs"}
"""Packages beyond those, and the extra of hybrid-id that brings each."""


def doctor(
    ahead: Annotated[
        bool,
        typer.Option(
            "--ahead", help="First compile the code of the shipped systems for all who use this environment."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show versions, device, threads and compiler, and identify a small drive whose truth is known.

    Ends with exit code 1 when the self-test misses that truth. Its records are the same on every machine.
    """
    if ahead:
        from hybrid_id.cli.console import remark
        from hybrid_id.reporting.tables import count
        from hybrid_id.study.ahead import compile_ahead

        remark(f"compiled ahead: {count(compile_ahead(), 'system')}")
    from hybrid_id.paper.demo import self_test

    try:
        tried = self_test()
    except (ImportError, InputError, RuntimeError) as error:  # a package that is missing, say
        tried = {"passed": False, "off": [], "error": f"{type(error).__name__}: {error}"}
    state = {"machine": machine(), "packages": packages(), "self_test": tried}
    if as_json:
        show_json("doctor", state)
    else:
        _say(state)
    if not state["self_test"]["passed"]:
        raise typer.Exit(1)


def machine() -> dict[str, Any]:
    """What the machine offers."""
    import torch

    from hybrid_id.paper.demo import compiler

    gpu = torch.cuda.get_device_name(0) if torch.cuda.is_available() else None
    return {
        "hybrid_id": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": torch.get_num_threads(),
        "gpu": gpu,
        "compiler": compiler(),
    }


def packages() -> dict[str, str | None]:
    """Version of each package, None where it is not installed."""
    found: dict[str, str | None] = {}
    for name in (*NEEDED, *OPTIONAL):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def _say(state: dict[str, Any]) -> None:
    """The same for a reader."""
    from hybrid_id.paper.demo import FIT, MOST_ERRORS
    from hybrid_id.reporting.tables import open_table

    table = open_table("what", "here")
    words = {"gpu": "none", "compiler": "none: the compiled engine is not available"}
    for name, value in state["machine"].items():
        table.add_row(name, str(value if value is not None else words.get(name, "unknown")))
    for name, found in state["packages"].items():
        missing = (
            f"not installed; pip install 'hybrid-id[{OPTIONAL[name]}]' brings it"
            if name in OPTIONAL
            else "MISSING"
        )
        table.add_row(name, found or missing)
    test = state["self_test"]
    if "error" in test:
        show(table, f"self-test FAILED: {test['error']}")
        return
    verdict = "passed" if test["passed"] else f"FAILED ({', '.join(test['off']) or 'the fit'} off)"
    how = f"{test['fit_percent']:.2f} % of a record that was held back explained (at least {FIT:g} %)"
    show(
        table,
        f"self-test {verdict}: a drive of known truth identified in {test['seconds']:.1f} s, {how}; each estimate "
        f"with a standard error has to lie within {MOST_ERRORS:g} of them",
    )

"""`doctor`: whether this machine is fit for the work."""

import os
import platform
import tempfile
import time
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import typer

from hybrid_id import __version__
from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import show
from hybrid_id.cli.options import JsonOption, ThreadsOption, use_threads
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
OPTIONAL = {"mujoco": "blind", "dask": "dask"}
"""Packages beyond those, and the extra of hybrid-id that brings each."""
REACH = 4.0
"""Standard errors within which the self-test's estimates have to be: its records are drawn once and for all."""
FIT = 97.0
"""Fit [%] that the identified model has to reach on the record that was held back."""


def doctor(as_json: JsonOption = False, threads: ThreadsOption = 1) -> None:
    """Tell versions, device, threads and compiler, and identify a small drive whose truth is known.

    Ends with exit code 1 when the self-test misses that truth. Its records are the same on every machine.
    """
    use_threads(threads)
    told = {"machine": machine(), "packages": packages(), "self_test": _tried()}
    if as_json:
        from hybrid_id.reporting.results import as_json as to_json

        stdout().print(to_json("doctor", told), markup=False, soft_wrap=True)
    else:
        _say(told)
    if not told["self_test"]["passed"]:
        raise typer.Exit(1)


def _tried() -> dict[str, Any]:
    """The self-test, or what kept it from its end: a package that is missing, say."""
    try:
        return self_test()
    except (ImportError, InputError, RuntimeError) as error:
        return {"passed": False, "off": [], "error": f"{type(error).__name__}: {error}"}


def machine() -> dict[str, Any]:
    """What the machine offers."""
    import torch

    from hybrid_id.simulation.c_code import compiler

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


def self_test() -> dict[str, Any]:
    """Identify a small simulated drive, pooled over two records, and hold the estimates against its truth."""
    from hybrid_id.study import identify
    from hybrid_id.systems.model_file import load_model
    from hybrid_id.twin.campaign import write_campaign
    from hybrid_id.twin.demo import DEMO

    runs = [DEMO["excitation"]["experiments"][k] | {"tones": 6} for k in (1, 3, 5)]
    settings = DEMO | {"duration": 2.0, "excitation": DEMO["excitation"] | {"starts": 2, "experiments": runs}}
    settings["disturbances"] = DEMO["disturbances"] | {"friction_drift": 0.0}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        dataset, truths = write_campaign(folder, settings, 0)
        study = identify(dataset, load_model(f"{folder}/model_priors.yaml"), pooled=True)
    values = dict(zip(study.names, study.selected.values, strict=True))
    errors = dict(zip(study.names, study.standard_errors(study.selection.index), strict=True))
    parameters = {
        name: {"truth": truths[0][name], "estimate": value, "standard_error": errors[name]}
        for name, value in values.items()
    }
    off = [
        n
        for n, row in parameters.items()
        if abs(row["estimate"] - row["truth"]) > REACH * row["standard_error"]
    ]
    fit = 100.0 * (1.0 - next(iter(study.test_nrmse.values())))
    return {
        "passed": not off and fit >= FIT,
        "off": off,
        "fit_percent": fit,
        "seconds": time.perf_counter() - start,
        "parameters": parameters,
    }


def _say(told: dict[str, Any]) -> None:
    """The same for a reader."""
    from hybrid_id.reporting.tables import open_table

    table = open_table("what", "here")
    words = {"gpu": "none", "compiler": "none: the compiled engine is not available"}
    for name, value in told["machine"].items():
        table.add_row(name, str(value if value is not None else words.get(name, "unknown")))
    for name, found in told["packages"].items():
        missing = (
            f"not installed; pip install 'hybrid-id[{OPTIONAL[name]}]' brings it"
            if name in OPTIONAL
            else "MISSING"
        )
        table.add_row(name, found or missing)
    test = told["self_test"]
    if "error" in test:
        show(table, f"self-test FAILED: {test['error']}")
        return
    verdict = "passed" if test["passed"] else f"FAILED ({', '.join(test['off']) or 'the fit'} off)"
    how = f"{test['fit_percent']:.2f} % of a record that was held back explained (at least {FIT:g} %)"
    show(
        table,
        f"self-test {verdict}: a drive of known truth identified in {test['seconds']:.1f} s, {how}; each estimate "
        f"with a standard error has to lie within {REACH:g} of them",
    )

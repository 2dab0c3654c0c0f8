"""`ablate`: physics only against hybrid on the same records and seeds."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hybrid_id.cli.console import counting, remark, show
from hybrid_id.cli.folder import EVENTS, added_results, refuse_foreign, required, sole_writer
from hybrid_id.cli.inputs import check_windows, checked_records, load_system
from hybrid_id.cli.options import (
    Backend,
    BackendOption,
    JsonOption,
    ModelOption,
    OutOption,
    ProcessesOption,
    SchedulerOption,
    SourceArgument,
    check_backend,
    config_of,
    use_threads,
)
from hybrid_id.cli.results import files_in, write_last, write_report
from hybrid_id.cli.train import check_network, say_how_long
from hybrid_id.config import Ablation, Hybrid, StudyConfig
from hybrid_id.errors import InputError, listed
from hybrid_id.reading import read_object
from hybrid_id.records.files import make_folder
from hybrid_id.reporting.provenance import program

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study.ablation import CellResult, Task
    from hybrid_id.study.ablation_plan import Cell, Factors
    from hybrid_id.study.ablation_result import Ablation as Outcome
    from hybrid_id.systems.chain import System

CELLS, RESULT = "cells", "ablation.json"


def ablate(
    source: SourceArgument,
    model: ModelOption = None,
    out: OutOption = None,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Physics only or hybrid? Arms on the same records and seeds, paired differences, and the answer in words.

    The `ablation` section of the study file says what the arms differ in (configs/ablation.yaml). Each cell, one arm in
    one repeat, is kept as soon as it is done: after Ctrl-C the same command goes on. `tensorboard --logdir DIR` shows
    the cells that are done, with their settings.
    """
    check_backend(backend, scheduler)
    config = config_of(source, model, out)
    if config.identification.device != "cpu":
        raise InputError(
            f"key 'identification.device' is '{config.identification.device}', but cells are computed on the cpu; "
            "set it to cpu"
        )
    home = required(config.output.folder)
    refuse_foreign(home, CELLS, "*/cell.json")
    dataset = checked_records(config)
    if (home / RESULT).exists() and (
        other := read_object(home / RESULT, "ablation").get("dataset")
    ) != dataset.name:
        raise InputError(f"{home} holds the ablation of another dataset, '{other}'; give another folder")
    use_threads(1)
    system = load_system(config, dataset)
    say_how_long(system)
    task, cells = planned(config, dataset, system)
    if config.ablation is None:
        remark(
            f"the study file has no section 'ablation': the {len(cells)} cells of the default plan are computed"
        )
    make_folder(home / CELLS)
    with sole_writer(home):
        results = _run(task, cells, home, jobs, scheduler, events=config.output.tensorboard)
        outcome = _gather(config, results)
        text = _write(home, config, dataset, outcome)
    if as_json:
        show(text)
    else:
        from hybrid_id.reporting.ablation import ablation_tables

        show(ablation_tables(outcome))
        show(files_in(home, config, RESULT, CELLS, *([EVENTS] if config.output.tensorboard else [])))
    if broken := [r for r in results if r.status != "done"]:
        remark(f"{len(broken)} of {len(results)} cells broke; the same command tries them again")
        raise typer.Exit(1)


def planned(config: StudyConfig, dataset: "Dataset", system: "System") -> "tuple[Task, list[Cell]]":
    """What all cells share, and the cells; every arm is built once, so that faults show before any training."""
    from hybrid_id.config.settings import hybrid_options, ode_engine
    from hybrid_id.study.ablation import Task
    from hybrid_id.study.ablation_plan import plan, records_beyond

    wish, how = config.ablation or Ablation(), config.hybrid or Hybrid()
    if system.learned:
        raise InputError(
            f"model {config.model} has a network ({listed(system.learned)}); give one without, to which the ablation "
            "adds its own"
        )
    first = how.networks[0] if how.networks else Hybrid().networks[0]
    task = Task(
        dataset, system, ode_engine(config), hybrid_options(config, how),
        tuple(first.inputs), wish.memory, first.lipschitz, wish.validation, wish.test, tuple(wish.out_of_range),
        wish.horizon, config.preprocessing.signal_share,
    )  # fmt: skip
    seeds = list(range(wish.seeds)) if isinstance(wish.seeds, int) else wish.seeds
    cells = plan(_factors(wish, first.place, first.hidden), seeds)
    with config.at("ablation.out_of_range"):
        records_beyond(dataset, wish.out_of_range)
    with config.at("ablation"):
        splits = [task.split(seed) for seed in seeds]
    _check_arms(task, config, [cell for cell in cells if cell.seed == seeds[0]])
    for key, names in (("hybrid.windows", splits[0].train), ("ablation.horizon", [r.name for r in dataset])):
        check_windows(config, key, [record for record in dataset if record.name in names])
    return task, cells


def _check_arms(task: "Task", config: StudyConfig, cells: "Sequence[Cell]") -> None:
    """Build every arm once; a refusal of the model names the key that asks for it."""
    from hybrid_id.study.ablation_plan import without_parts

    wish, first = config.ablation or Ablation(), "hybrid.networks[0]"
    places = {f"ablation.place[{k}]": where for k, where in enumerate(wish.place or [])}
    for key, where in (places or {f"{first}.place": [p for cell in cells for p in cell.arm.places]}).items():
        for place in [where] if isinstance(where, str) else where:
            check_network(task.system, config, (key, place), (f"{first}.inputs", task.inputs))
    for k, taken in enumerate(wish.physics):
        with config.at(f"ablation.physics[{k}]"):
            without_parts(task.system, taken)
    with config.at("ablation"):  # what does not go together
        for cell in cells:
            task.model(cell)


def _factors(wish: Ablation, place: str, hidden: Sequence[int]) -> "Factors":
    from hybrid_id.study.ablation_plan import Factors

    places = tuple((p,) if isinstance(p, str) else tuple(p) for p in wish.place or [place])
    return Factors(
        residuals=tuple(kind for kind in ("static", "memory") if kind in wish.residual),
        places=places,
        widths=tuple(wish.width or hidden[:1] or [8]),
        physics=tuple(tuple(taken) for taken in wish.physics),
        black_box=wish.black_box_width if "black_box" in wish.residual else None,
        reads=tuple(wish.reads),
    )


def _run(
    task: "Task", cells: "Sequence[Cell]", home: Path, jobs: int, scheduler: str | None, *, events: bool
) -> "list[CellResult]":
    """Compute the cells that no earlier run has kept, keep each as it is done, and return all in their order.

    TensorBoard shows what these cells came to: runs of an earlier plan go, and come back with it from the kept cells.
    """
    from hybrid_id.reporting.tensorboard import write_cell_events
    from hybrid_id.study.ablation import CELL, key_of, load_cell, run_cells, save_cell

    keys = {cell: key_of(task, cell, program()) for cell in cells}
    found = {cell: kept for cell in cells if (kept := load_cell(home / CELLS, cell, keys[cell])) is not None}
    left = [cell for cell in cells if cell not in found]
    if found:
        remark(f"{len(found)} of {len(cells)} cells are kept from before")
    kept = {path.parent.name for path in (home / CELLS).glob(f"[!.]*/{CELL}")}
    earlier = sorted(kept - {cell.name for cell in cells})
    if earlier:
        names = ", ".join(earlier[:3]) + (" ..." if len(earlier) > 3 else "")
        remark(f"{len(earlier)} cells of an earlier plan stay in {home / CELLS} and count nowhere: {names}")
    for name in (*earlier, *(cell.name for cell in left)):
        shutil.rmtree(home / EVENTS / name, ignore_errors=True)
    for cell, result in found.items():
        if events and not (home / EVENTS / cell.name).is_dir():
            write_cell_events(home / EVENTS, result)
    try:
        with counting("cells") as bar:
            bar_id = bar.add_task("cells", total=len(left))
            for result in run_cells(task, left, jobs=jobs, scheduler=scheduler):
                found[result.cell] = result
                if result.status == "done":
                    save_cell(home / CELLS, result, keys[result.cell])
                    if events:
                        write_cell_events(home / EVENTS, result)
                bar.advance(bar_id)
                line = f"{len(found)} of {len(cells)}: {result.cell.name}, {_in_short(result)}"
                bar.console.print(line, markup=False, soft_wrap=True, style="dim")
    except KeyboardInterrupt:
        done = sum(result.status == "done" for result in found.values())
        raise KeyboardInterrupt(
            f"stopped; {done} of {len(cells)} cells are kept in {home / CELLS}, and the same command goes on"
        ) from None
    return [found[cell] for cell in cells]


def _gather(config: StudyConfig, results: "Sequence[CellResult]") -> "Outcome":
    """The cells side by side; an InputError where there is nothing to compare with."""
    from hybrid_id.study.ablation_plan import Arm
    from hybrid_id.study.ablation_result import gather

    physics = [result for result in results if result.cell.arm == Arm()]
    if not any(result.status == "done" for result in physics):
        raise InputError(
            f"no fit of physics only came to an end ({physics[0].message}); see 'hybrid-id check'"
        )
    return gather(results, level=config.statistics.level, worth=(config.hybrid or Hybrid()).worth)


def _in_short(result: "CellResult") -> str:
    return (
        result.message if result.status != "done" else f"{result.gradients} gradients, {result.seconds:.0f} s"
    )


def _write(home: Path, config: StudyConfig, dataset: "Dataset", outcome: "Outcome") -> str:
    """Pictures, page and `ablation.json` into the folder, under a temporary name first; returns the last as text."""
    from hybrid_id.reporting.ablation import PICTURES, ablation_page, ablation_pictures, ablation_result
    from hybrid_id.reporting.results import as_json

    text = as_json("ablate", {"dataset": dataset.name} | ablation_result(outcome))
    with added_results(home, RESULT, [*(f"{name}.png" for name in PICTURES), "report.html"]) as folder:
        whole = write_report(
            folder, home, config, "ablate", figures=lambda: ablation_pictures(outcome),
            page=lambda pictures: ablation_page(dataset, outcome, pictures),
        )  # fmt: skip
        if not whole:
            raise KeyboardInterrupt  # the cells are kept
        write_last(folder / RESULT, text)
    return text

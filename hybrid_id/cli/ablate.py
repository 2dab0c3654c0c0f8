"""`ablate`: physics only against hybrid on the same records and seeds."""

import shutil
from typing import TYPE_CHECKING

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import kept_pieces, remark
from hybrid_id.cli.folder import EVENTS, added_results, refuse_foreign, required, sole_writer
from hybrid_id.cli.inputs import check_windows, checked_records, load_system
from hybrid_id.cli.results import Results, write_last
from hybrid_id.cli.train import check_network, say_how_long
from hybrid_id.config import Ablation, Hybrid, StudyConfig
from hybrid_id.errors import InputError, listed
from hybrid_id.reading import read_object
from hybrid_id.records.files import make_folder
from hybrid_id.reporting.provenance import program

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study.ablation import Cell, CellResult, Task
    from hybrid_id.study.many import Failure
    from hybrid_id.systems.chain import System

CELLS, CELL, RESULT = "cells", "cell.json", "ablation.json"


def ablate(
    source: options.SourceArgument,
    model: options.ModelOption = None,
    out: options.OutOption = None,
    jobs: options.ProcessesOption = 1,
    backend: options.BackendOption = options.Backend.joblib,
    scheduler: options.SchedulerOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """Physics only or hybrid? Arms on the same records and seeds, paired differences, and the answer in words.

    The `ablation` section of the study file says what the arms differ in (configs/ablation.yaml). Each cell, one arm in
    one repeat, is kept as soon as it is done: after Ctrl-C the same command goes on. `tensorboard --logdir DIR` shows
    the cells that are done, with their settings.
    """
    options.check_backend(backend, scheduler)
    config = options.config_of(source, model, out)
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
    system = load_system(config, dataset)
    say_how_long(system)
    task, cells = planned(config, dataset, system)
    if config.ablation is None:
        remark(
            f"the study file has no section 'ablation': the {len(cells)} cells of the default plan are computed"
        )
    from hybrid_id.records.yaml_file import write_yaml
    from hybrid_id.reporting.ablation import (
        PICTURES,
        ablation_page,
        ablation_pictures,
        ablation_result,
    )
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.tensorboard import write_cell_events
    from hybrid_id.study.ablation import run_cells
    from hybrid_id.study.ablation_result import gather
    from hybrid_id.study.many import Failure

    kept, events = make_folder(home / CELLS), home / EVENTS
    with sole_writer(home):
        folders = {path.parent.name for path in kept.glob(f"[!.]*/{CELL}")}
        # TensorBoard shows this plan: runs of an earlier one go, and come back with it from the kept cells
        if earlier := sorted(folders - {cell.name for cell in cells}):
            names = ", ".join(earlier[:3]) + (" ..." if len(earlier) > 3 else "")
            remark(f"{len(earlier)} cells of an earlier plan stay in {kept} and count nowhere: {names}")
            for name in earlier:
                shutil.rmtree(events / name, ignore_errors=True)
        with kept_pieces(CELLS, len(cells), kept) as say:

            def done(name: str, result: "CellResult | Failure", before: bool) -> None:
                if not before:
                    shutil.rmtree(events / name, ignore_errors=True)
                if not isinstance(result, Failure):
                    if config.output.tensorboard and not (events / name).is_dir():
                        write_cell_events(events, result)
                    if result.model and not before:
                        write_yaml(make_folder(kept / name) / "model.yaml", result.model)
                say(name, result, before)

            done_cells, failed = run_cells(
                task, cells, lambda name: kept / name / CELL, jobs=jobs, scheduler=scheduler, program=program(),
                done=done,
            )  # fmt: skip
        worth = (config.hybrid or Hybrid()).worth
        outcome = gather(done_cells, failed, level=config.statistics.level, worth=worth)
        text = to_json("ablate", {"dataset": dataset.name} | ablation_result(outcome))
        with added_results(home, RESULT, [*(f"{name}.png" for name in PICTURES), "report.html"]) as folder:
            results = Results(folder, home, config, "ablate")
            whole = results.report(
                lambda: ablation_pictures(outcome),
                lambda pictures: ablation_page(dataset, outcome, pictures),
            )
            if not whole:
                raise KeyboardInterrupt  # the cells are kept
            write_last(folder / RESULT, text)
    names = [RESULT, CELLS, *([EVENTS] if config.output.tensorboard else [])]
    results.show(text, ablation_page(dataset, outcome, {}).screen(), *names, as_json=as_json)
    if failed:
        raise typer.Exit(1)


def planned(config: StudyConfig, dataset: "Dataset", system: "System") -> "tuple[Task, list[Cell]]":
    """What all cells share, and the cells; every arm is built once, so that faults show before any training."""
    from hybrid_id.config.settings import hybrid_options, ode_engine
    from hybrid_id.study.ablation import Cell, Task, arms, records_beyond, split_records, without_parts

    wish, how = config.ablation or Ablation(), config.hybrid or Hybrid()
    network = how.networks[0] if how.networks else Hybrid().networks[0]
    if system.learned:
        raise InputError(
            f"model {config.model} has a network ({listed(system.learned)}); give one without, to which the ablation "
            "adds its own"
        )
    task = Task(
        dataset, system, ode_engine(config), hybrid_options(config, how), tuple(network.inputs), wish.memory,
        network.lipschitz, wish.horizon,
    )  # fmt: skip
    with config.at("ablation.out_of_range"):
        records_beyond(dataset, wish.out_of_range)
    with config.at("ablation"):
        splits = {
            seed: split_records(
                dataset, seed, validation=wish.validation, test=wish.test, beyond=wish.out_of_range
            )
            for seed in wish.seeds
        }
    plan = arms(
        residuals=[kind for kind in ("static", "memory") if kind in wish.residual],
        places=[tuple(where) for where in wish.place or [[network.place]]],
        widths=wish.width or network.hidden[:1] or [8],
        reads=wish.reads,
        physics=[tuple(taken) for taken in wish.physics],
        black_box=wish.black_box_width if "black_box" in wish.residual else None,
    )
    # a refusal of the model names the key that asks for it
    first = "hybrid.networks[0]"
    places = {f"ablation.place[{k}]": where for k, where in enumerate(wish.place or [])}
    for key, where in (places or {f"{first}.place": [p for arm in plan for p in arm.places]}).items():
        for place in where:
            check_network(system, config, (key, place), (f"{first}.inputs", task.inputs))
    for k, taken in enumerate(wish.physics):
        with config.at(f"ablation.physics[{k}]"):
            without_parts(system, taken)
    with config.at("ablation"):  # what does not go together
        for arm in plan:
            task.model(arm, wish.seeds[0])
    trained = [dataset[name] for name in splits[wish.seeds[0]].train]
    for key, records in (("hybrid.windows", trained), ("ablation.horizon", list(dataset))):
        check_windows(config, key, records)
    # repeat by repeat, so that what is done first can be compared
    return task, [Cell(arm, seed, splits[seed]) for seed in wish.seeds for arm in plan]

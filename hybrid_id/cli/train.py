"""`train`: parameters by the adjoint method, and with a `hybrid` section residual networks beside the physics."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import FitProgress, console, counting, remark
from hybrid_id.cli.folder import (
    CHECKPOINT,
    EVENTS,
    RESULT,
    added_results,
    go_on,
    live_folder,
    required,
    results_folder,
)
from hybrid_id.cli.inputs import (
    MOST_JOINTS,
    check_window,
    check_windows,
    checked_records,
    load_system,
    remark_idle,
)
from hybrid_id.cli.results import Results, show_study, write_last, write_study
from hybrid_id.config import Hybrid, StudyConfig
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from hybrid_id.records.dataset import Dataset
    from hybrid_id.reporting.page import Page
    from hybrid_id.systems.chain import System


def train(
    source: options.SourceArgument,
    model: options.ModelOption = None,
    out: options.OutOption = None,
    resume: options.ResumeOption = False,
    pooled: options.PooledOption = None,
    seed: options.SeedOption = None,
    device: options.DeviceOption = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(
            help="Joint of a robot, or 'all': a small network for what its physics leaves, by least squares, kept "
            "where records left out are surely better for it. May be given several times."
        ),
    ] = None,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Train through the differential equation by the adjoint method; the same results as identify, and TensorBoard.

    Prefer it to identify for residual networks, for another ODE solver, and to watch a long fit in TensorBoard.
    For physical parameters alone, identify is faster, and takes dry friction as it is where train smooths it.

    With a `hybrid` section in the study file, residual networks train beside the physics (configs/study_hybrid.yaml).
    While it runs, `tensorboard --logdir DIR` shows its history. Ctrl-C ends it with what it has; --resume goes on.

    With --joint, a robot's joints get networks one by one, the others as measured, by least squares: seconds a joint,
    so that no fits are kept and --resume, --device and --per-record have no use.
    """
    config = options.config_of(
        source, model, out, identification__pooled=pooled, identification__seed=seed,
        identification__device=device,
    )  # fmt: skip
    home = required(config.output.folder)
    if joint:
        if pooled is False:
            raise InputError("--joint fits one set over all records; leave --per-record out")
        by_joint(config, home, joint, force=force, resume=resume, as_json=as_json)
        return
    with live_folder(home, config, force=force, resume=resume):
        dataset = checked_records(config)
        system = load_system(config, dataset)
        say_how_long(system)
        if any(c.name.startswith("tau_a") for c in dataset.outputs) and any(system.dry):
            raise InputError(
                f"{config.dataset}: 'train' smooths dry friction, with which the torque at the link (tau_a) jumps; "
                "leave tau_a out of its outputs, or take 'identify'."
            )
        options.use_device(config.identification.device)
        if config.hybrid is not None:
            if pooled is False:
                raise InputError(
                    "--per-record has no meaning with networks, which all records share; leave it out"
                )
            from hybrid_id.components import ResidualNetwork
            from hybrid_id.study.hybrid import split
            from hybrid_id.systems.by_joint import numbered

            for k, network in enumerate([] if system.networks else config.hybrid.networks):
                key, place = f"hybrid.networks[{k}]", numbered(system, network.place)
                check_network(
                    system, config, (f"{key}.place", network.place), (f"{key}.inputs", network.inputs)
                )
                wish = network.model_dump(exclude={"place"})
                system = system.with_component(
                    place, ResidualNetwork(**wish, seed=config.identification.seed)
                )
            with config.at("hybrid.validation"):
                trained, _ = split(dataset, config.hybrid.validation)
            check_windows(config, "hybrid.windows", trained)
        else:
            check_windows(config, "training.windows", dataset.train)
            remark_idle(
                config.identification,
                "'train' has one start and a smooth friction of its own ('training.width', 'training.fine')",
                ("starts", "friction", "substeps"),
            )
        run = _hybrid if config.hybrid is not None else _physics
        if run(dataset, system, config, home, resume=resume, as_json=as_json):
            remark(f"stopped; {go_on(home)} from here")  # what this one replaces is kept
            raise typer.Exit(130)


def by_joint(
    config: StudyConfig,
    home: Path,
    joints: list[str],
    *,
    force: bool,
    resume: bool,
    as_json: bool,
) -> None:
    """Networks at a robot's joints, one by one: write the folder of results and print them."""
    if config.hybrid is not None:
        raise InputError(
            "--joint learns one kind of network by itself; leave it out for those of the section 'hybrid', or take "
            "that section out"
        )
    if "all" in joints and len(set(joints)) > 1:
        raise InputError("--joint all takes every joint; leave the others out")
    if resume:
        raise InputError("--joint takes seconds a joint and keeps no fits; leave --resume out")
    remark_idle(config.identification, "train --joint fits least squares in its own way")
    dataset = checked_records(config)
    with config.at("identification.window"):
        check_window(config.identification.window, dataset.records)
    from hybrid_id.reporting.residual_torques import (
        residuals_page,
        residuals_pictures,
        residuals_result,
    )
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.results import write_physics
    from hybrid_id.study import Horizon
    from hybrid_id.study.residual_torques import learn_residuals

    system = load_system(config, dataset)
    if system.tree is None:
        raise InputError(
            f"{config.model}: --joint takes joints of a robot only, whose description the model has to name"
        )
    with results_folder(home, force=force) as folder:
        with counting("joints") as bar:
            bar_id = bar.add_task("joints")

            def say(name: str, done: int, total: int) -> None:
                bar.update(bar_id, description=name, completed=done, total=total)

            found = learn_residuals(
                dataset, system, [] if "all" in joints else joints,
                horizon=Horizon.of(config.identification.window), say=say,
            )  # fmt: skip
        results = Results(folder, home, config, "train")
        results.model(found.system)
        results.model(found.physics, "physics.yaml")
        write_physics(folder / "parameters.csv", found)
        text = to_json("train", {"dataset": dataset.name} | residuals_result(found))
        whole = results.report(
            lambda: residuals_pictures(found), lambda pictures: residuals_page(dataset, found, pictures)
        )
        write_last(folder / RESULT, text)
    names = ("parameters.csv", RESULT, "model.yaml", "physics.yaml")
    results.show(text, residuals_page(dataset, found, {}).screen(), *names, as_json=as_json)
    if found.interrupted or not whole:
        raise typer.Exit(130)


def say_how_long(system: "System") -> None:
    """Say that an arm of many joints takes its time: its training has no compiled steps."""
    if system.tree is not None and len(system.joints) > MOST_JOINTS:
        remark(
            f"training {len(system.joints)} joints takes minutes for a few seconds of record and joint; Ctrl-C keeps "
            "what it has, and 'identify' is much faster where no network is to be trained"
        )


def _physics(
    dataset: "Dataset", system: "System", config: StudyConfig, home: Path, *, resume: bool, as_json: bool
) -> bool:
    """Train, write the folder of results and print them; whether Ctrl-C has stopped it."""
    from hybrid_id.config.settings import ode_engine, train_options
    from hybrid_id.reporting.tensorboard import TrainingLog
    from hybrid_id.study import analyse_fits
    from hybrid_id.study.training import train as train_all

    wish, saved = config.identification, home / CHECKPOINT
    n_sets = 1 if wish.pooled else len(dataset.train)
    with (
        TrainingLog(home / EVENTS) if config.output.tensorboard else nullcontext() as log,
        FitProgress(n_sets, config.training.max_iterations, polite=False) as progress,
    ):
        sets = train_all(
            dataset, system, pooled=wish.pooled, engine=ode_engine(config), options=train_options(config),
            device=wish.device, writer=log, checkpoint=saved, resume=saved if resume else None,
            progress=progress,
        )  # fmt: skip
    interrupted = any(result.status == "interrupted" for result in sets)
    if interrupted and not saved.exists():
        raise KeyboardInterrupt  # no results were written
    study = analyse_fits(
        dataset,
        system,
        sets,
        pooled=wish.pooled,
        seed=wish.seed,
        level=config.statistics.level,
    )
    with added_results(home) as folder:
        results = Results(folder, home, config, "train")
        text, whole = write_study(results, dataset, study)
    show_study(results, study, text, as_json=as_json)
    if any(system.dry):
        remark(
            f"dry friction was smoothed over ±{config.training.width:g} rad/s, as the adjoint needs; 'identify' takes "
            "it as it is, so small differences between their estimates are the smoothing's"
        )
    return interrupted or not whole


def _hybrid(
    dataset: "Dataset", system: "System", config: StudyConfig, home: Path, *, resume: bool, as_json: bool
) -> bool:
    """Train physics with networks, write the folder of results and print them; whether Ctrl-C has stopped it."""
    from hybrid_id.config.settings import hybrid_options, ode_engine
    from hybrid_id.reporting.hybrid import hybrid_page, hybrid_pictures, hybrid_result, hybrid_tables
    from hybrid_id.reporting.residuals import residual_result
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.tensorboard import TrainingLog, write_images
    from hybrid_id.study.hybrid import hybrid_residuals, hybridise, physics_alone

    wish, err, saved = config.hybrid or Hybrid(), console(stderr=True), home / CHECKPOINT
    with (
        TrainingLog(home / EVENTS) if config.output.tensorboard else nullcontext() as log,
        err.status("physics alone") if err.is_terminal else nullcontext() as line,
    ):

        def progress(stage: str, count: int, loss: float) -> bool:
            if line is not None:
                line.update(
                    f"{stage}: gradient {count}, error {(2.0 * loss) ** 0.5:.4g} (1 = as the noise says)"
                )
            return False

        study = hybridise(
            dataset, system, engine=ode_engine(config), options=hybrid_options(config, wish),
            validation=wish.validation, device=config.identification.device,
            level=config.statistics.level, writer=log, checkpoint=saved, resume=saved if resume else None,
            progress=progress,
        )  # fmt: skip
    if study.result.interrupted and not saved.exists():
        raise KeyboardInterrupt  # no results were written
    residuals = hybrid_residuals(dataset, study)
    content = hybrid_result(study) | {"residual_tests": residual_result(residuals)}
    text = to_json("train", {"dataset": dataset.name} | content)

    def page(pictures: "dict[str, np.ndarray]") -> "Page":
        alone = physics_alone(dataset, study)
        return hybrid_page(dataset, study, pictures, alone=alone, residuals=residuals)

    with added_results(home) as folder:
        results = Results(folder, home, config, "train")
        results.model(study.result.system)
        results.model(study.result.physics.system, "physics.yaml")
        whole = results.report(
            lambda: hybrid_pictures(study),
            page,
            events=lambda place, images: write_images(place / "figures", images),
        )
        write_last(folder / RESULT, text)
    names = (RESULT, "model.yaml", "physics.yaml")
    results.show(text, hybrid_tables(study, dataset), *names, as_json=as_json)
    return study.result.interrupted or not whole


def check_network(
    system: "System", config: StudyConfig, place: tuple[str, str], inputs: tuple[str, Sequence[str]]
) -> None:
    """Refuse a place where the system can have no network, and inputs unknown there; each comes with its key."""
    from hybrid_id.components import ResidualNetwork
    from hybrid_id.systems.by_joint import numbered

    (place_key, where), (inputs_key, names) = place, inputs
    where = numbered(system, where)
    with config.at(place_key):
        system.with_component(where, ResidualNetwork(inputs=["speed"]))  # which is known everywhere
    with config.at(inputs_key):
        system.with_component(where, ResidualNetwork(inputs=names))

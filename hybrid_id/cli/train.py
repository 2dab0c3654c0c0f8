"""`train`: the objective of `identify`, minimised by the adjoint method."""

import copy
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli.console import remark
from hybrid_id.cli.folder import CHECKPOINT, EVENTS, required
from hybrid_id.cli.inputs import check_windows, checked_records, load_system
from hybrid_id.cli.options import (
    DeviceOption,
    ForceOption,
    JsonOption,
    ModelOption,
    OutOption,
    SeedOption,
    SourceArgument,
    ThreadsOption,
    use_device,
    use_threads,
)
from hybrid_id.cli.training_folder import (
    added_results,
    leave_without_checkpoint,
    live_folder,
    refuse_training,
    resumable,
    stopped,
)
from hybrid_id.config import Identification, StudyConfig, study_config
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.identification.result import FitResult
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.systems.chain import System


def train(
    source: SourceArgument,
    model: ModelOption = None,
    out: OutOption = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the unfinished training in the folder of results.")
    ] = False,
    pooled: Annotated[
        bool | None,
        typer.Option("--pooled/--per-record", help="One parameter set over all records, or one a record."),
    ] = None,
    seed: SeedOption = None,
    device: DeviceOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    threads: ThreadsOption = 1,
) -> None:
    """Train through the differential equation by the adjoint method; the same results as identify, and TensorBoard.

    With a `hybrid` section in the study file, residual networks train beside the physics (configs/study_hybrid.yaml).
    While it runs, `tensorboard --logdir DIR` shows its course. Ctrl-C ends it with what it has; --resume goes on.
    """
    config = study_config(
        source,
        {
            "model": None if model is None else str(model),
            "output.folder": None if out is None else str(out),
            "identification.pooled": pooled,
            "identification.seed": seed,
            "identification.device": device,
        },
    )
    home = required(config.output.folder)
    with resumable(home):
        refuse_training(home, config, force=force, resume=resume)
        dataset = checked_records(config)
        use_threads(threads)
        system = load_system(config, dataset)
        use_device(config.identification.device)
        if config.hybrid is not None:
            if pooled is False:
                raise InputError(
                    "--per-record has no meaning with networks, which all records share; leave it out"
                )
            from hybrid_id.cli.hybrid import train_with_networks

            return train_with_networks(
                config, dataset, system, home, resume=resume, force=force, as_json=as_json
            )
        check_windows(config, "training.windows", dataset.train)
        said, plain = config.identification, Identification()
        if others := [k for k in ("starts", "friction", "substeps") if getattr(said, k) != getattr(plain, k)]:
            remark(
                f"'train' has one start and a smooth friction of its own ('training.width', 'training.fine'), so that "
                f"{', '.join(others)} of 'identification' {'is' if len(others) == 1 else 'are'} not used"
            )
        from hybrid_id.cli.study import show_study, write_study
        from hybrid_id.study import analyse_fits

        wish = config.identification
        with live_folder(home, config, force=force, resume=resume):
            sets = _run(dataset, system, config, home, resume=resume)
            interrupted = any(result.status == "interrupted" for result in sets)
            leave_without_checkpoint(home, interrupted=interrupted)
            share = config.preprocessing.signal_share
            study = analyse_fits(
                dataset, system, sets, pooled=wish.pooled, seed=wish.seed, signal_share=share
            )
            with added_results(home) as folder:
                text = write_study(folder, home, "train", config, dataset, study)
            show_study(study, config, home, text, as_json=as_json)
            if any(system.dry):
                remark(
                    f"dry friction was smoothed over ±{config.training.width:g} rad/s, as the adjoint needs; "
                    "'identify' takes it as it is, so small differences between their estimates are the smoothing's"
                )
            if interrupted:  # what this one replaces is kept
                remark(stopped(home))
                raise typer.Exit(130)


def _run(
    dataset: "Dataset", system: "System", config: StudyConfig, folder: Path, *, resume: bool
) -> "list[FitResult]":
    """Train as the config says, with checkpoints and TensorBoard events in the folder."""
    from hybrid_id.cli.hybrid import engine_of
    from hybrid_id.cli.progress import FitProgress
    from hybrid_id.identification.adjoint import TrainOptions
    from hybrid_id.identification.adjoint import train as train_all
    from hybrid_id.identification.objective import Loss
    from hybrid_id.reporting.tensorboard import TrainingLog
    from hybrid_id.simulation.prepare import make_batch

    wish, how = config.identification, config.training
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    train_batch, test_batch = (
        make_batch(system, records, noise_std=noise, signal_share=config.preprocessing.signal_share).to(
            wish.device
        )
        if records
        else None
        for records in (dataset.train, dataset.test)
    )
    engine = engine_of(config)
    options = TrainOptions(
        windows=tuple(how.windows),
        max_iterations=how.max_iterations,
        tolerance=how.tolerance,
        loss=Loss(wish.loss, wish.threshold),
        validate_every=how.validate_every,
    )
    if train_batch is None:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'")
    saved = folder / CHECKPOINT
    n_sets = 1 if wish.pooled else len(dataset.train)
    with (
        TrainingLog(folder / EVENTS) if config.output.tensorboard else nullcontext() as log,
        FitProgress(n_sets, how.max_iterations, polite=False) as progress,
    ):
        return train_all(
            copy.deepcopy(system).to(wish.device), train_batch, pooled=wish.pooled, engine=engine, options=options,
            validation=test_batch, writer=log, checkpoint=saved, resume=saved if resume else None, progress=progress,
        )  # fmt: skip

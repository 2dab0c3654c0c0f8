"""`identify`: from records and a model to parameters with statistics."""

import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hybrid_id.cli.console import remark
from hybrid_id.cli.folder import RESULT, refuse_taken, required, results_folder
from hybrid_id.cli.inputs import checked_records, load_system
from hybrid_id.cli.options import (
    DeviceOption,
    ForceOption,
    JsonOption,
    ModelOption,
    OutOption,
    SeedOption,
    SourceArgument,
    ThreadsOption,
    WindowOption,
    as_window,
    use_device,
    use_threads,
)
from hybrid_id.config import StudyConfig, study_config
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.cli.progress import FitProgress
    from hybrid_id.identification.horizons import Horizon
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Study
    from hybrid_id.systems.chain import System


def identify(
    source: SourceArgument,
    model: ModelOption = None,
    out: OutOption = None,
    pooled: Annotated[
        bool | None,
        typer.Option("--pooled/--per-record", help="One parameter set over all records, or one a record."),
    ] = None,
    starts: Annotated[
        int | None, typer.Option(help="Start points; the best end counts.", min=1, show_default="1")
    ] = None,
    loss: Annotated[
        Literal["l2", "huber", "l1"] | None,
        typer.Option(help="huber and l1 tolerate spikes.", show_default="l2"),
    ] = None,
    window: WindowOption = None,
    seed: SeedOption = None,
    device: DeviceOption = None,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter whose interval is found by fits of all others; may be given several times."
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes that share the records.", min=1)] = 1,
    force: ForceOption = False,
    as_json: JsonOption = False,
    threads: ThreadsOption = 1,
) -> None:
    """Identify one parameter set for each train record (or one over all), with variation, cross-validation and trust.

    Writes report.html, result.json, parameters.csv, model.yaml, pictures and TensorBoard events.
    """
    config = study_config(
        source,
        {
            "model": None if model is None else str(model),
            "output.folder": None if out is None else str(out),
            "identification.pooled": pooled,
            "identification.starts": starts,
            "identification.loss": loss,
            "identification.window": None if window is None else as_window(window),
            "identification.seed": seed,
            "identification.device": device,
            "statistics.profile": profile or None,
        },
    )
    home = required(config.output.folder)
    refuse_taken(home, force=force, reads=config.reads)
    if config.hybrid is not None:
        remark("'train' uses the section 'hybrid' of this study; identify fits the physics alone")
    if jobs > 1 and config.identification.pooled:
        raise InputError(
            "--jobs shares records between processes, but --pooled needs all in one; leave one of them out"
        )
    dataset = checked_records(config)
    use_threads(threads)
    from hybrid_id.study.profiles import check_names

    system = load_system(config, dataset)
    use_device(config.identification.device)
    check_names(config.statistics.profile, [system.table[k].name for k in system.estimated])
    study, progress = run(dataset, system, config, jobs=jobs)
    leave_earlier(home, progress)

    from hybrid_id.cli.study import show_study, write_study

    with results_folder(home, force=force) as folder:
        text = write_study(folder, home, "identify", config, dataset, study)
    show_study(study, config, home, text, as_json=as_json)
    if progress.stopped:
        sets = "the sets are those of the last iteration, and result.json says which"
        whole = "the sets are complete" + (", the profiles are cut off" if config.statistics.profile else "")
        remark(f"stopped by Ctrl-C: {sets if progress.cut else whole}")
        raise typer.Exit(130)


def leave_earlier(home: Path, progress: "FitProgress") -> None:
    """End a run whose fits Ctrl-C has cut off before it replaces complete results."""
    if progress.cut and (home / RESULT).exists():
        raise KeyboardInterrupt(f"stopped; the earlier results in {home} stay as they are")


def run(
    dataset: "Dataset", system: "System", config: StudyConfig, *, jobs: int = 1
) -> "tuple[Study, FitProgress]":
    """Fit and assess as the config says; the progress knows whether the user has stopped that."""
    from hybrid_id.cli.progress import FitProgress
    from hybrid_id.identification.horizons import Horizon
    from hybrid_id.study import analyse_fits
    from hybrid_id.study import identify as identify_all

    wish = config.identification
    n_sets = (1 if wish.pooled else len(dataset.train)) * wish.starts
    share = config.preprocessing.signal_share
    with FitProgress(n_sets, wish.max_iterations) as progress:
        if jobs > 1:
            progress.say(f"fitting {len(dataset.train)} records in {jobs} processes")
            sets, horizon = _fit_in_processes(dataset, system, config, jobs, progress)
            progress.say("statistics")
            study = analyse_fits(
                dataset, system, sets, pooled=False, seed=wish.seed, signal_share=share, horizon=horizon
            )
        else:
            settings = fit_settings(config, progress)
            horizon = Horizon.of(wish.window)
            study = identify_all(
                dataset, system, device=wish.device, signal_share=share, horizon=horizon, **settings
            )
        if config.statistics.profile and not progress.stopped:
            study = _profiled(dataset, study, config, progress)
        return study, progress


def _profiled(dataset: "Dataset", study: "Study", config: StudyConfig, progress: "FitProgress") -> "Study":
    """The study with the profiles that the config asks for, each of which Ctrl-C cuts off."""
    from dataclasses import replace

    from hybrid_id.study import profiles

    wish = config.statistics
    options, share = fit_settings(config)["options"], config.preprocessing.signal_share

    def say(words: str) -> None:
        progress.say(words)
        if progress.stopped:
            raise KeyboardInterrupt

    found = profiles(
        dataset, study, wish.profile, level=wish.level, options=options, signal_share=share, progress=say
    )
    return replace(study, profiles=found)


def fit_settings(config: StudyConfig, progress: Callable[..., bool] | None = None) -> dict[str, Any]:
    """The config's settings as arguments of `fit`."""
    from hybrid_id.identification.least_squares import Options
    from hybrid_id.identification.objective import Loss
    from hybrid_id.simulation.step import Engine

    wish = config.identification
    return {
        "pooled": wish.pooled,
        "starts": wish.starts,
        "seed": wish.seed,
        "engine": Engine(wish.friction, wish.substeps, wish.width),
        "options": Options(wish.max_iterations, wish.tolerance, loss=Loss(wish.loss, wish.threshold)),
        "progress": progress,
    }


def _fit_in_processes(
    dataset: "Dataset", system: "System", config: StudyConfig, jobs: int, progress: "FitProgress"
) -> "tuple[list[Any], Horizon]":
    """One fit a record, the records shared between processes, and the horizon that they were fitted over."""
    from joblib import Parallel, delayed

    from hybrid_id.identification.horizon_choice import choose_horizon
    from hybrid_id.identification.horizons import Horizon
    from hybrid_id.study.fan_out import whole_pool
    from hybrid_id.study.replays import batch_of

    records = dataset.train
    shares = [range(k, len(records), jobs) for k in range(min(jobs, len(records)))]

    def fitted(horizon: Horizon) -> list[Any]:
        with TemporaryDirectory() as folder:
            progress.flag = stop = Path(folder) / "stop"
            with whole_pool():
                found = Parallel(n_jobs=jobs)(
                    delayed(fit_part)(dataset, share, system, config, stop, horizon) for share in shares
                )
            progress.flag = None
        by_record = {result.records[0]: result for results in found for result in results}  # type: ignore[union-attr]
        return [by_record[record.name] for record in records]

    horizon = Horizon.of(config.identification.window)
    sets = fitted(horizon or Horizon())
    if horizon is None:
        settings, share = fit_settings(config), config.preprocessing.signal_share
        batch = batch_of(dataset, system, records, share, "cpu")
        horizon = choose_horizon(system, settings["engine"], batch, sets, options=settings["options"])
        sets = sets if horizon.kind == "whole" or progress.stopped else fitted(horizon)
    return sets, horizon


def fit_part(
    dataset: "Dataset",
    share: Sequence[int],
    system: "System",
    config: StudyConfig,
    stop: Path,
    horizon: "Horizon",
) -> list[Any]:
    """The share of one process, train records by number; it ends early when the file `stop` is there."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the first process decides
    use_threads(1)
    import torch

    from hybrid_id.identification.fit import fit
    from hybrid_id.simulation.prepare import make_batch

    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    # all records first: the weight of an output that stands still in one is known from the others
    batch = make_batch(system, dataset.train, noise_std=noise, signal_share=config.preprocessing.signal_share)
    batch = batch.take(torch.tensor(share))
    device = config.identification.device
    settings = fit_settings(config, lambda *_: stop.exists())
    system = system.to(device)
    batch = horizon.cut(system, settings["engine"], batch.to(device))
    return fit(system, batch, numbers=share, **settings)

"""`identify`: from records and a model to parameters with statistics."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import FitProgress, remark
from hybrid_id.cli.folder import RESULT, keep_after, kept_fits, required, results_folder
from hybrid_id.cli.inputs import (
    check_window,
    checked_records,
    load_system,
    one_joint,
    remark_start_values,
    remark_validation,
)
from hybrid_id.cli.results import UNDRAWN, Results, show_study, write_study
from hybrid_id.config import StudyConfig
from hybrid_id.config.sections import MOST_STARTS
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Kept, Study
    from hybrid_id.systems.chain import System


def identify(
    source: options.SourceArgument,
    model: options.ModelOption = None,
    out: options.OutOption = None,
    pooled: options.PooledOption = None,
    joint: options.JointOption = None,
    starts: Annotated[
        int | None,
        typer.Option(help="Start points; the best end counts.", min=1, max=MOST_STARTS, show_default="1"),
    ] = None,
    loss: Annotated[
        Literal["l2", "huber", "l1"] | None,
        typer.Option(help="huber and l1 tolerate spikes.", show_default="l2"),
    ] = None,
    window: options.WindowOption = None,
    seed: options.SeedOption = None,
    device: options.DeviceOption = None,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter whose interval is found by fits of all others; may be given several times."
        ),
    ] = None,
    jobs: options.ProcessesOption = 1,
    resume: options.ResumeOption = False,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Identify one parameter set for each train record (or one over all): variation, cross-validation, reliability.

    Writes report.html, result.json, parameters.csv, model.yaml, pictures and TensorBoard events. Ctrl-C ends it with
    what it has, --resume goes on: sets that are complete are not fitted again.
    Prefer train for residual networks beside the physics, and for another ODE solver.
    """
    config = options.config_of(
        source, model, out, window, identification__pooled=pooled, identification__starts=starts,
        identification__loss=loss, identification__seed=seed, identification__device=device,
        statistics__profile=profile or None,
    )  # fmt: skip
    home = required(config.output.folder)
    with kept_fits(home, "identification", force=force, resume=resume, reads=config.reads) as kept:
        if config.hybrid is not None:
            remark("'train' uses the section 'hybrid' of this study; identify fits the physics alone")
        if jobs > 1 and config.identification.pooled:
            raise InputError(
                "--jobs shares records between processes, but --pooled needs all in one; leave one of them out"
            )
        dataset = checked_records(config)
        with config.at("identification.window"):
            check_window(config.identification.window, dataset.records)
        from hybrid_id.study.checks import check_names

        system, noisier = load_system(config, dataset), list["Dataset"]()
        if joint is not None:
            dataset, system, noisier = one_joint(dataset, system, joint, config.identification.seed)
        remark_start_values(dataset, system)
        remark_validation(len(dataset.validation), "identify")
        options.use_device(config.identification.device)
        check_names(config.statistics.profile, [system.table[k].name for k in system.estimated])
        study, progress = run(dataset, system, config, jobs=jobs, kept=kept, noisier=noisier)
        leave_earlier(home, progress)
        draw = progress.cut or not progress.stopped  # who ends complete sets waits for no pictures
        with results_folder(home, force=True) as folder:  # kept_fits has asked
            results = Results(folder, home, config, "identify")
            text, whole = write_study(results, dataset, study, draw=draw)
            words = left_out(config, progress, whole=whole)
            more = keep_after(home, folder, kept) if words else ""
    show_study(results, study, text, as_json=as_json)
    if words:
        remark(f"stopped: {words}{more}")
        raise typer.Exit(130)


def left_out(config: StudyConfig, progress: FitProgress, *, whole: bool) -> str:
    """What Ctrl-C has left out of the results, in words; empty where all of them are there.

    Args:
        config: what was asked for.
        progress: of the fits.
        whole: whether pictures and page are written.
    """
    lacks = [] if whole else [UNDRAWN]
    if progress.cut:
        lacks.insert(0, "the sets are those of the last iteration, and result.json says which")
    elif progress.stopped and config.statistics.profile:
        lacks.insert(0, "the profiles are cut off")
    if lacks and not progress.cut:
        lacks.insert(0, f"the sets are complete and in {RESULT}")
    return ", ".join(lacks)


def leave_earlier(home: Path, progress: FitProgress) -> None:
    """End a run whose fits Ctrl-C has cut off before it replaces complete results."""
    if progress.cut and (home / RESULT).exists():
        raise KeyboardInterrupt(f"stopped; the earlier results in {home} stay as they are")


def run(
    dataset: "Dataset",
    system: "System",
    config: StudyConfig,
    *,
    jobs: int = 1,
    kept: "Kept | None" = None,
    noisier: "Sequence[Dataset]" = (),
) -> "tuple[Study, FitProgress]":
    """Fit and assess as the config says; the progress knows whether the user has stopped that."""
    from dataclasses import replace

    from hybrid_id.config.settings import fit_settings
    from hybrid_id.study import identify, profiles

    wish, settings = config.identification, fit_settings(config)
    n_sets = (1 if wish.pooled else len(dataset.train)) * wish.starts
    with FitProgress(n_sets, wish.max_iterations) as progress:
        study = identify(
            dataset, system, jobs=jobs, kept=kept, noisier=noisier, progress=progress, **settings
        )
        if config.statistics.profile and not progress.stopped:

            def say(words: str) -> None:
                progress.say(words)
                if progress.stopped:  # each profile is cut off by it
                    raise KeyboardInterrupt

            found = profiles(
                dataset, study, config.statistics.profile, options=settings["options"],
                progress=say,
            )  # fmt: skip
            study = replace(study, profiles=found)
        return study, progress

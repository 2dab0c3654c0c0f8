"""`diagnose`: where records and the nominal model disagree, which effects explain how much of it, and what remains."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli.console import SearchProgress, remark, show
from hybrid_id.cli.folder import DIAGNOSIS, keep_after, kept_fits, required, results_folder
from hybrid_id.cli.inputs import (
    check_window,
    checked_records,
    load_system,
    refuse_arm,
    remark_start_values,
    remark_uneven,
)
from hybrid_id.cli.options import (
    ForceOption,
    JsonOption,
    ModelOption,
    OutOption,
    ResumeOption,
    SeedOption,
    SourceArgument,
    WindowOption,
    config_of,
    use_threads,
)
from hybrid_id.cli.results import UNDRAWN, files_in, write_last, write_report
from hybrid_id.config import Identification, StudyConfig

if TYPE_CHECKING:
    from hybrid_id.diagnosis.result import Diagnosis
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Kept
    from hybrid_id.systems.chain import System


NEXT = "next_experiment.csv"
"""Commands of the record that would distinguish tied effects."""
LONG, MOST_JOBS = 200_000, 4
"""Samples from which a fit may need a gigabyte, and processes that are started without being asked for."""


def diagnose(
    source: SourceArgument,
    model: ModelOption = None,
    out: OutOption = None,
    max_effects: Annotated[int | None, typer.Option(help="Effects at most.", min=1, show_default="3")] = None,
    most: Annotated[int | None, typer.Option(hidden=True, min=1)] = None,
    window: WindowOption = None,
    jobs: Annotated[
        int | None,
        typer.Option(help="Processes that share the fits.", min=1, show_default="one on each core"),
    ] = None,
    seed: SeedOption = None,
    resume: ResumeOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find out why records and the nominal model disagree: which effects explain how much of the gap, and what remains.

    Train records fit; records left out, or validation records, choose; the test records only measure. Writes
    report.html, diagnosis.json, model.yaml (with the effects), refit.yaml (the nominal model, re-fitted),
    next_experiment.csv (where effects are tied: what to command next), pictures and TensorBoard events. Ctrl-C ends the
    search with what it has found, --resume goes on.
    """
    config = config_of(
        source, model, out, window, gap__max_effects=most if max_effects is None else max_effects, gap__jobs=jobs,
        identification__seed=seed,
    )  # fmt: skip
    home = required(config.output.folder)
    with kept_fits(home, "diagnosis", force=force, resume=resume, reads=config.reads) as kept:
        said, plain = config.identification, Identification()
        if idle := [
            k
            for k in type(said).model_fields
            if k not in ("seed", "window") and getattr(said, k) != getattr(plain, k)
        ]:
            remark(
                f"diagnose fits least squares in its own way; of 'identification' it does without {', '.join(idle)}"
            )
        dataset = checked_records(config)
        with config.at("identification.window"):
            check_window(config.identification.window, dataset.records)
        remark_uneven(dataset)
        use_threads(1)
        system = load_system(config, dataset)
        refuse_arm(system, config.model)
        remark_start_values(dataset, system)
        diagnosis = run(dataset, system, config, kept)
        with results_folder(home, force=True) as folder:  # kept_fits has asked
            text, whole = write_diagnosis(folder, home, config, diagnosis)
            count = 0 if whole and not diagnosis.interrupted else kept.count
            if count:
                keep_after(home, folder)
    if as_json:
        show(text)
    else:
        from hybrid_id.reporting.diagnosis import diagnosis_table

        further = [NEXT] if (home / NEXT).exists() else []
        show(diagnosis_table(diagnosis, config.gap.max_effects))
        show(files_in(home, config, DIAGNOSIS, "model.yaml", "refit.yaml", *further))
    lacks = ["the results are those of the steps that were complete"] if diagnosis.interrupted else []
    lacks += [] if whole else [UNDRAWN]
    if lacks:
        there = "" if diagnosis.interrupted else f"the diagnosis is complete and in {DIAGNOSIS}, "
        more = f"; {count} fits are kept, and the same command with --resume goes on" if count else ""
        remark(f"stopped: {there}{', '.join(lacks)}{more}")
        raise typer.Exit(130)


def fitting_jobs(dataset: "Dataset") -> int:
    """Processes that this machine bears: each holds the records, and what its fit makes of them."""
    from joblib import cpu_count

    samples = sum(record.n_samples for record in dataset.records)
    return 1 if samples > LONG else min(cpu_count(), MOST_JOBS)


def run(dataset: "Dataset", system: "System", config: StudyConfig, kept: "Kept") -> "Diagnosis":
    """Diagnose as the config says, with a bar on stderr."""
    from hybrid_id.diagnosis.diagnose import diagnose as find
    from hybrid_id.study import Horizon

    with SearchProgress(config.gap.max_effects) as progress:
        return find(
            dataset,
            system,
            max_effects=config.gap.max_effects,
            horizon=Horizon.of(config.identification.window),
            jobs=config.gap.jobs or fitting_jobs(dataset),
            seed=config.identification.seed,
            level=config.statistics.level,
            signal_share=config.preprocessing.signal_share,
            kept=kept,
            progress=progress,
        )


def write_diagnosis(
    folder: Path, home: Path, config: StudyConfig, diagnosis: "Diagnosis"
) -> tuple[str, bool]:
    """Write all files of a diagnosis.

    Args:
        folder: where to write.
        home: where the folder will be at last.
        config: what was asked for.
        diagnosis: the result.

    Returns:
        The result as JSON, and whether all files are written: see `write_report`.
    """
    from hybrid_id.records.quality import remarks
    from hybrid_id.reporting.diagnosis import diagnosis_page
    from hybrid_id.reporting.diagnosis_figures import diagnosis_figures
    from hybrid_id.reporting.residuals import residual_result
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.tensorboard import write_diagnosis_events
    from hybrid_id.systems.model_file import save_model

    seed = {"seed": config.identification.seed}
    residuals = {"residual_tests": residual_result(diagnosis.details.residual_tests)}
    text = as_json("diagnose", seed | diagnosis.as_dict() | residuals)
    save_model(diagnosis.model, folder / "model.yaml", home)
    save_model(diagnosis.search.base.system, folder / "refit.yaml", home)
    if diagnosis.experiments and diagnosis.experiments[0].distinguishes:
        from pandas import DataFrame

        best = diagnosis.experiments[0]
        DataFrame({"t": best.time, **best.inputs}).to_csv(folder / NEXT, index=False, float_format="%.6g")
    whole = write_report(
        folder,
        home,
        config,
        "diagnose",
        figures=lambda: diagnosis_figures(diagnosis),
        page=lambda figures: diagnosis_page(
            diagnosis, figures, max_effects=config.gap.max_effects, findings=remarks(diagnosis.details.dataset),
        ),
        events=lambda place, images: write_diagnosis_events(place, diagnosis, images),
        settings=seed,
    )  # fmt: skip
    write_last(folder / DIAGNOSIS, text)
    return text, whole

"""`diagnose`: where records and the nominal model disagree, which effects explain how much of it, and what remains."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hybrid_id.cli.console import err, remark, show
from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.fits_folder import keep_after, kept_fits
from hybrid_id.cli.folder import DIAGNOSIS, EVENTS, page_and_pictures, required, results_folder
from hybrid_id.cli.inputs import checked_records, load_system, remark_uneven
from hybrid_id.cli.options import (
    ForceOption,
    JsonOption,
    ModelOption,
    OutOption,
    SeedOption,
    SourceArgument,
    WindowOption,
    as_window,
    use_threads,
)
from hybrid_id.cli.study import reach_of
from hybrid_id.config import Identification, StudyConfig, study_config

if TYPE_CHECKING:
    from hybrid_id.diagnosis.keep import Kept
    from hybrid_id.diagnosis.result import Diagnosis
    from hybrid_id.records.dataset import Dataset
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
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the unfinished diagnosis in the folder of results.")
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find out why records and the nominal model disagree: which effects explain how much of the gap, and what remains.

    Train records fit; records left out, or validation records, choose; the test records only measure. Writes
    report.html, diagnosis.json, model.yaml (with the effects), refit.yaml (the nominal model, re-fitted),
    next_experiment.csv (where effects are tied: what to command next), pictures and TensorBoard events. Ctrl-C ends the
    search with what it has found, --resume goes on.
    """
    config = study_config(
        source,
        {
            "model": None if model is None else str(model),
            "output.folder": None if out is None else str(out),
            "gap.max_effects": most if max_effects is None else max_effects,
            "identification.window": None if window is None else as_window(window),
            "gap.jobs": jobs,
            "identification.seed": seed,
        },
    )
    home = required(config.output.folder)
    with kept_fits(home, force=force, resume=resume, reads=config.reads) as kept:
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
        remark_uneven(dataset)
        use_threads(1)
        system = load_system(config, dataset)
        diagnosis = run(dataset, system, config, kept)
        with results_folder(home, force=True) as folder:  # kept_fits has asked
            text = write_diagnosis(folder, home, config, diagnosis)
            if diagnosis.interrupted:
                keep_after(home, folder)
    if as_json:
        stdout().print(text, markup=False, soft_wrap=True)
    else:
        from hybrid_id.reporting.diagnosis import diagnosis_table

        further = f"{NEXT}, " if (home / NEXT).exists() else ""
        show(diagnosis_table(diagnosis, reach_of(config), config.statistics.level, config.gap.max_effects))
        page, pictures = page_and_pictures(config)
        show(
            f"results are in {home}: {page}{DIAGNOSIS}, model.yaml, refit.yaml, {further}{pictures}config.yaml"
        )
    if diagnosis.interrupted:
        remark(
            "stopped: the results are those of the steps that were complete; the same command with --resume goes on"
        )
        raise typer.Exit(130)


def fitting_jobs(dataset: "Dataset") -> int:
    """Processes that this machine bears: each holds the records, and what its fit makes of them."""
    from joblib import cpu_count

    samples = sum(record.n_samples for record in dataset.records)
    return 1 if samples > LONG else min(cpu_count(), MOST_JOBS)


def run(dataset: "Dataset", system: "System", config: StudyConfig, kept: "Kept") -> "Diagnosis":
    """Diagnose as the config says, with a bar on stderr."""
    from hybrid_id.diagnosis.diagnose import diagnose as find
    from hybrid_id.identification.horizons import Horizon

    with SearchProgress() as progress, terminated_as_interrupted():
        return find(
            dataset,
            system,
            max_effects=config.gap.max_effects,
            horizon=Horizon.of(config.identification.window),
            jobs=config.gap.jobs or fitting_jobs(dataset),
            seed=config.identification.seed,
            signal_share=config.preprocessing.signal_share,
            kept=kept,
            progress=progress,
        )


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM end a search as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class SearchProgress:
    """Bar on stderr while the catalogue is searched; an instance is what `diagnose` takes as `progress`."""

    def __init__(self) -> None:
        console = err()
        columns = (
            TextColumn("{task.description}"),
            BarColumn(24),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self._task: TaskID = self._bar.add_task("nominal model", total=None)
        self._stage = ""

    def __enter__(self) -> "SearchProgress":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how many fits of a stage are done."""
        if stage != self._stage:
            self._stage = stage
            self._bar.reset(self._task, total=total)
        words = f"{stage}, fit {done} of at most {total}" if total > 1 else stage
        self._bar.update(self._task, description=words, completed=done)


def write_diagnosis(folder: Path, home: Path, config: StudyConfig, diagnosis: "Diagnosis") -> str:
    """Write all files of a diagnosis.

    Args:
        folder: Where to write.
        home: Where the folder will be at last.
        config: What was asked for.
        diagnosis: The result.

    Returns:
        The result as JSON.
    """
    from hybrid_id.reporting.residual_words import residual_result
    from hybrid_id.reporting.results import as_json
    from hybrid_id.systems.model_file import save_model

    seed = {"seed": config.identification.seed}
    residuals = {"residual_tests": residual_result(diagnosis.details.residual_tests)}
    text = as_json("diagnose", seed | diagnosis.as_dict() | residuals)
    save_model(diagnosis.model, folder / "model.yaml")
    save_model(diagnosis.search.base.system, folder / "refit.yaml")
    if diagnosis.experiments and diagnosis.experiments[0].tells:
        from pandas import DataFrame

        best = diagnosis.experiments[0]
        DataFrame({"t": best.time, **best.inputs}).to_csv(folder / NEXT, index=False, float_format="%.6g")
    config.save(folder / "config.yaml", home=home)
    wish = config.output
    if wish.figures or wish.tensorboard or wish.report:
        from hybrid_id.reporting.diagnosis_figures import diagnosis_figures

        figures = diagnosis_figures(diagnosis)
        images = {name: figure.image for name, figure in figures.items()}
        if wish.figures:
            from hybrid_id.reporting.style import save

            for name, image in images.items():
                save(image, folder / f"{name}.png")
        if wish.tensorboard:
            from hybrid_id.reporting.events import write_diagnosis_events

            write_diagnosis_events(folder / EVENTS, diagnosis, images)
        if wish.report:
            from hybrid_id.records.quality import remarks
            from hybrid_id.reporting.html.diagnosis_page import diagnosis_page
            from hybrid_id.reporting.html.made import how_made

            page = diagnosis_page(
                diagnosis,
                figures,
                reach=reach_of(config),
                level=config.statistics.level,
                max_effects=config.gap.max_effects,
                findings=remarks(diagnosis.details.dataset),
            )
            study = (folder / "config.yaml").read_text(encoding="utf-8")
            how_made(page, "diagnose", study, seed).write(folder / "report.html")
    (folder / DIAGNOSIS).write_text(text + "\n", encoding="utf-8")
    return text

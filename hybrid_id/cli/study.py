"""What `identify`, `train` and `demo` share: from a study to its files and its summary."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import remark, show
from hybrid_id.cli.folder import EVENTS, RESULT, page_and_pictures
from hybrid_id.config import StudyConfig

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.reporting.html.interactive import Drawn
    from hybrid_id.study import Replay, Study

MAX_TITLE = 50  # characters that leave room for the legend


def reach_of(config: StudyConfig) -> float:
    """Half-width of an interval in standard errors."""
    from scipy.special import ndtri

    return float(ndtri(0.5 + config.statistics.level / 2))


def write_study(
    folder: Path, home: Path, command: str, config: StudyConfig, dataset: "Dataset", study: "Study"
) -> str:
    """Write all files of a study.

    Args:
        folder: Where to write.
        home: Where the folder will be at last.
        command: Name of the command.
        config: What was asked for.
        dataset: The records.
        study: The result.

    Returns:
        The result as JSON.
    """
    from hybrid_id.reporting.residual_words import residual_result
    from hybrid_id.reporting.results import as_json, study_result, write_models, write_parameters
    from hybrid_id.study.residual_tests import study_residuals

    reach, level = reach_of(config), config.statistics.level
    residuals = study_residuals(dataset, study, signal_share=config.preprocessing.signal_share)
    told = study_result(study, reach=reach, level=level) | {"residual_tests": residual_result(residuals)}
    text = as_json(command, {"dataset": dataset.name} | told)
    write_models(folder, study)
    write_parameters(folder / "parameters.csv", study, reach)
    config.save(folder / "config.yaml", home=home)
    wish = config.output
    if wish.figures or wish.tensorboard or wish.report:
        from hybrid_id.study import replay

        runs = replay(dataset, study.selected.system, engine=study.selected.engine, horizon=study.horizon)
        figures = study_figures(dataset, study, reach, runs)
        images = {name: figure.image for name, figure in figures.items()}
        if wish.figures:
            from hybrid_id.reporting.style import save

            for name, image in images.items():
                save(image, folder / f"{name}.png")
        if wish.tensorboard:
            from hybrid_id.reporting.events import write_study_events

            write_study_events(folder / EVENTS, study, images, curves=command != "train")
        if wish.report:
            from hybrid_id.records.quality import remarks
            from hybrid_id.reporting.html.made import how_made
            from hybrid_id.reporting.html.study_page import study_page

            page = study_page(
                dataset,
                study,
                figures,
                reach=reach,
                level=level,
                findings=remarks(dataset),
                residuals=residuals,
            )
            words = (folder / "config.yaml").read_text(encoding="utf-8")
            how_made(page, command, words, {"seed": config.identification.seed}).write(folder / "report.html")
    (folder / RESULT).write_text(text + "\n", encoding="utf-8")
    return text


def study_figures(
    dataset: "Dataset", study: "Study", reach: float, runs: "Sequence[Replay]"
) -> "dict[str, Drawn]":
    """Every picture of a study by the name of its file, with its interactive twin; ``runs`` replay all records."""
    from hybrid_id.reporting.html.interactive import Drawn, twin
    from hybrid_id.reporting.html.live import cross_validation_plot, parameter_plot, record_plot
    from hybrid_id.reporting.plots import cross_validation_figure, parameter_figure, residual_figure
    from hybrid_id.reporting.record_plots import fit_figure
    from hybrid_id.reporting.style import pixels
    from hybrid_id.statistics.residuals import whiteness
    from hybrid_id.study import Comparison

    chosen = study.selected
    figures = {"parameters": parameter_figure(study, reach)}
    if min(study.cross_validation.fits.shape[:2]) > 1:
        figures["cross_validation"] = cross_validation_figure(study)
    figures["residuals"] = residual_figure(
        study, whiteness(chosen.residual), dataset[chosen.records[0]].sample_time
    )
    if study.profiles:
        from hybrid_id.reporting.profile_plot import profile_figure

        figures["profiles"] = profile_figure(study, reach)
    for run in runs:
        title = f"{run.record.name} ({run.record.role})"
        with_set = f"{title}, parameter set {study.selection.name}"
        figures[f"fit_{run.record.name}"] = fit_figure(
            dataset, run, with_set if len(with_set) < MAX_TITLE else title
        )
    both = Comparison({"simulated": tuple(runs)})
    plots = {"parameters": parameter_plot(study, reach), "cross_validation": cross_validation_plot(study)}
    plots |= {f"fit_{run.record.name}": record_plot(dataset, both, run.record.name) for run in runs}
    return {name: Drawn(pixels(figure), plots.get(name) or twin(figure)) for name, figure in figures.items()}


def show_study(study: "Study", config: StudyConfig, home: Path, text: str, *, as_json: bool) -> None:
    """Print the study, as a table or as JSON, and where its files are; say so where it explains nothing."""
    from hybrid_id.study import check_fit, check_priors

    for words in (check_fit(study), *check_priors(study)):
        if words:
            remark(f"warning: {words}")
    if as_json:
        stdout().print(text, markup=False, soft_wrap=True)
        return
    from hybrid_id.reporting.parameter_tables import study_table

    show(study_table(study, reach_of(config), config.statistics.level))
    page, pictures = page_and_pictures(config)
    show(f"results are in {home}: {page}parameters.csv, result.json, model.yaml, {pictures}config.yaml")

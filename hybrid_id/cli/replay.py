"""`simulate` and `compare`: records replayed through models."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import counting, remark, show
from hybrid_id.cli.folder import RESULT, refuse_taken, results_folder
from hybrid_id.cli.inputs import check_window, read_model, records_to_replay
from hybrid_id.cli.results import write_last
from hybrid_id.config import beside
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Comparison
    from hybrid_id.systems.chain import System

Folder = Annotated[Path, typer.Option("--out", "-o", help=f"Folder for the results. {options.ABOVE}")]


def simulate(
    dataset: options.DatasetArgument,
    out: Folder,
    model: options.ModelOption = None,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Replay records through a model: report.html, one CSV a record with measured and simulated outputs, pictures."""
    models = [model or beside(dataset)]
    _replay("simulate", dataset, models, out, window="whole", force=force, as_json=as_json)


def compare(
    dataset: options.DatasetArgument,
    out: Folder,
    model: Annotated[list[Path], typer.Option("--model", "-m", help="Model file; give one for each model.")],
    window: options.WindowOption = None,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Put models side by side on the same records: report.html, comparison.csv (fit, normalised RMSE), pictures."""
    window = window or "auto"
    _replay("compare", dataset, model, out, window=window, force=force, as_json=as_json)


def _replay(
    command: str, path: Path, models: list[Path], out: Path, *, window: str, force: bool, as_json: bool
) -> None:
    refuse_taken(out, force=force, reads=[path, *models])
    twice = next((model for k, model in enumerate(models) if model in models[:k]), None)
    if twice is not None:
        raise InputError(f"model {twice} is given twice; give every model once")
    dataset = records_to_replay(path)
    if command == "simulate" and any(record.name == "comparison" for record in dataset.records):
        raise InputError(
            f"{path}: record 'comparison' is named as the table that simulate writes; give it another name"
        )
    from hybrid_id.records.quality import remarks
    from hybrid_id.reporting.page import how_made
    from hybrid_id.reporting.replays import replay_figures, replay_page
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.results import comparison_result, horizon_result, write_comparison, write_replay
    from hybrid_id.reporting.style import save

    check_window(window, dataset.records)
    labels = _labels(models)
    comparison = _side_by_side(dataset, {labels[model]: read_model(model) for model in models}, window)
    files = {label: str(model) for model, label in labels.items()}
    result = to_json(
        command,
        {
            "dataset": dataset.name,
            "files": files,
            "horizon": horizon_result(comparison.horizon),
            "models": comparison_result(comparison),
        },
    )
    with results_folder(out, force=force) as folder:
        write_comparison(folder / "comparison.csv", comparison)
        if command == "simulate":
            for replay in next(iter(comparison.replays.values())):
                write_replay(folder / f"{replay.record.name}.csv", replay)
        figures = replay_figures(dataset, comparison)
        for name, figure in figures.items():
            save(figure, folder / f"{name}.png")
        page = replay_page(dataset, comparison, figures, findings=remarks(dataset))
        settings = {"dataset": path, "models": ", ".join(files.values())}
        how_made(page, command, settings=settings).write(folder / "report.html")
        write_last(folder / RESULT, result)
    if as_json:
        return show(result)
    from hybrid_id.reporting.tables import comparison_table

    if comparison.horizon.kind != "whole":
        show(f"horizon: {comparison.horizon}")
    show(
        comparison_table(comparison), f"results are in {out}: report.html, comparison.csv, pictures, {RESULT}"
    )


def _side_by_side(dataset: "Dataset", models: "Mapping[str, System]", window: str) -> "Comparison":
    """Compare the models; where fits choose the horizon, say so before them, show their number, and say the choice."""
    from hybrid_id.study import Horizon
    from hybrid_id.study import compare as side_by_side

    with counting("fits that choose the horizon") as bar:

        def say(done: int, total: int) -> None:
            if not bar.task_ids:
                bar.console.print(
                    f"free runs over whole records lose them, so up to {total} fits of the model that errs least "
                    "choose a horizon for all; '--window' with seconds, whole or strokes gives one without fits",
                    style="dim", markup=False, soft_wrap=True,
                )  # fmt: skip
                bar.add_task("", total=total)
            bar.update(bar.task_ids[0], completed=done)

        comparison = side_by_side(dataset, models, horizon=Horizon.of(window), say=say)
    if bar.task_ids:
        remark(
            f"chosen: {comparison.horizon}; '--window {comparison.horizon.wish}' gives it without these fits"
        )
    return comparison


def _labels(models: list[Path]) -> dict[Path, str]:
    """The end of each path that no other one has: `model.yaml`, or `old/model.yaml` and `new/model.yaml`."""
    for depth in range(1, 1 + max(len(model.parts) for model in models)):
        labels = {model: "/".join(model.parts[-depth:]) for model in models}
        if len(set(labels.values())) == len(models):
            return labels
    return {model: str(model) for model in models}

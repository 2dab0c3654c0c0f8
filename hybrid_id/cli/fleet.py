"""`fleet`: robots of one kind, their mean and spread, and which one stands out."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import counting, kept_pieces, remark, show
from hybrid_id.cli.folder import added_results, refuse_foreign, required, sole_writer
from hybrid_id.cli.inputs import check_window, load_records, read_model, refuse_errors, remark_validation
from hybrid_id.cli.results import write_last
from hybrid_id.errors import CONTROL, InputError, has_control, shown
from hybrid_id.reading import LONGEST_NAME, read_object, refuse_outside
from hybrid_id.records.files import make_folder, natural_order
from hybrid_id.reporting.provenance import program

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset

ROBOTS, RESULT, DATASET = "robots", "fleet.json", "dataset.yaml"
MOST = 10_000
"""Robots of a fleet."""


def fleet(
    robots: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder with one dataset folder a robot."),
    ],
    model: Annotated[
        Path | None,
        typer.Option("--model", "-m", help="Model file of all; FOLDER/model.yaml by default."),
    ] = None,
    out: options.OutOption = None,
    window: options.WindowOption = None,
    jobs: options.ProcessesOption = 1,
    backend: options.BackendOption = options.Backend.joblib,
    scheduler: options.SchedulerOption = None,
    as_json: options.JsonOption = False,
) -> None:
    """Identify many robots of one kind: the fleet's mean and spread, and which robot stands out and why.

    Writes report.html, fleet.json, robots.csv (each robot by its own records, and with what the fleet knows), a
    picture, and model.yaml: the fleet's mean, with what is expected of one more robot as priors. Each robot is kept as
    soon as it is done: after Ctrl-C the same command goes on.
    """
    options.check_backend(backend, scheduler)
    home = required(out)
    refuse_foreign(home, ROBOTS, "*.json")
    if not robots.is_dir():
        raise InputError(f"{robots} is no folder; give the one that holds a dataset folder for each robot")
    model = model or robots / "model.yaml"
    if not model.exists():
        raise InputError(f"{model} does not exist; name the model of all robots with --model")
    from hybrid_id.study import Horizon

    wish = "auto" if window is None else window
    horizon = Horizon.of(wish)
    system = read_model(model)  # before minutes of reading
    datasets = read_fleet(robots)
    if (home / RESULT).exists():
        earlier = set(read_object(home / RESULT, "fleet").get("robots", ()))
        if earlier.isdisjoint(robot.name for robot in datasets):
            raise InputError(f"{home} holds a fleet of other robots; give another folder")
    check_window(wish, datasets[0].train)
    remark_validation(sum(len(robot.validation) for robot in datasets), "fleet")
    from hybrid_id.reporting.fleet import fleet_page, fleet_result, robots_figure, write_robots
    from hybrid_id.reporting.page import how_made
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.reporting.style import pixels, save
    from hybrid_id.study.fleet import identify_fleet
    from hybrid_id.systems.model_file import save_model

    kept = make_folder(home / ROBOTS)
    with sole_writer(home):
        with kept_pieces(ROBOTS, len(datasets), kept) as done:
            study = identify_fleet(
                system, datasets, kept, horizon=horizon, jobs=jobs, scheduler=scheduler, program=program(), done=done
            )  # fmt: skip
        text = to_json("fleet", fleet_result(study))
        with added_results(home, RESULT, ["robots.png", "report.html", "robots.csv", "model.yaml"]) as folder:
            picture = pixels(robots_figure(study))
            save(picture, folder / "robots.png")
            page = how_made(fleet_page(study, picture), "fleet", settings={"robots": robots, "model": model})
            page.write(folder / "report.html")
            write_robots(folder / "robots.csv", study)
            save_model(study.fleet_model(), folder / "model.yaml")
            write_last(folder / RESULT, text)
    if as_json:
        show(text)
    else:
        show(page.screen())
        show(f"results are in {home}: report.html, {RESULT}, robots.csv, model.yaml, robots.png, {ROBOTS}")
    if study.failed:
        raise typer.Exit(1)


def read_fleet(folder: Path) -> "list[Dataset]":
    """The dataset of each robot, by the name of its folder, in natural order.

    Raises:
        InputError: fewer than three robots, other channels than the first's, no train record, or a fault of a dataset.
    """
    from hybrid_id.records.quality import check_dataset
    from hybrid_id.study.fleet import FEWEST

    places = sorted(
        (file.parent for file in folder.glob(f"*/{DATASET}")), key=lambda p: natural_order(p.name)
    )
    if not FEWEST <= len(places) <= MOST:
        raise InputError(
            f"{folder} holds {len(places)} dataset folders (with a {DATASET} each); a fleet has {FEWEST} to {MOST}"
        )
    datasets, warned = list["Dataset"](), 0
    channels: list[list[str]] = []
    with counting("robots read") as bar:
        task = bar.add_task("robots read", total=len(places))
        for place in places:
            # its results get the name of its folder
            if has_control(place.name):
                raise InputError(f"the folder {shown(str(place))} {CONTROL}; rename it")
            if len(os.fsencode(place.name)) > LONGEST_NAME:
                raise InputError(
                    f"the folder {place} has a name of more than {LONGEST_NAME} signs; shorten it"
                )
            refuse_outside(place, folder, str(place), "put the folder itself there")
            dataset = replace(load_records(place), name=place.name)
            if not dataset.train:
                raise InputError(f"{place / DATASET} has no train record; give at least one the role 'train'")
            logged = [[channel.name for channel in side] for side in (dataset.inputs, dataset.outputs)]
            if logged != (channels := channels or logged):
                raise InputError(
                    f"{place / DATASET} has other channels than {places[0] / DATASET}; log all robots alike"
                )
            findings = check_dataset(dataset)
            refuse_errors(findings)
            warned += any(finding.severity == "warning" for finding in findings)
            datasets.append(dataset)
            bar.advance(task)
    if warned:
        remark(
            f"warning: the records of {warned} of {len(datasets)} robots have faults; 'hybrid-id check' names them"
        )
    return datasets

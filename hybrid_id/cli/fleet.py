"""`fleet`: robots of one kind, their mean and spread, and which one stands out."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli.console import counting, remark, show
from hybrid_id.cli.folder import added_results, refuse_foreign, required, sole_writer
from hybrid_id.cli.inputs import check_window, load_records, read_model, refuse_errors, remark_validation
from hybrid_id.cli.options import (
    Backend,
    BackendOption,
    JsonOption,
    OutOption,
    ProcessesOption,
    SchedulerOption,
    WindowOption,
    check_backend,
    use_threads,
)
from hybrid_id.cli.results import write_last
from hybrid_id.errors import CONTROL, InputError, has_control, shown
from hybrid_id.reading import LONGEST_NAME, read_object, refuse_outside
from hybrid_id.records.files import make_folder, natural_order
from hybrid_id.reporting.provenance import program

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study.fleet import FleetStudy, FleetTask, RobotFit

ROBOTS, RESULT, DATASET = "robots", "fleet.json", "dataset.yaml"
MOST = 10_000
"""Robots of a fleet."""


def fleet(
    robots: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Folder with one dataset folder a robot.", show_default=False),
    ],
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", "-m", help="Model file of all; FOLDER/model.yaml by default.", show_default=False
        ),
    ] = None,
    out: OutOption = None,
    window: WindowOption = None,
    jobs: ProcessesOption = 1,
    backend: BackendOption = Backend.joblib,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Identify many robots of one kind: the fleet's mean and spread, and which robot stands out and why.

    Writes report.html, fleet.json, robots.csv (each robot by its own records, and with what the fleet knows), a
    picture, and model.yaml: the fleet's mean, with what is expected of one more robot as priors. Each robot is kept as
    soon as it is done: after Ctrl-C the same command goes on.
    """
    check_backend(backend, scheduler)
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
        if earlier.isdisjoint(one.name for one in datasets):
            raise InputError(f"{home} holds a fleet of other robots; give another folder")
    check_window(wish, datasets[0].train)
    remark_validation(sum(len(one.validation) for one in datasets), "fleet")
    use_threads(1)
    make_folder(home / ROBOTS)
    with sole_writer(home):
        from hybrid_id.study.fleet import FleetTask, gather

        fits = _run(FleetTask(system, horizon), datasets, home, jobs, scheduler)
        study = gather(system, fits)
        text = _write(home, robots, model, study)
    if as_json:
        show(text)
    else:
        from hybrid_id.reporting.fleet import fleet_tables

        show(fleet_tables(study))
        show(f"results are in {home}: report.html, {RESULT}, robots.csv, model.yaml, robots.png, {ROBOTS}")
    if study.failed:
        remark(
            f"{len(study.failed)} of {len(fits)} robots have no estimate; the same command tries them again"
        )
        raise typer.Exit(1)


def read_fleet(folder: Path) -> "list[Dataset]":
    """The dataset of each robot, by the name of its folder, in natural order.

    Raises:
        InputError: fewer than three robots, other channels than the first's, no train record, or a fault of a dataset.
    """
    from hybrid_id.records.quality import check_dataset
    from hybrid_id.study.fleet import FEWEST

    places = sorted(
        (file.parent for file in folder.glob(f"*/{DATASET}")), key=lambda one: natural_order(one.name)
    )
    if not FEWEST <= len(places) <= MOST:
        raise InputError(
            f"{folder} holds {len(places)} dataset folders (with a {DATASET} each); a fleet has {FEWEST} to {MOST}"
        )
    found, warned = list["Dataset"](), 0
    with counting("robots read") as bar:
        task = bar.add_task("robots read", total=len(places))
        for place in places:
            _refuse_name(place)
            refuse_outside(place, folder, str(place), "put the folder itself there")
            dataset = replace(load_records(place), name=place.name)
            if not dataset.train:
                raise InputError(f"{place / DATASET} has no train record; give at least one the role 'train'")
            if found and _channels(dataset) != _channels(found[0]):
                raise InputError(
                    f"{place / DATASET} has other channels than {places[0] / DATASET}; log all robots alike"
                )
            findings = check_dataset(dataset)
            refuse_errors(findings)
            warned += any(finding.severity == "warning" for finding in findings)
            found.append(dataset)
            bar.advance(task)
    if warned:
        remark(
            f"warning: the records of {warned} of {len(found)} robots have faults; 'hybrid-id check' names them"
        )
    return found


def _refuse_name(place: Path) -> None:
    """Raise InputError where a robot's results could not have the name of its folder."""
    if has_control(place.name):
        raise InputError(f"the folder {shown(str(place))} {CONTROL}; rename it")
    if len(os.fsencode(place.name)) > LONGEST_NAME:
        raise InputError(f"the folder {place} has a name of more than {LONGEST_NAME} signs; shorten it")


def _channels(dataset: "Dataset") -> tuple[list[str], list[str]]:
    return [one.name for one in dataset.inputs], [one.name for one in dataset.outputs]


def _run(
    task: "FleetTask", datasets: "Sequence[Dataset]", home: Path, jobs: int, scheduler: str | None
) -> "list[RobotFit]":
    """Fit the robots that no earlier run has kept, keep each as it is done, and return all in their order.

    The first robot's records choose the horizon of all, so that their errors of fit can be compared.
    """
    from hybrid_id.study import Horizon
    from hybrid_id.study.fleet import fit_robots, key_of, load_robot, save_robot

    folder, found = home / ROBOTS, dict[str, "RobotFit"]()
    try:
        with counting("robots") as bar:
            bar_id = bar.add_task("robots", total=len(datasets))

            def fit(those: "Sequence[Dataset]", jobs: int, scheduler: str | None) -> None:
                keys = {one.name: key_of(task, one, program()) for one in those}
                kept = {name: one for name, key in keys.items() if (one := load_robot(folder, name, key))}
                found.update(kept)
                bar.advance(bar_id, len(kept))
                left = [one for one in those if one.name not in kept]
                for robot in fit_robots(task, left, jobs=jobs, scheduler=scheduler):
                    found[robot.name] = robot
                    if not robot.message:
                        save_robot(folder, robot, keys[robot.name])
                    bar.advance(bar_id)
                    how = robot.message or f"{len(robot.records)} records, {robot.seconds:.1f} s"
                    line = f"{len(found)} of {len(datasets)}: {robot.name}, {how}"
                    bar.console.print(line, markup=False, soft_wrap=True, style="dim")

            rest = list(datasets)
            while task.horizon is None and rest:
                fit(rest[:1], 1, scheduler)
                first = found[rest.pop(0).name]
                if not first.message:
                    task = replace(task, horizon=Horizon(*first.horizon))
            fit(rest, jobs, scheduler)
    except KeyboardInterrupt:
        done = sum(not one.message for one in found.values())
        raise KeyboardInterrupt(
            f"stopped; {done} of {len(datasets)} robots are kept in {folder}, and the same command goes on"
        ) from None
    return [found[one.name] for one in datasets]


def _write(home: Path, robots: Path, model: Path, study: "FleetStudy") -> str:
    """Page, picture, table, model and `fleet.json` into the folder, complete or not at all; returns the last."""
    from hybrid_id.reporting.fleet import fleet_page, fleet_pictures, fleet_result, write_robots
    from hybrid_id.reporting.page import how_made
    from hybrid_id.reporting.results import as_json
    from hybrid_id.reporting.style import save
    from hybrid_id.systems.model_file import save_model

    text = as_json("fleet", fleet_result(study))
    with added_results(home, RESULT, ["robots.png", "report.html", "robots.csv", "model.yaml"]) as folder:
        pictures = fleet_pictures(study)
        for name, figure in pictures.items():
            save(figure, folder / f"{name}.png")
        page = fleet_page(study, pictures)
        how_made(page, "fleet", settings={"robots": robots, "model": model}).write(folder / "report.html")
        write_robots(folder / "robots.csv", study)
        save_model(study.fleet_model(), folder / "model.yaml")
        write_last(folder / RESULT, text)
    return text

"""`check`: what the records are worth before anything is fitted to them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import doing, show, show_json
from hybrid_id.cli.inputs import load_records, read_model, refuse_errors
from hybrid_id.config import beside
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.systems.chain import System


def check(
    dataset: options.DatasetArgument,
    model: options.ModelOption = None,
    joint: options.JointOption = None,
    full: Annotated[bool, typer.Option("--full", help="Show remarks of severity info too.")] = False,
    as_json: options.JsonOption = False,
) -> None:
    """Check records: quality, sampling, excitation, and with a model which of its parameters they identify.

    With --joint, one joint of a robot is checked by itself, as diagnose takes it: its own channels, in the records in
    which it moves.

    Ends with exit code 0 when there are warnings only, and 2 when a fit would be meaningless.
    """
    from hybrid_id.records.quality import check_dataset, worst_first

    data = load_records(dataset)
    path = model or (beside(dataset) if beside(dataset).exists() else None)
    system = None
    if joint is not None:
        data, system = joint_alone(data, path, dataset, joint)
    from hybrid_id.reporting.tables import count, findings_list, records_table

    if not as_json:
        show(records_table(data), "")
    findings = check_dataset(data)
    if not as_json:
        shown = [one for one in findings if full or one.severity != "info" or one.code == "resampled"]
        show(findings_list(shown))
        if hidden := len(findings) - len(shown):
            more, them = count(hidden, "more remark"), "it" if hidden == 1 else "them"
            show(f"({more}, for information only: --full shows {them})")
    found = None
    if path is not None and not any(finding.severity == "error" for finding in findings):
        from hybrid_id.study import check_model

        system = system or read_model(path)
        with doing() as say:
            found = check_model(data, system, say)
    if as_json:
        from hybrid_id.reporting.results import check_result

        more = () if found is None else found.findings
        show_json("check", check_result(data, worst_first([*more, *findings]), found))
    elif path is None:
        show(
            f"no {beside(dataset)}: with a model (docs/formats.md), check says which of its parameters these "
            "records identify"
        )
    elif found is not None and system is not None:
        from hybrid_id.reporting.tables import MOST_ROWS, base_parameters_table, identifiability_table
        from hybrid_id.reporting.units import symbols_line

        if found.findings:
            show("", f"Against {path}:", findings_list(found.findings))
        if found.identified is None:
            show("", "What the records identify is not said: records and model contradict each other.")
        else:
            show("", f"What these records identify of {path}, at its start values and before any fit.")
            show("± is by the sensors' noise alone: what the model lacks makes intervals of a fit wider.")
            show(identifiability_table(found.identified))
            show(*symbols_line(system.table, " ".join(found.identified.names)))
        if found.based is not None:
            show("", "What any motion can say of the robot's masses and inertias, and what these records do:")
            show(base_parameters_table(found.based, 0 if full else MOST_ROWS))
    refuse_errors([*findings, *(() if found is None else found.findings)])
    identified = None if found is None else found.identified
    if identified is not None and not identified.combinations and not identified.claimable.any():
        raise InputError(f"the records identify nothing of {path}; make new ones in which the drive moves")


def joint_alone(dataset: "Dataset", path: Path | None, source: Path, name: str) -> "tuple[Dataset, System]":
    """Records and model of one joint of a robot by itself, the others moving as they were measured."""
    if path is None:
        raise InputError(
            f"--joint needs the robot's model, and there is no {beside(source)}; name one with --model"
        )
    from hybrid_id.systems.by_joint import (
        alone,
        check_angles,
        joint_number,
        moves,
        moving_records,
        with_others_measured,
    )

    robot = read_model(path)
    if robot.tree is None:
        raise InputError(f"{path}: --joint takes a joint of a robot, whose description the model names")
    joint = joint_number(robot, name)
    check_angles(dataset, robot)
    if dataset.train and not any(moves(record, joint) for record in dataset.train):
        raise InputError(
            f"Joint '{name}' stands still in all train records of {source}; record motions of it, or check the others"
        )
    moving = moving_records(dataset, joint)
    return with_others_measured(moving, robot, joint), alone(robot, joint)

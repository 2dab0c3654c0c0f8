"""`diagnose`: where records and the nominal model disagree, which effects explain how much of it, and what remains."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli import options
from hybrid_id.cli.console import SearchProgress, remark
from hybrid_id.cli.folder import DIAGNOSIS, EVENTS, FITS, keep_after, kept_fits, required, results_folder
from hybrid_id.cli.inputs import (
    MOST_JOINTS,
    check_window,
    checked_records,
    load_system,
    remark_idle,
    remark_start_values,
    remark_uneven,
)
from hybrid_id.cli.results import UNDRAWN, Results, write_last
from hybrid_id.config import StudyConfig, sections
from hybrid_id.errors import InputError, listed

if TYPE_CHECKING:
    from hybrid_id.diagnosis.arm import ArmDiagnosis
    from hybrid_id.diagnosis.result import Diagnosis
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Kept
    from hybrid_id.systems.chain import System


NEXT = "next_experiment.csv"
"""Commands of the record that would distinguish tied effects."""
OTHERS = (
    EVENTS, FITS, "models", "model.yaml", "refit.yaml", "config.yaml", "report.html", "joints.png", DIAGNOSIS,
)  # fmt: skip
"""What else lies in the folder of a robot's results, so that no joint's folder may be called like it."""
MOST_LETTERS = 60
"""Of the name of a joint's folder."""
LONG, MOST_JOBS = 200_000, 4
"""Samples from which a fit may need a gigabyte, and processes that are started without being asked for."""


def diagnose(
    source: options.SourceArgument,
    model: options.ModelOption = None,
    out: options.OutOption = None,
    max_effects: Annotated[
        int | None, typer.Option(help="Effects at most.", min=1, max=sections.MOST_EFFECTS, show_default="3")
    ] = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(
            help="Joint of a robot to diagnose by itself, the others moving as they were measured; may be given "
            "several times, and brings the others of its coupled gear. Of a robot of more than two joints all that "
            "move are."
        ),
    ] = None,
    window: options.WindowOption = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Processes that share the fits.",
            min=1,
            max=sections.MOST_JOBS,
            show_default="one on each core, four at most; one for long records",
        ),
    ] = None,
    seed: options.SeedOption = None,
    resume: options.ResumeOption = False,
    force: options.ForceOption = False,
    as_json: options.JsonOption = False,
) -> None:
    """Find out why records and the nominal model disagree: which effects explain how much of the gap, and what remains.

    Train records fit; records left out, or validation records, choose; the test records only measure. Writes
    report.html, diagnosis.json, model.yaml (with the effects), refit.yaml (the nominal model, re-fitted),
    next_experiment.csv (where effects are tied: what to command next), pictures and TensorBoard events; of a robot of
    more than two joints, or with a coupled gear, a page and models for each joint in a folder of its name, and those of
    the whole robot above.
    Ctrl-C ends the search with what it has found, --resume goes on.
    """
    config = options.config_of(
        source, model, out, window, gap__max_effects=max_effects, gap__jobs=jobs, identification__seed=seed,
    )  # fmt: skip
    home = required(config.output.folder)
    with kept_fits(home, "diagnosis", force=force, resume=resume, reads=config.reads) as kept:
        remark_idle(config.identification, "diagnose fits least squares in its own way")
        dataset = checked_records(config)
        with config.at("identification.window"):
            check_window(config.identification.window, dataset.records)
        remark_uneven(dataset)
        system = load_system(config, dataset)
        by_joint = takes_by_joint(system, config.model, joint)
        from hybrid_id.diagnosis.arm import ArmDiagnosis
        from hybrid_id.systems.by_joint import with_standing_held

        remark_start_values(*(with_standing_held(dataset, system) if by_joint else (dataset, system)))
        from hybrid_id.reporting.arm_diagnosis import arm_page
        from hybrid_id.reporting.diagnosis import diagnosis_table

        asked = {"by_joint": True, "joints": joint} if by_joint else {}
        found = run(dataset, system, config, kept, **asked)
        with results_folder(home, force=True) as folder:  # kept_fits has asked
            results = Results(folder, home, config, "diagnose")
            if isinstance(found, ArmDiagnosis):
                (text, drawn), shown = write_arm(results, found), arm_page(found, {}, {}).screen()
                further = [f"{name}/" for name in joint_folders(found.joints).values()]
                undrawn = undrawn_words(drawn)
            else:
                text, whole = write_diagnosis(results, found)
                shown = diagnosis_table(found, config.gap.max_effects)
                further = [NEXT] if (folder / NEXT).exists() else []
                undrawn = "" if whole else UNDRAWN
            more = keep_after(home, folder, kept) if undrawn or found.interrupted else ""
    results.show(text, shown, DIAGNOSIS, "model.yaml", "refit.yaml", *further, as_json=as_json)
    lacks = ["the results are those of the steps that were complete"] if found.interrupted else []
    lacks += [undrawn] if undrawn else []
    if lacks:
        there = "" if found.interrupted else f"the diagnosis is complete and in {DIAGNOSIS}, "
        remark(f"stopped: {there}{', '.join(lacks)}{more}")
        raise typer.Exit(130)


def run(
    dataset: "Dataset",
    system: "System",
    config: StudyConfig,
    kept: "Kept",
    *,
    by_joint: bool = False,
    joints: list[str] | None = None,
) -> "Diagnosis | ArmDiagnosis":
    """Diagnose as the config says, a robot joint by joint, with a bar on stderr."""
    from joblib import cpu_count

    from hybrid_id.diagnosis.arm import diagnose_arm
    from hybrid_id.diagnosis.diagnose import diagnose as diagnose_whole
    from hybrid_id.study import Horizon
    from hybrid_id.systems.by_joint import asked_parts, joints_to_diagnose

    # processes that this machine bears: each holds the records, and what its fit makes of them
    long = sum(record.n_samples for record in dataset.records) > LONG
    settings: dict[str, Any] = {
        "max_effects": config.gap.max_effects,
        "horizon": Horizon.of(config.identification.window),
        "jobs": config.gap.jobs or (1 if long else min(cpu_count(), MOST_JOBS)),
        "seed": config.identification.seed,
        "level": config.statistics.level,
        "kept": kept,
    }
    if not by_joint:
        with SearchProgress(config.gap.max_effects) as progress:
            return diagnose_whole(dataset, system, progress=progress, **settings)
    searches = len(set(asked_parts(system, joints)) if joints else joints_to_diagnose(dataset, system)[0])
    with SearchProgress(config.gap.max_effects, searches) as progress:
        return diagnose_arm(dataset, system, joints=joints, progress=progress, **settings)


def takes_by_joint(system: "System", model: Path, joints: list[str] | None) -> bool:
    """Whether a robot is diagnosed joint by joint; --joint of anything else is refused."""
    if system.tree is None:
        if joints:
            raise InputError(f"{model}: --joint takes a joint of a robot, whose description the model names")
        return False
    return bool(joints or system.tree.couplings) or len(system.joints) > MOST_JOINTS


def joint_folders(joints: Iterable[str]) -> dict[str, str]:
    """Names of the folders of the joints' own results, by joint: what a path does not bear is replaced.

    Args:
        joints: names of those that were diagnosed, in their order.
    """
    names, taken = dict[str, str](), set[str](OTHERS)
    for joint in joints:
        plain = re.sub(r"[^\w.-]+|^\.+", "_", joint)[:MOST_LETTERS]
        name, k = plain, 1
        while name.lower() in taken:
            k += 1
            name = f"{plain}_{k}"
        names[joint] = name
        taken.add(name.lower())  # some disks know no capitals
    return names


def undrawn_words(drawn: Mapping[str, bool]) -> str:
    """What Ctrl-C has left out of a robot's pictures and pages, and what is there; empty where all is.

    Args:
        drawn: whether pictures and page are written, of the robot and of each joint.
    """
    there, lacks = ([name for name, done in drawn.items() if done == wanted] for wanted in (True, False))
    if not lacks:
        return ""
    words = f"pictures and {'page' if len(lacks) == 1 else 'pages'} of {listed(lacks)} are not written"
    return f"{words} (those of {listed(there)} are)" if there else words


def write_arm(results: Results, found: "ArmDiagnosis") -> tuple[str, dict[str, bool]]:
    """Write all files of a robot's diagnosis, those of each joint in a folder of its own.

    Returns:
        The result as JSON, and of the robot and of each joint whether all files are written: see `Results.report`.
    """
    from hybrid_id.records.quality import remarks
    from hybrid_id.reporting.arm_diagnosis import PAGE, arm_figures, arm_page, part_words
    from hybrid_id.reporting.results import as_json

    config = results.config
    seed, folders = {"seed": config.identification.seed}, joint_folders(found.joints)
    results.model(found.model)
    results.model(found.refit, "refit.yaml")
    pages = {joint: f"{name}/{PAGE}" for joint, name in folders.items()} if config.output.report else {}
    drawn = {}
    drawn["the robot"] = results.report(
        lambda: arm_figures(found),
        lambda figures: arm_page(found, figures, pages, findings=remarks(found.dataset)),
        settings=seed,
    )
    for joint, name in folders.items():
        drawn[joint] = write_parts(
            results.below(name), found.joints[joint], draw=all(drawn.values()), robot=f"../{PAGE}",
            beside=part_words(found, joint),
        )  # fmt: skip
    text = as_json("diagnose", seed | found.as_dict())
    write_last(results.folder / DIAGNOSIS, text)
    return text, drawn


def write_diagnosis(results: Results, diagnosis: "Diagnosis") -> tuple[str, bool]:
    """Write all files of a diagnosis.

    Returns:
        The result as JSON, and whether all files are written: see `Results.report`.
    """
    from hybrid_id.reporting.residuals import residual_result
    from hybrid_id.reporting.results import as_json

    residuals = {"residual_tests": residual_result(diagnosis.details.residual_tests)}
    text = as_json("diagnose", {"seed": results.config.identification.seed} | diagnosis.as_dict() | residuals)
    whole = write_parts(results, diagnosis)
    write_last(results.folder / DIAGNOSIS, text)
    return text, whole


def write_parts(
    results: Results, diagnosis: "Diagnosis", *, draw: bool = True, robot: str = "", beside: str = ""
) -> bool:
    """Write all files of a diagnosis but the result itself, which of a robot's joint stands in the robot's.

    Args:
        results: where to write.
        diagnosis: the result.
        draw: whether to draw its pictures and page.
        robot: where the page of the whole robot is, as seen from its own; empty without.
        beside: what else the robot's diagnosis has found there, in sentences.

    Returns:
        Whether all files are written: see `Results.report`.
    """
    from hybrid_id.records.quality import remarks
    from hybrid_id.reporting.diagnosis import diagnosis_page
    from hybrid_id.reporting.diagnosis_figures import diagnosis_figures
    from hybrid_id.reporting.tensorboard import write_diagnosis_events

    results.model(diagnosis.model)
    results.model(diagnosis.search.base.system, "refit.yaml")
    if diagnosis.proposed:
        from pandas import DataFrame, concat

        from hybrid_id.systems.by_joint import as_in_robot

        tables = []
        for k, record in enumerate(diagnosis.proposed, 1):
            columns = as_in_robot(record.inputs, diagnosis.model)
            begin = {f"start_{name}": angle for name, angle in record.start.items()}
            tables.append(DataFrame({"t": record.time, "record": k, "name": record.name, **columns, **begin}))
        concat(tables).to_csv(results.folder / NEXT, index=False, float_format="%.6g")
    return results.report(
        lambda: diagnosis_figures(diagnosis),
        lambda figures: diagnosis_page(
            diagnosis, figures, max_effects=results.config.gap.max_effects, findings=remarks(diagnosis.details.dataset),
            robot=robot, beside=beside,
        ),
        events=lambda place, images: write_diagnosis_events(place, diagnosis, images),
        compute=diagnosis.details.compute,
        settings={"seed": results.config.identification.seed},
        draw=draw,
    )  # fmt: skip

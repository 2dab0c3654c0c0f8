"""`demo`: the main job on records whose truth is known."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid_id.cli.console import remark
from hybrid_id.cli.console import show as print_all
from hybrid_id.cli.folder import refuse_taken, results_folder
from hybrid_id.cli.options import ABOVE, ForceOption, JsonOption
from hybrid_id.config import study_config
from hybrid_id.config.sections import MOST_SEED
from hybrid_id.errors import InputError

DATA = "data"


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help=f"Folder for records and results. {ABOVE}")] = Path(
        "runs/demo"
    ),
    robot: Annotated[
        bool, typer.Option("--robot", help="An arm of six servos, from its MJCF, in place of one drive.")
    ] = False,
    settings: Annotated[
        Path | None, typer.Option(help="Settings of another drive, configs/twin_link1.yaml say.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise and disturbances.", min=0, max=MOST_SEED)] = 0,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Identify a drive, or an arm, from simulated records whose truth is known, and show estimates beside the truth.

    The records come from an independent simulator. Of the drive: stick and slip, encoder counts, noise, random torques,
    and friction that drifts from run to run; of the arm: MuJoCo, with encoder counts. Nothing but the records and a
    model with wrong start values goes into the fit.
    """
    if robot and settings is not None:
        raise InputError("--settings belongs to the drive; leave out --robot or --settings")
    refuse_taken(out, force=force, reads=[] if settings is None else [settings])
    from hybrid_id.cli.identify import leave_earlier, left_out, run
    from hybrid_id.cli.results import Results, show_study, write_study
    from hybrid_id.machines.desk_arm import write_arm
    from hybrid_id.paper.demo import DEMO
    from hybrid_id.paper.twin import write_campaign
    from hybrid_id.records.quality import remarks
    from hybrid_id.records.yaml_file import read_yaml
    from hybrid_id.reporting.tables import count, identifiability_table, truth_table
    from hybrid_id.study import check_identifiability
    from hybrid_id.study.result import against_truth
    from hybrid_id.systems.model_file import load_model

    def show(*parts: Any) -> None:
        if not as_json:
            print_all(*parts)

    with results_folder(out, force=force) as folder:
        data, changes = folder / DATA, dict[str, Any]({"identification.seed": seed})
        if robot:
            dataset, of_arm = write_arm(data, seed)
            truths = {record.name: of_arm for record in dataset.records}
            changes["identification.pooled"] = True
            show(
                f"1. {count(len(dataset.train), 'record')} of a simulated arm of six servos, and one to test with: "
                f"goals in, joint angles out. Its description, {DATA}/desk_arm.xml, has values that are up to 30 % "
                "off, and a rigid elbow.",
                "",
                "2. One parameter set over all records (compiling the arm's equations takes some seconds):",
            )
        else:
            dataset, runs = write_campaign(data, DEMO if settings is None else read_yaml(settings), seed)
            truths = {record.name: run for record, run in zip(dataset.records, runs, strict=True)}
            changes["model"] = str(data / "model_priors.yaml")
            tests = f", {count(len(dataset.test), 'record')} to test with" if dataset.test else ""
            said = [finding.message for finding in remarks(dataset)] or ["nothing to remark on their quality"]
            show(
                f"1. {count(len(dataset.train), 'record')} of a simulated drive{tests}: voltage in, motor angle out.",
                *(f"   {words}" for words in said),
                "",
                "2. What these records identify, before any fit:",
                identifiability_table(check_identifiability(dataset, load_model(data / "model.yaml"))),
                "",
                "3. So the data sheet's motor constants go in as priors. One parameter set a record:",
            )
        config = study_config(data, changes)
        study, progress = run(dataset, load_model(config.model), config)
        leave_earlier(out, progress)
        home = out.absolute()
        placed = config.model_copy(update={"dataset": home / DATA, "model": home / DATA / config.model.name})
        draw = progress.cut or not progress.stopped
        results = Results(folder, home, placed, "demo")
        text, whole = write_study(results, dataset, study, draw=draw)
        truth = truths[study.selected.records[0]]
    show_study(replace(results, home=out), study, text, as_json=as_json)
    claims = [recovery.inside for recovery in against_truth(study, truth) if recovery.inside is not None]
    fit, test = study.selection.mean[study.selection.index], list(study.test_nrmse.values())
    held = f", {100 * (1 - test[0]):.2f} % on the record that was held back" if test else ""
    pictures = ("fit_*.png", "parameters.png", "cross_validation.png", "residuals.png")
    show(
        "",
        f"The truth of {'the arm' if robot else study.selected.records[0]} beside its estimates:",
        truth_table(study, truth),
        "",
        f"Found: {len(study.names)} parameters; {sum(claims)} of {len(claims)} intervals hold the truth.",
        f"Replayed over all records the selected set {study.selection.name} fits {fit:.2f} %{held}.",
        f"Pictures: {', '.join(f'{out}/{name}' for name in pictures)}",
        f"The identified model: {out}/model.yaml; every command takes it.",
    )
    if words := left_out(config, progress, whole=whole):
        remark(f"stopped: {words}")
        raise typer.Exit(130)

"""`demo`: the main job on records whose truth is known."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli.console import remark
from hybrid_id.cli.console import show as print_all
from hybrid_id.cli.folder import refuse_taken, results_folder
from hybrid_id.cli.options import ABOVE, ForceOption, JsonOption, ThreadsOption, use_threads
from hybrid_id.config import study_config
from hybrid_id.config.sections import MOST_SEED
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.study import Study

DATA = "data"


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help=f"Folder for records and results. {ABOVE}")] = Path(
        "runs/demo"
    ),
    robot: Annotated[
        bool, typer.Option("--robot", help="An arm of six servos, from its MJCF, in place of one drive.")
    ] = False,
    settings: Annotated[
        Path | None,
        typer.Option(help="Settings of another drive, configs/twin_link1.yaml say.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise and disturbances.", min=0, max=MOST_SEED)] = 0,
    force: ForceOption = False,
    as_json: JsonOption = False,
    threads: ThreadsOption = 1,
) -> None:
    """Identify a drive, or an arm, from simulated records whose truth is known, and show estimates beside the truth.

    The records come from an independent simulator. Of the drive: stick and slip, encoder counts, noise, random torques,
    and friction that drifts from run to run; of the arm: MuJoCo, with encoder counts. Nothing but the records and a
    model with wrong start values goes into the fit.
    """
    if robot and settings is not None:
        raise InputError("--settings belongs to the drive; leave out --robot or --settings")
    refuse_taken(out, force=force, reads=[] if settings is None else [settings])
    use_threads(threads)

    def show(*parts: object) -> None:
        if not as_json:
            print_all(*parts)  # type: ignore[arg-type]

    from hybrid_id.cli.identify import leave_earlier, left_out, run
    from hybrid_id.cli.results import show_study, write_study
    from hybrid_id.reporting.study_figures import truth_figure
    from hybrid_id.reporting.style import save
    from hybrid_id.reporting.tables import truth_table
    from hybrid_id.systems.model_file import load_model

    with results_folder(out, force=force) as folder:
        make = _arm if robot else _drive
        dataset, truths, changes = make(folder / DATA, settings, seed, show)
        config = study_config(folder / DATA, {"identification.seed": seed, **changes})
        study, progress = run(dataset, load_model(config.model), config)
        leave_earlier(out, progress)
        home = out.absolute()
        placed = config.model_copy(update={"dataset": home / DATA, "model": home / DATA / config.model.name})
        draw = progress.cut or not progress.stopped
        text, whole = write_study(folder, home, "demo", placed, dataset, study, draw=draw)
        truth = truths[study.selected.records[0]]
        save(truth_figure(study, truth), folder / "truth.png")
    show_study(study, config, out, text, as_json=as_json)
    show("", f"The truth of {'the arm' if robot else study.selected.records[0]} beside its estimates:")
    show(truth_table(study, truth))
    show("", *_conclusion(study, truth, out))
    if words := left_out(config, progress, whole=whole):
        remark(f"stopped: {words}")
        raise typer.Exit(130)


Truths = dict[str, dict[str, float]]
"""True values of each record, by parameter."""
Show = Callable[..., None]


def _drive(
    folder: Path, settings: Path | None, seed: int, show: Show
) -> "tuple[Dataset, Truths, dict[str, object]]":
    """Records of one drive and their truth; the data sheet's motor constants go in as priors."""
    from hybrid_id.machines.twin.campaign import write_campaign
    from hybrid_id.machines.twin.demo import DEMO
    from hybrid_id.records.quality import remarks
    from hybrid_id.records.yaml_file import read_yaml
    from hybrid_id.reporting.tables import count, identifiability_table
    from hybrid_id.study import check_identifiability
    from hybrid_id.systems.model_file import load_model

    dataset, truths = write_campaign(folder, DEMO if settings is None else read_yaml(settings), seed)
    tests = f", {count(len(dataset.test), 'record')} to test with" if dataset.test else ""
    show(
        f"1. {count(len(dataset.train), 'record')} of a simulated drive{tests}: voltage in, motor angle out."
    )
    warnings = [finding.message for finding in remarks(dataset)]
    show(*(f"   {words}" for words in warnings or ["nothing to remark on their quality"]))
    show("", "2. What these records identify, before any fit:")
    show(identifiability_table(check_identifiability(dataset, load_model(folder / "model.yaml"))))
    show("", "3. So the data sheet's motor constants go in as priors. One parameter set a record:")
    own = dict(zip((record.name for record in dataset.records), truths, strict=True))
    return dataset, own, {"model": str(folder / "model_priors.yaml")}


def _arm(
    folder: Path, settings: Path | None, seed: int, show: Show
) -> "tuple[Dataset, Truths, dict[str, object]]":
    """Records of an arm of six servos, and its truth, which is that of all records."""
    from hybrid_id.machines.twin.desk_arm import write_arm
    from hybrid_id.reporting.tables import count

    dataset, truth = write_arm(folder, seed)
    show(
        f"1. {count(len(dataset.train), 'record')} of a simulated arm of six servos, and one to test with: goals in, "
        f"joint angles out. Its description, {folder.name}/desk_arm.xml, has values that are up to 30 % off, and a "
        "rigid elbow.",
        "",
        "2. One parameter set over all records (compiling the arm's equations takes some seconds):",
    )
    return dataset, {record.name: truth for record in dataset.records}, {"identification.pooled": True}


def _conclusion(study: "Study", truth: dict[str, float], out: Path) -> list[str]:
    from hybrid_id.study.result import against_truth

    claims = [one.inside for one in against_truth(study, truth) if one.inside is not None]
    fit, test = study.selection.mean[study.selection.index], list(study.test_nrmse.values())
    held = f", {100 * (1 - test[0]):.2f} % on the record that was held back" if test else ""
    return [
        f"Found: {len(study.names)} parameters; {sum(claims)} of {len(claims)} intervals hold the truth.",
        f"Replayed over all records the selected set {study.selection.name} fits {fit:.2f} %{held}.",
        f"Pictures: {out}/truth.png, {out}/fit_*.png, {out}/parameters.png, {out}/cross_validation.png, "
        f"{out}/residuals.png",
        f"The identified model: {out}/model.yaml; every command takes it.",
    ]

"""`train` with a `hybrid` section: physics with residual networks."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hybrid_id.cli.console import err, remark, show
from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.folder import CHECKPOINT, EVENTS, RESULT, page_and_pictures
from hybrid_id.cli.inputs import check_windows
from hybrid_id.cli.study import reach_of
from hybrid_id.cli.training_folder import added_results, leave_without_checkpoint, live_folder, stopped
from hybrid_id.config import Hybrid, StudyConfig

if TYPE_CHECKING:
    from hybrid_id.identification.hybrid import HybridOptions
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.reporting.residual_words import Residuals
    from hybrid_id.simulation.solvers import OdeEngine
    from hybrid_id.study.hybrid import HybridStudy
    from hybrid_id.systems.chain import System


def train_with_networks(
    config: StudyConfig,
    dataset: "Dataset",
    system: "System",
    home: Path,
    *,
    resume: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Train, write the folder of results and print them."""
    assert config.hybrid is not None  # the caller's condition
    from hybrid_id.reporting.hybrid import hybrid_result, hybrid_tables
    from hybrid_id.reporting.residual_words import residual_result
    from hybrid_id.reporting.results import as_json as to_json
    from hybrid_id.study.hybrid import split

    system = with_networks(system, config)
    with config.at("hybrid.validation"):
        trained, _ = split(dataset, config.hybrid.validation)
    check_windows(config, "hybrid.windows", trained)
    with live_folder(home, config, force=force, resume=resume):
        study = _train(dataset, system, config, home, resume=resume)
        leave_without_checkpoint(home, interrupted=study.result.interrupted)
        residuals = _residuals(dataset, study, config)
        told = hybrid_result(study) | {"residual_tests": residual_result(residuals)}
        text = to_json("train", {"dataset": dataset.name} | told)
        with added_results(home) as folder:
            _write(folder, home, config, dataset, study, residuals, text)
        if as_json:
            stdout().print(text, markup=False, soft_wrap=True)
        else:
            page, pictures = page_and_pictures(config)
            show(hybrid_tables(study, dataset, reach_of(config), config.statistics.level))
            show(f"results are in {home}: {page}result.json, model.yaml, physics.yaml, {pictures}config.yaml")
        if study.result.interrupted:  # what this one replaces is kept
            remark(stopped(home))
            raise typer.Exit(130)


def with_networks(system: "System", config: StudyConfig) -> "System":
    """The model with the networks that the config asks for."""
    from hybrid_id.components import ResidualNetwork

    assert config.hybrid is not None
    for k, network in enumerate([] if system.networks else config.hybrid.networks):
        key = f"hybrid.networks[{k}]"
        check_network(system, config, (f"{key}.place", network.place), (f"{key}.inputs", network.inputs))
        part = ResidualNetwork(
            inputs=network.inputs,
            hidden=network.hidden,
            memory=network.memory,
            lipschitz=network.lipschitz,
            seed=config.identification.seed,
        )
        system = system.with_component(network.place, part)
    return system


def check_network(
    system: "System", config: StudyConfig, place: tuple[str, str], inputs: tuple[str, Sequence[str]]
) -> None:
    """Refuse a place where the system can have no network, and inputs unknown there; each comes with its key."""
    from hybrid_id.components import ResidualNetwork

    (place_key, where), (inputs_key, names) = place, inputs
    with config.at(place_key):
        system.with_component(where, ResidualNetwork(inputs=["speed"]))  # which is known everywhere
    with config.at(inputs_key):
        system.with_component(where, ResidualNetwork(inputs=names))


def engine_of(config: StudyConfig) -> "OdeEngine":
    """The solver that the config asks for."""
    from hybrid_id.simulation.solvers import OdeEngine

    how = config.training
    with config.at("training"):
        return OdeEngine(
            substeps=how.substeps, width=how.width, fine=how.fine, method=how.method, gradient=how.gradient
        )


def options_of(config: StudyConfig, wish: Hybrid) -> "HybridOptions":
    """The settings of a hybrid training that the config asks for."""
    from hybrid_id.identification.hybrid import HybridOptions
    from hybrid_id.identification.objective import Loss

    same = ("max_iterations", "tolerance", "patience", "validate_every", "worth")
    same += ("augmentation", "optimizer", "rate", "clip", "precision")
    return HybridOptions(
        prices=tuple(wish.prices),
        windows=tuple(wish.windows),
        loss=Loss(config.identification.loss, config.identification.threshold),
        starts=config.identification.starts,
        seed=config.identification.seed,
        **{name: getattr(wish, name) for name in same},
    )


def _train(
    dataset: "Dataset", system: "System", config: StudyConfig, folder: Path, *, resume: bool
) -> "HybridStudy":
    """Train as the config says, with checkpoints and TensorBoard events in the folder."""
    from hybrid_id.reporting.tensorboard import TrainingLog
    from hybrid_id.study.hybrid import hybridise

    wish = config.hybrid
    assert wish is not None
    engine, options = engine_of(config), options_of(config, wish)
    console, saved = err(), folder / CHECKPOINT
    waiting = console.status("physics alone") if console.is_terminal else nullcontext()
    with (
        TrainingLog(folder / EVENTS) if config.output.tensorboard else nullcontext() as log,
        waiting as line,
    ):

        def progress(stage: str, count: int, loss: float) -> bool:
            if line is not None:
                line.update(
                    f"{stage}: gradient {count}, error {(2.0 * loss) ** 0.5:.4g} (1 = as the noise says)"
                )
            return False

        return hybridise(
            dataset, system, engine=engine, options=options, validation=wish.validation,
            device=config.identification.device, signal_share=config.preprocessing.signal_share, writer=log,
            checkpoint=saved, resume=saved if resume else None, progress=progress,
        )  # fmt: skip


def _residuals(dataset: "Dataset", study: "HybridStudy", config: StudyConfig) -> "Residuals":
    """Tests of what physics alone leaves, and the chosen system where that is another one."""
    from hybrid_id.study.residual_tests import residual_tests

    result = study.result
    models = {"physics": result.rungs[0].system} | ({"hybrid": result.system} if result.chosen else {})
    share = config.preprocessing.signal_share
    return {
        name: residual_tests(dataset, one, result.engine, signal_share=share) for name, one in models.items()
    }


def _write(
    folder: Path,
    home: Path,
    config: StudyConfig,
    dataset: "Dataset",
    study: "HybridStudy",
    residuals: "Residuals",
    text: str,
) -> None:
    """Write all files of a hybrid study into `folder`, which will be `home`."""
    from hybrid_id.reporting.html.hybrid_page import hybrid_page
    from hybrid_id.reporting.hybrid import hybrid_pictures
    from hybrid_id.reporting.style import save
    from hybrid_id.systems.model_file import save_model

    save_model(study.result.system, folder / "model.yaml")
    save_model(study.result.physics.system, folder / "physics.yaml")
    config.save(folder / "config.yaml", home=home)
    pictures = hybrid_pictures(study)
    if config.output.figures:
        for name, picture in pictures.items():
            save(picture.image, folder / f"{name}.png")
    if config.output.tensorboard:
        from torch.utils.tensorboard.writer import SummaryWriter

        with SummaryWriter(str(folder / EVENTS / "figures")) as writer:
            for name, picture in pictures.items():
                writer.add_image(f"figures/{name}", picture.image, dataformats="HWC")
    if config.output.report:
        from hybrid_id.reporting.html.made import how_made
        from hybrid_id.study import analyse_fits

        words = (folder / "config.yaml").read_text(encoding="utf-8")
        share, physics = config.preprocessing.signal_share, study.result.physics
        fitted = dataset.select(physics.records)  # the others have validated
        page = hybrid_page(
            dataset,
            study,
            pictures,
            reach=reach_of(config),
            level=config.statistics.level,
            alone=analyse_fits(fitted, physics.system, [physics], pooled=True, signal_share=share),
            residuals=residuals,
        )
        page = how_made(page, "train", words)
        page.write(folder / "report.html")
    (folder / RESULT).write_text(text + "\n", encoding="utf-8")

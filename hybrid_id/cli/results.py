"""What the commands write into a folder of results: pictures, TensorBoard events, the page, and the result itself."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid_id.cli.console import remark, show
from hybrid_id.cli.folder import EVENTS, RESULT
from hybrid_id.config import StudyConfig

if TYPE_CHECKING:
    import numpy as np
    from rich.console import RenderableType

    from hybrid_id.records.dataset import Dataset
    from hybrid_id.reporting.page import Page
    from hybrid_id.study import Study
    from hybrid_id.systems.chain import System

UNDRAWN = "pictures and page are not written"
"""What is said where Ctrl-C has ended the drawing."""


@dataclass(frozen=True)
class Results:
    """A folder of results that a command fills.

    Attributes:
        folder: where to write.
        home: where the folder will be at last.
        config: what was asked for.
        command: its name.
    """

    folder: Path
    home: Path
    config: StudyConfig
    command: str

    def below(self, name: str) -> Results:
        """A folder in this one, which is made."""
        (self.folder / name).mkdir()
        return replace(self, folder=self.folder / name, home=self.home / name)

    def model(self, system: System, name: str = "model.yaml") -> None:
        """Write a model."""
        from hybrid_id.systems.model_file import save_model

        save_model(system, self.folder / name, self.home)

    def report(
        self,
        figures: Callable[[], dict[str, np.ndarray]],
        page: Callable[[dict[str, np.ndarray]], Page],
        *,
        events: Callable[[Path, Mapping[str, np.ndarray]], None] | None = None,
        compute: Callable[[], None] = lambda: None,
        settings: Mapping[str, object] | None = None,
        draw: bool = True,
    ) -> bool:
        """Write the study file, and the pictures, TensorBoard events and page that it asks for.

        Ctrl-C ends it: pictures, events and page are then left out, all of them, and the result is kept.

        Args:
            figures: draws the pictures, by the name of their file.
            page: makes the page of them.
            events: writes event files with the images into a folder.
            compute: computes what these show, beside the result itself.
            settings: what the page says of how it was made, beside versions and study file.
            draw: whether to draw; not where the user has already asked for the end.

        Returns:
            Whether all that the study file asks for is written.
        """
        self.config.save(self.folder / "config.yaml", home=self.home)
        wish = self.config.output
        if not (wish.figures or wish.tensorboard or wish.report):
            return True
        if not draw:
            return False
        try:
            with tempfile.TemporaryDirectory(dir=self.folder) as temporary:
                from hybrid_id.reporting.page import how_made
                from hybrid_id.reporting.style import save

                compute()
                new, drawn = Path(temporary), figures()
                if wish.figures:
                    for name, figure in drawn.items():
                        save(figure, new / f"{name}.png")
                if wish.tensorboard and events is not None:
                    events(new / EVENTS, drawn)
                if wish.report:
                    words = (self.folder / "config.yaml").read_text(encoding="utf-8")
                    how_made(page(drawn), self.command, words, settings).write(new / "report.html")
                for made in new.iterdir():
                    made.replace(self.folder / made.name)
        except KeyboardInterrupt:
            return False
        return True

    def show(self, text: str, table: RenderableType, *names: str, as_json: bool) -> None:
        """Print the result as JSON, or its table and where the files are that Ctrl-C has not left out."""
        if as_json:
            return show(text)
        wish, home = self.config.output, self.home
        page = ("report.html",) if wish.report and (home / "report.html").exists() else ()
        pictures = ("pictures",) if wish.figures and any(home.glob("*.png")) else ()
        files = ", ".join((*page, *names, *pictures, "config.yaml"))
        show(table, f"results are in {home}: {files}")


def write_last(file: Path, text: str) -> None:
    """Write the result itself, whose presence says that all others are complete."""
    file.write_text(text + "\n", encoding="utf-8")


def write_study(results: Results, dataset: Dataset, study: Study, *, draw: bool = True) -> tuple[str, bool]:
    """Write all files of a study.

    Returns:
        The result as JSON, and whether all files are written: see `Results.report`.
    """
    from hybrid_id.records.quality import remarks
    from hybrid_id.reporting.residuals import residual_result
    from hybrid_id.reporting.results import as_json, study_result, write_models, write_parameters
    from hybrid_id.reporting.study import study_page
    from hybrid_id.reporting.study_figures import study_figures
    from hybrid_id.reporting.tensorboard import write_study_events
    from hybrid_id.study import replay
    from hybrid_id.study.checks import study_residuals

    residuals = study_residuals(dataset, study)
    content: dict[str, Any] = study_result(study)
    content |= {"dataset": dataset.name, "residual_tests": residual_result(residuals)}
    text = as_json(results.command, content)
    write_models(results.folder, results.home, study)
    write_parameters(results.folder / "parameters.csv", study)

    def figures() -> dict[str, np.ndarray]:
        runs = replay(dataset, study.selected.system, engine=study.selected.engine, horizon=study.horizon)
        return study_figures(dataset, study, runs)

    whole = results.report(
        figures,
        lambda drawn: study_page(dataset, study, drawn, findings=remarks(dataset), residuals=residuals),
        events=lambda place, images: write_study_events(
            place, study, images, curves=results.command != "train"
        ),
        settings={"seed": results.config.identification.seed},
        draw=draw,
    )
    write_last(results.folder / RESULT, text)
    return text, whole


def show_study(results: Results, study: Study, text: str, *, as_json: bool) -> None:
    """Print the study, as a table or as JSON, and where its files are; say so where it explains nothing."""
    from hybrid_id.study import check_fit, check_priors

    for words in (check_fit(study), *check_priors(study)):
        if words:
            remark(f"warning: {words}")
    from hybrid_id.reporting.study import study_table

    results.show(text, study_table(study), "parameters.csv", RESULT, "model.yaml", as_json=as_json)

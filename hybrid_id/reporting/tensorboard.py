"""What TensorBoard shows: the history of a training, a cell of an ablation, a finished study or diagnosis."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.files import hidden_beside
from hybrid_id.reporting.diagnosis_words import errors_by_name
from hybrid_id.reporting.style import COLOURS, GREY, journal, label, new_figure, pixels
from hybrid_id.study import Study
from hybrid_id.study.ablation import CellResult
from hybrid_id.study.training import Overlay, Snapshot, overlays, scalars
from hybrid_id.systems.by_joint import named


class TrainingLog:
    """Writer of a training; pass it to :func:`hybrid_id.study.training.train`, best in a ``with``.

    Tags: ``loss/train`` (the whole cost, price and priors in it, per measurement; of windows at first) and
    ``loss/validation`` (of the data alone, its typical part), ``gradient/norm`` (in standard errors; Adam's per datum),
    ``fit/<signal>`` [%], ``parameters/<joint>/<symbol>``, of networks ``residual/share_<output>`` and
    ``residual/price``; figures ``simulated/<signal>`` when it is closed.

    Args:
        folder: where the runs go, one folder a set, so that records share each chart.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._writers: dict[str, SummaryWriter] = {}
        self._last: Snapshot | None = None

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def record(self, snapshot: Snapshot) -> None:
        """Write the scalars of one snapshot."""
        self._last = snapshot
        for name, values in scalars(snapshot).items():
            for tag, value in values.items():
                self._writer(name).add_scalar(tag, value, snapshot.step)

    def close(self) -> None:
        """Add the pictures of the last snapshot and close the files."""
        for one in overlays(self._last, first_only=True) if self._last is not None else ():
            writer, step = self._writer(one.set_name), self._last and self._last.step
            writer.add_image(f"simulated/{one.signal}", pixels(_overlay(one)), step, dataformats="HWC")
        for writer in self._writers.values():
            writer.close()
        self._writers, self._last = {}, None

    def _writer(self, name: str) -> SummaryWriter:
        if name not in self._writers:
            self._writers[name] = SummaryWriter(str(self.folder / name))
        return self._writers[name]


@journal()
def _overlay(one: Overlay) -> Figure:
    """An output measured and simulated over time."""
    figure = new_figure(2.2)
    axes = figure.subplots()
    axes.plot(one.time, one.measured, color=GREY, lw=2.4, alpha=0.75, label="measured")
    axes.plot(one.time, one.simulated, color=COLOURS[0], lw=1.0, label="simulated")
    axes.set(xlabel="time [s]", ylabel=label(one.signal, ""), title=one.record)
    axes.legend()
    return figure


def write_study_events(
    folder: Path, study: Study, images: Mapping[str, np.ndarray], *, curves: bool = True
) -> None:
    """Write event files of a study: parameters and fits by number of the set, its loss over the iterations, pictures.

    ``images`` are (H, W, 3) by name; without ``curves`` no scalars are written, where a training has written its own.
    """
    with SummaryWriter(str(folder)) as writer:
        for i, result in enumerate(study.sets if curves else ()):
            for name, value in zip(result.names, result.values, strict=True):
                joint, _, _ = study.system.parameter(name).component.partition("/")
                writer.add_scalar(f"parameters/{joint}/{name}", value, i)
            for iteration, cost in enumerate(result.history):
                writer.add_scalar(f"loss/train/{study.cross_validation.set_names[i]}", cost, iteration)
        for j, signal in enumerate(study.cross_validation.signal_names if curves else ()):
            for i, fits in enumerate(study.cross_validation.fits[:, :, j]):
                writer.add_scalar(f"fit/{signal}", float(np.mean(fits)), i)
        _add_images(writer, images)


def write_diagnosis_events(folder: Path, diagnosis: Diagnosis, images: Mapping[str, np.ndarray]) -> None:
    """Write event files of a diagnosis: errors on test records, shares, probabilities, pictures (H, W, 3) by name."""
    with SummaryWriter(str(folder)) as writer:
        for name, errors in errors_by_name(diagnosis).items():
            writer.add_scalar(f"gap/{name}", errors.nrmse)
            for output, value in errors.by_output.items():
                writer.add_scalar(f"gap/{output}/{name}", value)
        writer.add_scalar("share/unexplained", diagnosis.remainder)
        for one in diagnosis.effects:
            where = named(diagnosis.model, one.where)
            writer.add_scalar(f"probability/{where}/{one.name}", one.probability)
            if one.share is not None:
                writer.add_scalar(f"share/{where}/{one.name}", one.share)
        _add_images(writer, images)


def write_images(folder: Path, images: Mapping[str, np.ndarray]) -> None:
    """Write pictures, (H, W, 3) by name, as event files."""
    with SummaryWriter(str(folder)) as writer:
        _add_images(writer, images)


def _add_images(writer: SummaryWriter, images: Mapping[str, np.ndarray]) -> None:
    for name, image in images.items():
        writer.add_image(f"figures/{name}", image, dataformats="HWC")


def write_cell_events(folder: Path, result: CellResult) -> None:
    """Write the run of a cell that is done, in place of an earlier one; it appears when it is whole.

    Tags as in :class:`TrainingLog`; metrics ``final/...`` for the table of hyper-parameters, errors as RMS of the
    weighted free run.

    Args:
        folder: of all runs; the cell's name is that of its own.
        result: of the cell.
    """
    place, arm, best = folder / result.cell.name, result.cell.arm, result.best
    settings = {
        "residual": arm.residual,
        "place": " and ".join(arm.places) or "none",
        "width": arm.width,
        "taken out": " and ".join(arm.without) or "nothing",
        "seed": result.cell.seed,
    }
    sets = {"test": "test", "out_of_range": "beyond", "validation": "validation", "train": "train"}
    metrics = {
        name: best.error(getattr(result.cell.split, of)) for name, of in sets.items()
    }  # the first few are shown
    metrics |= {"share": best.share, "overlap": best.overlap, "price": best.price, "seconds": result.seconds}
    finite = {f"final/{name}": value for name, value in metrics.items() if math.isfinite(value)}
    folder.mkdir(exist_ok=True)
    with hidden_beside(folder) as temporary:
        new = temporary / "new"
        with SummaryWriter(str(new)) as writer:
            for tag, values in result.history.items():
                for step, value in values:
                    writer.add_scalar(tag, value, step)
            writer.add_hparams(settings, finite, run_name=".")
        shutil.rmtree(place, ignore_errors=True)
        new.replace(place)

"""A finished study in TensorBoard: scalars of every set, and the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.study import Study

DPI = 110


def write_study_events(
    folder: Path, study: Study, figures: Mapping[str, Figure], *, curves: bool = True
) -> None:
    """Write event files.

    Args:
        folder: Where to.
        study: Parameters of each set, by number of the set; its loss over the iterations; its fits.
        figures: Pictures by name.
        curves: Whether the scalars are written; not where a training has written its own.
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
        for name, figure in figures.items():
            writer.add_image(f"figures/{name}", _pixels(figure), dataformats="HWC")


def _pixels(figure: Figure) -> np.ndarray:
    """A figure as an image (H, W, 3) uint8, drawn without pyplot."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()

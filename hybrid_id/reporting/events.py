"""A finished study in TensorBoard: scalars of every set, and the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.study import Study


def write_study_events(
    folder: Path, study: Study, images: Mapping[str, np.ndarray], *, curves: bool = True
) -> None:
    """Write event files.

    Args:
        folder: Where to.
        study: Parameters of each set, by number of the set; its loss over the iterations; its fits.
        images: Pictures by name, (H, W, 3).
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
        for name, image in images.items():
            writer.add_image(f"figures/{name}", image, dataformats="HWC")

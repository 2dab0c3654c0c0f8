"""A finished study or diagnosis in TensorBoard: its scalars and its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.reporting.diagnosis_words import errors_by_name
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
        _write_images(writer, images)


def write_diagnosis_events(folder: Path, diagnosis: Diagnosis, images: Mapping[str, np.ndarray]) -> None:
    """Write event files of a diagnosis: errors on the test records, shares, probabilities, and the pictures.

    Args:
        folder: Where to.
        diagnosis: The result.
        images: Pictures by name, (H, W, 3).
    """
    with SummaryWriter(str(folder)) as writer:
        for name, errors in errors_by_name(diagnosis).items():
            writer.add_scalar(f"gap/{name}", errors.nrmse)
            for output, value in errors.by_output.items():
                writer.add_scalar(f"gap/{output}/{name}", value)
        writer.add_scalar("share/unexplained", diagnosis.remainder)
        for one in diagnosis.effects:
            writer.add_scalar(f"probability/{one.where}/{one.name}", one.probability)
            if one.share is not None:
                writer.add_scalar(f"share/{one.where}/{one.name}", one.share)
        _write_images(writer, images)


def _write_images(writer: SummaryWriter, images: Mapping[str, np.ndarray]) -> None:
    for name, image in images.items():
        writer.add_image(f"figures/{name}", image, dataformats="HWC")

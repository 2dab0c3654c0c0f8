"""The course of a training in TensorBoard: one run a parameter set, so that records share each chart."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np
import torch
from matplotlib.figure import Figure
from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.reporting.style import COLOURS, GREY, journal, label, new_figure, pixels
from hybrid_id.statistics.fit import fit_by_signal


class TrainingLog:
    """Writer of a training; pass it to :func:`hybrid_id.identification.adjoint.train`, best in a ``with``.

    Tags: ``loss/train`` (the whole cost, price and priors in it, per measurement; of windows at first) and
    ``loss/validation`` (of the data alone, its typical part), ``gradient/norm`` (in standard errors; Adam's per datum),
    ``fit/<signal>`` [%], ``parameters/<joint>/<symbol>``, of networks ``residual/share_<output>`` and
    ``residual/price``; figures ``simulated/<signal>`` when it is closed.

    Args:
        folder: where the runs go, one folder a set.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._writers: dict[str, SummaryWriter] = {}
        self._last: Snapshot | None = None

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def record(self, snapshot: Snapshot) -> None:
        """Write the scalars of one snapshot."""
        self._last = snapshot
        tags = snapshot.parameter_tags
        measured, simulated, used = (
            np.asarray(t.cpu()) for t in (snapshot.batch.y, snapshot.simulated, snapshot.batch.weight > 0)
        )
        for g, name in enumerate(snapshot.names):
            scalars = {"loss/train": snapshot.train[g], "gradient/norm": snapshot.gradient_norm[g]}
            if snapshot.validation is not None:
                scalars["loss/validation"] = snapshot.validation[g]
            scalars |= dict(zip(tags, snapshot.values[g], strict=True)) | dict(snapshot.scalars)
            rows = (snapshot.sets == g).nonzero().flatten().tolist()
            for k, signal in enumerate(snapshot.batch.outputs):
                fits = [
                    float(fit_by_signal({signal: measured[r, u, k]}, {signal: simulated[r, u, k]})[signal])
                    for r in rows
                    for u in [used[r, :, k]]
                ]
                scalars[f"fit/{signal}"] = torch.tensor(
                    np.nanmean(fits) if np.isfinite(fits).any() else np.nan
                )
            for tag, value in scalars.items():
                self._writer(name).add_scalar(tag, float(value), snapshot.step)

    def close(self) -> None:
        """Add the pictures of the last snapshot and close the files."""
        if self._last is not None:
            for g, name in enumerate(self._last.names):
                row = int((self._last.sets == g).nonzero()[0])
                for k, signal in enumerate(self._last.batch.outputs):
                    image = pixels(_overlay(self._last, row, k))
                    self._writer(name).add_image(
                        f"simulated/{signal}", image, self._last.step, dataformats="HWC"
                    )
        for writer in self._writers.values():
            writer.close()
        self._writers, self._last = {}, None

    def _writer(self, name: str) -> SummaryWriter:
        if name not in self._writers:
            self._writers[name] = SummaryWriter(str(self.folder / name))
        return self._writers[name]


def _overlay(snapshot: Snapshot, row: int, column: int) -> Figure:
    """One row: an output measured and simulated over time."""
    batch, name = snapshot.batch, snapshot.batch.outputs[column]
    used = batch.weight[row, :, column] > 0
    time = torch.cat([batch.dt.new_zeros(1), batch.dt[row].cumsum(0)[:-1]])[used].cpu()
    with journal():
        figure = new_figure(2.2)
        axes = figure.subplots()
        axes.plot(time, batch.y[row, used, column].cpu(), color=GREY, lw=2.4, alpha=0.75, label="measured")
        axes.plot(
            time, snapshot.simulated[row, used, column].cpu(), color=COLOURS[0], lw=1.0, label="simulated"
        )
        axes.set(xlabel="time [s]", ylabel=label(name, ""), title=batch.names[row])
        axes.legend()
    return figure

"""A cell of an ablation in TensorBoard: its course, its settings and its final figures, one run a cell."""

from __future__ import annotations

import math
import shutil
import tempfile
from pathlib import Path

from torch.utils.tensorboard.writer import SummaryWriter

from hybrid_id.study.ablation_cell import CellResult
from hybrid_id.study.ablation_plan import Split


def write_cell_events(folder: Path, result: CellResult) -> None:
    """Write the run of a cell that is done, in place of an earlier one; it appears when it is whole.

    Tags as in :class:`hybrid_id.reporting.tensorboard.TrainingLog`; metrics ``final/...`` for the table of
    hyper-parameters, errors as RMS of the weighted free run.

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
    metrics: dict[str, float] = {}  # TensorBoard shows the first few
    if result.split is not None:
        sets = {"test": "test", "out_of_range": "beyond", "validation": "validation", "train": "train"}
        metrics |= {name: _error(best.errors, result.split, records) for name, records in sets.items()}
    metrics |= {"share": best.share, "overlap": best.overlap, "price": best.price, "seconds": result.seconds}
    finite = {f"final/{name}": value for name, value in metrics.items() if math.isfinite(value)}
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".") as temporary:
        new = Path(temporary) / "new"
        with SummaryWriter(str(new)) as writer:
            for tag, course in result.history.items():
                for step, value in course:
                    writer.add_scalar(tag, value, step)
            writer.add_hparams(settings, finite, run_name=".")
        shutil.rmtree(place, ignore_errors=True)
        new.replace(place)


def _error(errors: dict[str, float], split: Split, records: str) -> float:
    square = [errors[name] ** 2 for name in getattr(split, records)]
    return math.sqrt(sum(square) / len(square)) if square else math.nan

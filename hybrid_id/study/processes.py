"""One fit a record, the records shared between processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from joblib import Parallel, delayed

from hybrid_id.identification.fit import fit_records
from hybrid_id.identification.horizons import WHOLE, Horizon, choose_horizon, settled
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.study.fan_out import leave_ctrl_c_to_the_first, whole_pool
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System


def fit_in_processes(
    dataset: Dataset,
    system: System,
    settings: Mapping[str, Any],
    *,
    jobs: int,
    device: str,
    signal_share: float,
    horizon: Horizon | None,
    watch: Callable[[Path | None], None] | None = None,
) -> tuple[list[FitResult], Horizon]:
    """Fit each train record in one of several processes.

    Args:
        dataset: its train records are fitted.
        system: model with start values.
        settings: arguments of :func:`hybrid_id.identification.fit.fit`: engine, options, starts, seed.
        jobs: processes.
        device: torch device.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        horizon: how long the free runs are; None to choose it, see :func:`hybrid_id.study.identify`.
        watch: gets the file whose existence ends all fits after their iteration, and None when they have ended.

    Returns:
        The fits in the order of the records, and the horizon that they were fitted over.
    """
    records = dataset.train
    shares = [range(k, len(records), jobs) for k in range(min(jobs, len(records)))]
    watch = watch or (lambda _: None)
    with TemporaryDirectory() as folder:
        stop = Path(folder) / "stop"

        def fitted(over: Horizon) -> list[FitResult]:
            with whole_pool():
                found: Any = Parallel(n_jobs=jobs)(
                    delayed(fit_share)(dataset, share, system, settings, stop, over, device, signal_share)
                    for share in shares
                )
            by_record = {result.records[0]: result for results in found for result in results}
            return [by_record[record.name] for record in records]

        watch(stop)
        try:
            sets = fitted(horizon or WHOLE)
            if horizon is None:
                batch = batch_of(dataset, system, records, signal_share, "cpu")
                horizon = choose_horizon(system, settings["engine"], batch, sets, options=settings["options"])
                if horizon.kind != "whole":  # stopped before, the sets are those of whole records
                    sets, horizon = (sets, WHOLE) if stop.exists() else (fitted(horizon), horizon)
        finally:
            watch(None)
    return sets, horizon


def fit_share(
    dataset: Dataset,
    share: Sequence[int],
    system: System,
    settings: Mapping[str, Any],
    stop: Path,
    horizon: Horizon,
    device: str,
    signal_share: float,
) -> list[FitResult]:
    """The share of one process, train records by number; it ends early when the file `stop` is there."""
    leave_ctrl_c_to_the_first()
    torch.set_num_threads(1)
    # all records first: the weight of an output that stands still in one is known from the others
    batch = batch_of(dataset, system, dataset.train, signal_share, "cpu").take(torch.tensor(share))
    system = system.to(device)
    whole = batch.to(device)
    part = horizon.cut(system, settings["engine"], whole)
    given: dict[str, Any] = {**settings, "progress": lambda *_: stop.exists()}
    sets = fit_records(system, part, numbers=share, **given)
    return settled(sets, horizon, whole, **{**given, "starts": 1})

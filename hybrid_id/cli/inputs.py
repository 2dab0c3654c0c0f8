"""Loading what a study config names: records as they shall be used, and the model."""

from pathlib import Path
from typing import TYPE_CHECKING

from hybrid_id.cli.console import remark
from hybrid_id.config import Preprocessing, StudyConfig
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.finding import Finding
    from hybrid_id.systems.chain import System

MAX_WARNINGS = 5  # said before a fit; `check` says them all


def load_records(path: Path, preprocessing: Preprocessing | None = None) -> "Dataset":
    """Load a dataset and do to it what the config says."""
    from dataclasses import replace

    from hybrid_id.records.dataset import Dataset
    from hybrid_id.records.dataset_file import common_sample_time
    from hybrid_id.records.resample import resample_record

    dataset, wish = Dataset.load(path), preprocessing or Preprocessing()
    if wish.records is not None:
        dataset = dataset.select(wish.records)
    records = dataset.records
    if wish.between is not None:
        records = tuple(record.between(*wish.between) for record in records)
    if wish.resample is None:
        return replace(dataset, records=records)
    step = (
        wish.resample.sample_time
        or dataset.sample_time
        or common_sample_time(records)
        or records[0].sample_time
    )
    pairs = [
        resample_record(record, step, inputs=wish.resample.inputs, max_gap=wish.resample.max_gap)
        for record in records
    ]
    reports = tuple(report for _, report in pairs)
    return replace(
        dataset, records=tuple(record for record, _ in pairs), sample_time=step, resampling=reports
    )


def refuse_errors(findings: "list[Finding]") -> None:
    """Raise the first finding that makes a fit meaningless, as one sentence."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors:
        more = f" (and {len(errors) - 1} more; see 'hybrid-id check')" if len(errors) > 1 else ""
        raise InputError(errors[0].message + more)


def checked_records(path: Path, preprocessing: Preprocessing) -> "Dataset":
    """Load records for a fit; errors end the command, the worst warnings are said."""
    from hybrid_id.records.quality import check_dataset

    dataset = load_records(path, preprocessing)
    findings = check_dataset(dataset)
    refuse_errors(findings)
    warnings = [finding for finding in findings if finding.severity == "warning"]
    for finding in warnings[:MAX_WARNINGS]:
        remark(f"warning: {finding.message}")
    if len(warnings) - MAX_WARNINGS > 0:
        remark(f"({len(warnings) - MAX_WARNINGS} more: 'hybrid-id check {path}')")
    return dataset


def load_system(config: StudyConfig) -> "System":
    """The model of a study, started at what an earlier stage has found where the study names one."""
    from hybrid_id.systems.model_file import load_model

    system, stage = load_model(config.model), config.previous
    idle = [i.name for i in system.table if i.spec.prior_std is not None and not i.spec.estimate]
    if idle:
        remark(f"the prior of {', '.join(idle)} has no effect, for 'estimate' is false")
    if stage is None:
        return system
    from hybrid_id.systems.stage import carry_over

    previous = load_model(stage.model)
    try:
        return carry_over(system, previous, stage.hold)
    except InputError as error:
        raise InputError(f"previous ({stage.model}): {error}") from None

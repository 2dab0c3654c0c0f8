"""`check`: what the records are worth before anything is fitted to them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hybrid_id.cli.console import out, show
from hybrid_id.cli.inputs import load_records, refuse_errors
from hybrid_id.cli.options import DatasetArgument, JsonOption, ModelOption, ThreadsOption, use_threads
from hybrid_id.config import beside
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.statistics.identifiability import Identifiability


def check(
    dataset: DatasetArgument,
    model: ModelOption = None,
    full: Annotated[bool, typer.Option("--full", help="Show remarks of severity info too.")] = False,
    as_json: JsonOption = False,
    threads: ThreadsOption = 1,
) -> None:
    """Check records: quality, sampling, excitation, and with a model what can be told from them.

    Ends with exit code 0 when there are warnings only, and 2 when a fit would be meaningless.
    """
    from hybrid_id.records.quality import check_dataset

    data = load_records(dataset)
    findings = check_dataset(data)
    path = model or (beside(dataset) if beside(dataset).exists() else None)
    told, contradicted = None, False
    if path is not None:
        use_threads(threads)
        from hybrid_id.records.encoders import check_encoders
        from hybrid_id.records.finding import worst_first
        from hybrid_id.study import check_identifiability, check_start_values
        from hybrid_id.systems.model_file import load_model

        system = load_model(path)
        odd = check_encoders(data, system.gear_ratio)
        contradicted = any(finding.severity == "error" for finding in odd)
        if not contradicted:  # else what the model would do means nothing, and takes its time
            told = check_identifiability(data, system)
            odd += check_start_values(data, system)
        findings = worst_first([*odd, *findings])
    if as_json:
        from hybrid_id.reporting.results import as_json as to_json
        from hybrid_id.reporting.results import check_result

        out().print(to_json("check", check_result(data, findings, told)), markup=False, soft_wrap=True)
        refuse_errors(findings)
        _refuse_nothing(told, path)
        return
    from hybrid_id.reporting.tables import count, findings_list, identifiability_table, records_table

    shown = [
        finding for finding in findings if full or finding.severity != "info" or finding.code == "resampled"
    ]
    show(records_table(data), "", findings_list(shown))
    hidden = len(findings) - len(shown)
    if hidden:
        show(f"({count(hidden, 'remark')} for information: --full)")
    if told is not None:
        show("", f"What these records tell about {path}, at its start values and before any fit:")
        show(identifiability_table(told))
    elif not contradicted:
        show(
            f"no {beside(dataset)}: with a model (docs/formats.md) it is said what these records can tell about it"
        )
    refuse_errors(findings)
    _refuse_nothing(told, path)


def _refuse_nothing(told: "Identifiability | None", path: Path | None) -> None:
    """Raise where the records tell no parameter and no combination of parameters."""
    if told is not None and not told.combinations and not told.claimable.any():
        raise InputError(
            f"the records tell nothing about the parameters of {path}; make new ones in which the drive moves"
        )

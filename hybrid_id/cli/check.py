"""`check`: what the records are worth before anything is fitted to them."""

from typing import Annotated

import typer

from hybrid_id.cli.console import show, show_json
from hybrid_id.cli.inputs import load_records, read_model, refuse_errors
from hybrid_id.cli.options import DatasetArgument, JsonOption, ModelOption, ThreadsOption, use_threads
from hybrid_id.config import beside
from hybrid_id.errors import InputError


def check(
    dataset: DatasetArgument,
    model: ModelOption = None,
    full: Annotated[bool, typer.Option("--full", help="Show remarks of severity info too.")] = False,
    as_json: JsonOption = False,
    threads: ThreadsOption = 1,
) -> None:
    """Check records: quality, sampling, excitation, and with a model which of its parameters they identify.

    Ends with exit code 0 when there are warnings only, and 2 when a fit would be meaningless.
    """
    from hybrid_id.records.quality import check_dataset

    data = load_records(dataset)
    findings = check_dataset(data)
    path = model or (beside(dataset) if beside(dataset).exists() else None)
    identified, based, contradicted = None, None, False
    if path is not None:
        use_threads(threads)
        from hybrid_id.records.quality import check_encoders, worst_first
        from hybrid_id.study import check_base_parameters, check_identifiability, check_start_values

        system = read_model(path)
        odd = check_encoders(data, system.own_ratios)
        contradicted = any(finding.severity == "error" for finding in odd)
        if not contradicted:  # else what the model would do means nothing, and takes its time
            identified = check_identifiability(data, system)
            based = check_base_parameters(data, system) if system.tree is not None else None
            odd += check_start_values(data, system)
        findings = worst_first([*odd, *findings])
    if as_json:
        from hybrid_id.reporting.results import check_result

        show_json("check", check_result(data, findings, identified, based))
    else:
        from hybrid_id.reporting.tables import (
            MOST_ROWS,
            base_parameters_table,
            count,
            findings_list,
            identifiability_table,
            records_table,
        )

        shown = [one for one in findings if full or one.severity != "info" or one.code == "resampled"]
        show(records_table(data), "", findings_list(shown))
        if hidden := len(findings) - len(shown):
            show(f"({count(hidden, 'remark')} for information: --full)")
        if identified is not None:
            show("", f"What these records identify of {path}, at its start values and before any fit:")
            show(identifiability_table(identified))
            if based is not None:
                show(
                    "",
                    "What any motion can say of the robot's masses and inertias, and what these records do:",
                )
                show(base_parameters_table(based, 0 if full else MOST_ROWS))
        elif not contradicted:
            show(
                f"no {beside(dataset)}: with a model (docs/formats.md), check says which of its parameters these "
                "records identify"
            )
    refuse_errors(findings)
    if identified is not None and not identified.combinations and not identified.claimable.any():
        raise InputError(f"the records identify nothing of {path}; make new ones in which the drive moves")

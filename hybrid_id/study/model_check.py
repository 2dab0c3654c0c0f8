"""What records say of a model before any fit: contradictions first, and only without them what is identifiable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.study.base_parameters import BaseParameterCheck, check_base_parameters
from hybrid_id.study.checks import check_identifiability, check_scales, check_start_values
from hybrid_id.systems.chain import System

CONTRADICT = ("unit", "sign")
"""Codes of findings after which no table may follow: it would be confident of what means nothing."""


@dataclass(frozen=True)
class ModelCheck:
    """Result of :func:`check_model`.

    Attributes:
        findings: what is wrong, or may be.
        identified: what the records identify of the model; None where they contradict it.
        based: base parameters of a robot; None where records and model contradict each other, and for other systems.
    """

    findings: tuple[Finding, ...]
    identified: Identifiability | None = None
    based: BaseParameterCheck | None = None


def check_model(
    dataset: Dataset, system: System, progress: Callable[[str], object] = lambda _: None
) -> ModelCheck:
    """Check a model against records: first what costs nothing, then a simulation, then what is identifiable.

    Args:
        dataset: the records.
        system: the model with its start values.
        progress: called with words before each slow step.

    Raises:
        InputError: nothing to estimate, missing channels, or no joint moves.
    """
    found = check_scales(dataset, system)
    if any(finding.severity == "error" for finding in found):
        return ModelCheck(tuple(found))  # what the model would do means nothing, and takes its time
    progress("free runs with the start values")
    found += check_start_values(dataset, system)
    if any(finding.code in CONTRADICT for finding in found):
        return ModelCheck(tuple(found))
    progress("what is identifiable")
    identified = check_identifiability(dataset, system)
    if system.tree is None:
        return ModelCheck(tuple(found), identified)
    progress("base parameters")
    return ModelCheck(tuple(found), identified, check_base_parameters(dataset, system))

"""One result of a check, with its severity."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    Attributes:
        severity: `error` (a fit would be meaningless), `warning` (it may be wrong) or `info`.
        code: Short name of the check, to filter by.
        message: A sentence that names record and channel and says what to do.
        record: Name of the record; empty for the dataset as a whole.
        channel: Name of the channel, where there is one.
    """

    severity: Severity
    code: str
    message: str
    record: str = ""
    channel: str = ""


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Errors, then warnings, then what is only worth knowing; otherwise in the order of the checks."""
    return sorted(findings, key=lambda finding: ("error", "warning", "info").index(finding.severity))

"""Our side of the comparison, through the package's public interface only. To be filled when the engine exists.

The same four entries as the peers have, so that `run.py` treats everybody alike.
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.reference import Estimate, Problem


def prepare(problem: Problem, *, compiled: bool = False) -> Callable[[Problem], Estimate]:
    """Builds what can be built before the records are known (model, compiled step); timed apart as "build".

    compiled: the opt-in compiled step; else eager.

    Returns:
        solve(problem): one parameter set a record from `problem.starts`, smooth law tanh(v / 0.5), RK4 with four
        sub-steps, until `reference.STOP` and `reference.DECREMENT` are met; (R, 12) in the order of
        `reference.PARAMETERS`, and the estimated start states (R, 2).
    """
    raise NotImplementedError


def gradient_seconds(problem: Problem) -> float:
    """Seconds per record of one gradient of the loss by all parameters, in the batch of all records."""
    raise NotImplementedError


def fit_case(folder: str) -> dict[str, float]:
    """Re-fits a gap case on its train records from the nominal values, all identifiable combinations free.

    Returns:
        seconds (reading the files apart), free_parameters, nominal and refit: the normalised error on the test records.
    """
    raise NotImplementedError

"""What every baseline answers with, in the form of ``diagnosis.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.errors_on_test import errors, shrink
from hybrid_id.diagnosis.fits import engine
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System


def named(name: str, where: str, probability: float, *, selected: bool = False) -> dict[str, Any]:
    """One effect of the ranking."""
    return {
        "name": name, "where": where, "probability": round(float(probability), 4), "tied_with": [],
        "parameters": {}, "selected": selected,
    }  # fmt: skip


def answer(
    case: str, effects: Sequence[Mapping[str, Any]], gap: Mapping[str, Any], *, unknown: bool = False
) -> dict[str, Any]:
    """The answer of a baseline.

    Args:
        case: name of the dataset.
        effects: by :func:`named`, best first.
        gap: by :func:`gap_of`, or without figures where a method has no model to simulate.
        unknown: whether it says that something outside the catalogue acts.
    """
    found = any(effect["selected"] for effect in effects)
    wrong = bool(gap) and gap["nominal"] >= CRITERIA.wrong_values * gap["refit"]
    silent = "parameters_only" if wrong else "no_gap"
    verdict = "outside_catalogue" if unknown else "effects" if found else silent
    return {
        "case": case,
        "verdict": verdict,
        "unknown": unknown,
        "no_gap": verdict == silent,
        "effects": list(effects),
        "ties": [],
        "gap": dict(gap),
    }


def gap_of(dataset: Dataset, nominal: System, before: System, after: System) -> dict[str, Any]:
    """Errors on the test records of the nominal model, of its re-fit, and of the model that a baseline stands by.

    Args:
        dataset: with test records, else nothing is known.
        nominal: the model as it was given.
        before: its re-fit.
        after: the corrected one, fitted.
    """
    given, first, last = (errors(dataset, one, engine()) for one in (nominal, before, after))
    if given is None or first is None or last is None:
        return {}
    closed = shrink(first, last, min(last.noise, last.nrmse))
    return {
        "nominal": given.nrmse, "refit": first.nrmse, "with_effect": last.nrmse, "noise_floor": closed.floor,
        "shrink": closed.share, "shrink_interval": list(closed.interval),
    }  # fmt: skip

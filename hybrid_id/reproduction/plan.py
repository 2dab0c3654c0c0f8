"""What is reproduced: the stages and closed loops of `configs/reproduce.yaml`, whole or in short."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat

from hybrid_id.errors import InputError
from hybrid_id.records.yaml_file import read_yaml, validate

NAME = "reproduce.yaml"
QUICK_RECORDS, QUICK_LENGTH, QUICK_TRACKING = 2, 1.0, 1.2

Sines = list[tuple[PositiveFloat, PositiveFloat]]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StagePlan(_Section):
    """One stage of the identification.

    Attributes:
        title: what it is called on the page.
        twin: settings of the machine.
        knowledge: twin whose experiments and model are used in place of the machine's own.
        hold: earlier stage -> parameters that keep its value, name here -> name there.
        expect: earlier stage -> parameters whose prior it gives, the same.
    """

    title: str
    twin: str
    knowledge: str | None = None
    hold: dict[str, dict[str, str]] = {}
    expect: dict[str, dict[str, str]] = {}


class TrackingPlan(_Section):
    """Gains, limits and references of the closed loops; see the file."""

    bandwidth: PositiveFloat
    limit: PositiveFloat
    cutoff: PositiveFloat
    duration: PositiveFloat
    fade: PositiveFloat
    inertia_error: float = Field(gt=0, lt=1)
    cases: dict[str, list[Sines]]


class Plan(_Section):
    """All of the file."""

    stages: dict[str, StagePlan]
    tracking: TrackingPlan


def config_folder() -> Path:
    """Where the shipped settings lie: in the installed package, or beside it in a checkout.

    Raises:
        InputError: they are in neither place.
    """
    package = Path(__file__).parents[1]
    for folder in (package / "configs", package.parent / "configs"):
        if (folder / NAME).exists():
            return folder
    raise InputError(f"{NAME} is missing beside the package in {package}; install hybrid_id again")


def read_plan(*, quick: bool) -> Plan:
    """The plan, shortened where a look at everything is enough."""
    path = config_folder() / NAME
    plan = validate(Plan, read_yaml(path), path)
    if not quick:
        return plan
    return plan.model_copy(
        update={"tracking": plan.tracking.model_copy(update={"duration": QUICK_TRACKING, "fade": 0.5})}
    )


def twin_settings(plan: StagePlan, *, quick: bool) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Settings of a stage's machine with the stage's experiments, and the settings that its model comes from."""
    twin = read_yaml(config_folder() / plan.twin)
    knowledge = read_yaml(config_folder() / plan.knowledge) if plan.knowledge else twin
    twin["excitation"] = dict(knowledge["excitation"])
    if quick:
        plans = twin["excitation"]["experiments"][:QUICK_RECORDS]
        twin["excitation"]["experiments"] = [_shortened(plan, QUICK_LENGTH - twin["rest"]) for plan in plans]
        twin["duration"] = QUICK_LENGTH
    return twin, knowledge if plan.knowledge else twin


def _shortened(experiment: Mapping[str, Any], period: float) -> dict[str, Any]:
    """An experiment with no more tones than a short period [s] holds."""
    if "band" not in experiment:
        return {k: _shortened(v, period) if isinstance(v, dict) else v for k, v in experiment.items()}
    low, high = experiment["band"]
    room = int(high * period) - int(low * period)
    return {
        **experiment,
        "band": [low, max(high, 2.0 / period)],
        "tones": max(1, min(experiment["tones"], room)),
    }

"""The whole campaign: every stage and closed loop, each kept in a file as soon as it is done."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hybrid_id import __version__
from hybrid_id.identification.fit import Progress
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.reproduction.claims import Claim, claims
from hybrid_id.reproduction.comparison import FitRow, ParameterRow, fit_rows, inertia_rows, parameter_rows
from hybrid_id.reproduction.curves import Curve, Preprocessed, friction_curve, link_friction_curve, preprocess
from hybrid_id.reproduction.plan import Plan, config_folder, read_plan, twin_settings
from hybrid_id.reproduction.result import StageResult, TrackingResult, load, save
from hybrid_id.reproduction.stages import Found, records_of, run_stage
from hybrid_id.reproduction.tracking import compare_gears, compare_models
from hybrid_id.systems.model_file import load_model, save_model

GEARS = {"rigid": "link1_stiff", "backlash-flexible": "link1_flexible"}
MACHINES = {"one_link": "link1", "both_links": "both_links", "backlash": "link1_flexible"}
"""The stage whose machine a closed loop drives."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All results.

    Attributes:
        stages: by name.
        truths: the parameters of each stage's machine.
        tracking: closed loops by case.
        record: one record of link 1, preprocessed.
    """

    stages: Mapping[str, StageResult]
    truths: Mapping[str, Mapping[str, float]]
    tracking: Mapping[str, TrackingResult]
    record: Preprocessed

    @property
    def claims(self) -> list[Claim]:
        """What was to be shown, and what was seen."""
        return claims(self.stages, self.truths, self.tracking)

    @property
    def inertia(self) -> dict[str, ParameterRow]:
        """Table 12: the second link's inertia as each stage identifies it."""
        return inertia_rows(self.stages, self.truths)

    def parameters(self, stage: str) -> list[ParameterRow]:
        """A stage's table of parameters, ours beside the printed."""
        return parameter_rows(stage, self.stages[stage], self.truths[stage])

    def fits(self, stage: str) -> list[FitRow]:
        """A stage's table of fits, ours beside the printed."""
        return fit_rows(stage, self.stages[stage])

    def friction(self, stage: str, label: str, motor: str = "") -> Curve:
        """A stage's friction at the motor over velocity, with its truth."""
        return friction_curve(label, self.stages[stage], self.truths[stage], motor=motor)

    def link_friction(self, stage: str) -> Curve:
        """A stage's friction at the link over velocity, with its truth."""
        return link_friction_curve(self.stages[stage])


def reproduce(
    folder: Path,
    *,
    quick: bool = False,
    seeds: int = 20,
    program: str = __version__,
    say: Callable[[str], None] = print,
    progress: Progress | None = None,
) -> Reproduction:
    """Walk through the paper.

    Args:
        folder: keeps each result as it is done; what an earlier run left there from the same settings is not
            computed again.
        quick: two short records a stage.
        seeds: runs of each closed loop.
        program: that computes; what another one has kept is computed again.
        say: gets what comes next.
        progress: called after each iteration of a fit.
    """
    plan = read_plan(quick=quick)
    truths = {name: read_yaml(config_folder() / stage.twin)["truth"] for name, stage in plan.stages.items()}
    record = preprocess(records_of(plan.stages["link1"], quick=quick)[0].records[0])
    stages: dict[str, Found] = {}
    for number, (name, stage) in enumerate(plan.stages.items(), start=1):
        head = f"{number} of {len(plan.stages)}: {stage.title}"
        key = _key(plan, name, stages, quick) | {"program": program}
        kept, model = load(StageResult, folder / f"{name}.json", key), folder / f"{name}.yaml"
        if kept is not None and model.exists():
            say(f"{head}: kept from before")
            stages[name] = kept, load_model(model)
            continue
        say(head)
        stages[name] = run_stage(stage, stages, quick=quick, progress=progress)
        model.unlink(missing_ok=True)  # a kill between the two leaves no model beside another run's result
        save(stages[name][0], folder / f"{name}.json", key)
        save_model(stages[name][1], model)
    tracking = {
        case: _closed_loop(folder, plan, case, stages, seeds, quick, program, say)
        for case in plan.tracking.cases
    }
    return Reproduction({name: found[0] for name, found in stages.items()}, truths, tracking, record)


def _closed_loop(
    folder: Path,
    plan: Plan,
    case: str,
    stages: Mapping[str, Found],
    seeds: int,
    quick: bool,
    program: str,
    say: Any,
) -> TrackingResult:
    machine = MACHINES[case]
    used = list(GEARS.values()) if case == "backlash" else [machine]
    key = {"models": [_values(stages[name]) for name in used], "plan": plan.tracking.model_dump(mode="json")}
    key |= {
        "program": program,
        "seeds": seeds,
        "machine": _digest(twin_settings(plan.stages[machine], quick=quick)[0]),
    }
    path = folder / f"tracking_{case}.json"
    if (kept := load(TrackingResult, path, key)) is not None:
        say(f"tracking, {case.replace('_', ' ')}: kept from before")
        return kept
    say(f"tracking, {case.replace('_', ' ')}: {seeds} seeds")
    config = twin_settings(plan.stages[machine], quick=quick)[0]
    if case == "backlash":
        models = {label: stages[name][1] for label, name in GEARS.items()}
        result = compare_gears(plan.tracking, config, models, range(seeds))
    else:
        result = compare_models(plan.tracking, case, config, stages[machine][1], range(seeds))
    save(result, path, key)
    return result


def _key(plan: Plan, name: str, stages: Mapping[str, Found], quick: bool) -> dict[str, Any]:
    """All that decides a stage's result."""
    stage = plan.stages[name]
    return {
        "stage": stage.model_dump(mode="json"),
        "settings": _digest(twin_settings(stage, quick=quick)),
        "earlier": {name: _values(stages[name]) for name in sorted({*stage.hold, *stage.expect})},
    }


def _values(found: Found) -> dict[str, float]:
    return {info.name: info.spec.value for info in found[1].table}


def _digest(settings: Any) -> str:
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()

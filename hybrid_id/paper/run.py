"""The whole campaign: every stage and closed loop, each kept in a file as soon as it is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import Progress
from hybrid_id.identification.keep import digest_of
from hybrid_id.paper.comparison import Claim, claims
from hybrid_id.paper.stages import Stage, StageResult, read_plan, run_stage, twin_settings
from hybrid_id.paper.tracking import TrackingResult, compare_controllers
from hybrid_id.paper.twin import make_campaign
from hybrid_id.reading import read_object
from hybrid_id.records.files import write_json
from hybrid_id.records.record import Record
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

CASES = {
    "one_link": ("link1", {"identified": "link1"}),
    "both_links": ("both_links", {"identified": "both_links"}),
    "backlash": ("link1_flexible", {"rigid": "link1_stiff", "backlash-flexible": "link1_flexible"}),
}
"""The stage whose machine a closed loop drives, and the stages whose models control it, by the models' names."""
Result = TypeVar("Result", StageResult, TrackingResult)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All results.

    Attributes:
        stages: by name.
        tracking: closed loops by case.
        record: one record of link 1.
    """

    stages: Mapping[str, StageResult]
    tracking: Mapping[str, TrackingResult]
    record: Record

    @property
    def claims(self) -> list[Claim]:
        """What was to be shown, and what was seen."""
        return claims(self.stages, self.tracking)


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
    stages: dict[str, Stage] = {}
    for number, (name, stage) in enumerate(plan["stages"].items(), start=1):
        settings, model = twin_settings(stage, quick=quick), folder / f"{name}.yaml"
        earlier = {
            other: _values(stages[other][1]) for key in ("hold", "expect") for other in stage.get(key, {})
        }
        made_from = digest_of((program, stage, settings, earlier))
        head = f"{number} of {len(plan['stages'])}: {stage['title']}"
        kept = _kept(StageResult, folder / f"{name}.json", made_from) if model.exists() else None
        if kept is not None:
            say(f"{head}: kept from before")
            stages[name] = kept, load_model(model)
            continue
        say(head)
        stages[name] = run_stage(stage, stages, quick=quick, progress=progress)
        model.unlink(missing_ok=True)  # a kill between the two leaves no model beside another run's result
        _keep(stages[name][0], folder / f"{name}.json", made_from)
        save_model(stages[name][1], model)
    tracking = {}
    for case in plan["tracking"]["cases"]:
        machine, models = CASES[case]
        config = twin_settings(plan["stages"][machine], quick=quick)[0]
        systems = {label: stages[name][1] for label, name in models.items()}
        values = {label: _values(system) for label, system in systems.items()}
        made_from = digest_of((program, plan["tracking"], config, values, seeds))
        head, path = f"tracking, {case.replace('_', ' ')}", folder / f"tracking_{case}.json"
        kept = _kept(TrackingResult, path, made_from)
        say(f"{head}: {f'{seeds} seeds' if kept is None else 'kept from before'}")
        tracking[case] = kept or compare_controllers(plan["tracking"], case, config, systems, range(seeds))
        if kept is None:
            _keep(tracking[case], path, made_from)
    dataset, _ = make_campaign(twin_settings(plan["stages"]["link1"], quick=quick)[0], 0)
    return Reproduction({name: result for name, (result, _) in stages.items()}, tracking, dataset.records[0])


def _values(system: System) -> dict[str, float]:
    return {info.name: info.spec.value for info in system.table}


def _keep(result: StageResult | TrackingResult, path: Path, made_from: str) -> None:
    write_json(
        path, {"program": f"hybrid_id {__version__}", "made_from": made_from, "result": asdict(result)}
    )


def _kept(kind: type[Result], path: Path, made_from: str) -> Result | None:
    """The result in a file; None where there is none, or where it was made from something else."""
    try:
        content = read_object(path, "result of a stage")
        if content["made_from"] != made_from:
            return None
        values = dict[str, Any]()
        for field in fields(kind):
            value = content["result"][field.name]
            if field.type == "np.ndarray":
                value = np.array(value, dtype=float)  # JSON says null for what is infinite or not a number
            values[field.name] = tuple(value) if str(field.type).startswith("tuple") else value
        if "std_error" in values:
            values["std_error"] = np.nan_to_num(values["std_error"], nan=np.inf)
        return kind(**values)
    except (OSError, InputError, ValueError, KeyError, TypeError):
        return None

"""The whole campaign: every stage and closed loop, each kept in a file as soon as it is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hybrid_id import __version__
from hybrid_id.identification.fit import Progress
from hybrid_id.identification.keep import digest_of
from hybrid_id.paper.comparison import Claim, claims
from hybrid_id.paper.stages import Stage, StageResult, read_plan, run_stage, twin_settings
from hybrid_id.paper.tracking import TrackingResult, compare_controllers
from hybrid_id.paper.twin import make_campaign
from hybrid_id.records.record import Record
from hybrid_id.study.many import keep, kept
from hybrid_id.systems.model_file import load_model, save_model

CASES = {
    "one_link": ("link1", {"identified": "link1"}),
    "both_links": ("both_links", {"identified": "both_links"}),
    "backlash": ("link1_flexible", {"rigid": "link1_stiff", "backlash-flexible": "link1_flexible"}),
}
"""The stage whose machine a closed loop drives, and the stages whose models control it, by the models' names."""


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
        earlier = {other: stages[other][1] for key in ("hold", "expect") for other in stage.get(key, {})}
        made_from = digest_of((program, stage, settings, earlier))
        head = f"{number} of {len(plan['stages'])}: {stage['title']}"
        if model.exists() and (result := kept(folder / f"{name}.json", StageResult, made_from)):
            say(f"{head}: kept from before")
            stages[name] = result, load_model(model)
            continue
        say(head)
        stages[name] = run_stage(stage, stages, quick=quick, progress=progress)
        model.unlink(missing_ok=True)  # a kill between the two leaves no model beside another run's result
        keep(folder / f"{name}.json", stages[name][0], made_from)
        save_model(stages[name][1], model)
    tracking = {}
    for case in plan["tracking"]["cases"]:
        machine, models = CASES[case]
        config = twin_settings(plan["stages"][machine], quick=quick)[0]
        systems = {label: stages[name][1] for label, name in models.items()}
        made_from = digest_of((program, plan["tracking"], config, systems, seeds))
        head, path = f"tracking, {case.replace('_', ' ')}", folder / f"tracking_{case}.json"
        result = kept(path, TrackingResult, made_from)
        say(f"{head}: {'kept from before' if result else f'{seeds} seeds'}")
        if result is None:
            result = compare_controllers(plan["tracking"], case, config, systems, range(seeds))
            keep(path, result, made_from)
        tracking[case] = result
    dataset, _ = make_campaign(twin_settings(plan["stages"]["link1"], quick=quick)[0], 0)
    return Reproduction({name: result for name, (result, _) in stages.items()}, tracking, dataset.records[0])

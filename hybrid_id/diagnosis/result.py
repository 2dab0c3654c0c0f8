"""The diagnosis: where the gap between records and simulator lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from hybrid_id.diagnosis.attribute import Attribution
from hybrid_id.diagnosis.course import Course, acts_at
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.measure import Errors
from hybrid_id.diagnosis.next_experiment import Experiment
from hybrid_id.diagnosis.probability import Suspect
from hybrid_id.diagnosis.shrink import Shrink
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`hybrid_id.diagnose`.

    Attributes:
        case: name of the dataset.
        verdict: ``effects``, ``parameters_only``, ``no_gap``, ``outside_catalogue`` or ``inconclusive``.
        effects: every effect that was tried, the selected ones first, then by probability.
        ties: groups of effects that these records cannot tell apart.
        unknown: whether something acts that the catalogue lacks.
        nominal, refit, with_effect: errors on the test records of today's model, the re-fitted and the corrected one;
            None without test records.
        shrink: how far the gap shrinks; None without test records.
        where: torques that would explain what the re-fitted model leaves, best first.
        left: the same for the corrected model.
        bent: parameters that the re-fit has bent beyond what data sheets get wrong, in words.
        varying: parameters that differ from record to record, in words, where each record's own values leave noise and
            one common set does not; the chosen model then has the set of the record that fits the others best.
        halted: whether free runs over the test records halt at other detents than the machine, while the corrected
            model follows them from measured states as closely as the train records.
        withdrawn: effects that the train records called for, in words, and whose gain on the test records is not sure.
        vague: least standard error, relative, of what these records tell of the parameters of today's model, where no
            effect is named; 0 elsewhere.
        courses: where something outside the catalogue acts, what a torque of any course would explain at each side of
            each joint, best first.
        outvoted: effects that explain the train records as well as the selected ones, in words, and predict the test
            records surely worse.
        untold: changes of the chosen model's parameters that these records do not see, in words.
        together: facts of the records (a controller's gain, the temperature) that change together, in words.
        beyond: test records that go where no train record has been, in words.
        opened: name of the test record that the search has seen because the train records show too little, so that
            errors and gap are those of the others; None where it has seen none.
        experiments: records that would tell tied effects apart, the best first; empty without ties.
        search: all that was tried.
    """

    case: str
    verdict: str
    effects: tuple[Suspect, ...]
    ties: tuple[tuple[str, ...], ...]
    unknown: bool
    nominal: Errors | None
    refit: Errors | None
    with_effect: Errors | None
    shrink: Shrink | None
    where: tuple[Location, ...]
    left: tuple[Location, ...]
    bent: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    withdrawn: tuple[str, ...]
    untold: tuple[str, ...]
    together: tuple[str, ...]
    beyond: tuple[str, ...]
    search: Attribution = field(repr=False)
    opened: str | None = None
    varying: tuple[str, ...] = ()
    halted: bool = False
    outvoted: tuple[str, ...] = ()
    courses: tuple[Course, ...] = ()
    vague: float = 0.0

    @property
    def selected(self) -> tuple[Suspect, ...]:
        """The effects that the diagnosis stands by."""
        return tuple(s for s in self.effects if s.selected)

    @property
    def model(self) -> System:
        """Today's model, re-fitted, with the selected effects."""
        return self.search.chosen.system

    @property
    def fitted(self) -> dict[str, Explanation]:
        """The models that were fitted: ``re-fitted``, and ``corrected`` where that is another one."""
        same = self.search.chosen is self.search.base
        return {"re-fitted": self.search.base} | ({} if same else {"corrected": self.search.chosen})

    def summary(self) -> str:
        """Verdict, place, effects and gap in a few lines; the command ``diagnose`` says the same in sentences."""
        lines = [f"verdict: {self.verdict}"]
        lines += [
            f"  {one.joint}: {one.signal} explains {100 * one.share:.0f} %"
            for one in self.where[:3]
            if one.share > 0
        ]
        for one in self.effects[:4]:
            reach = ", ".join(
                f"{k} = {v:.4g} ± {1.96 * error:.2g}" for k, (v, error) in one.parameters.items()
            )
            mark = "selected" if one.selected else "tied" if one.tied_with else ""
            lines.append(
                f"  {one.probability:.3f}  {one.name} at {one.where}  {reach if mark else ''}  {mark}".rstrip()
            )
        if self.nominal is not None and self.shrink is not None:
            gap, low, high = self.shrink, *self.shrink.interval
            lines.append(
                f"normalised error on test records: today's {self.nominal.nrmse:.3g}, re-fitted {gap.refit:.3g}, "
                f"corrected {gap.with_effect:.3g}; {100 * gap.share:.0f} % ({100 * low:.0f}-{100 * high:.0f} %) of the "
                "gap closed"
            )
        return "\n".join([*lines, *(f"bent: {one}" for one in self.bent)])

    def as_searched(self, dataset: Dataset) -> Dataset:
        """The records with the roles that they had in the search: a test record may have joined the train records."""
        seen = (replace(r, role="train") if r.name == self.opened else r for r in dataset.records)
        return replace(dataset, records=tuple(seen))

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        gap = self.shrink
        return {
            "case": self.case,
            "verdict": self.verdict,
            "unknown": self.unknown,
            "no_gap": self.verdict in ("no_gap", "parameters_only"),
            "effects": [
                {
                    "name": s.name,
                    "where": s.where,
                    "probability": round(s.probability, 4),
                    "tied_with": list(s.tied_with),
                    "parameters": {k: list(v) for k, v in s.parameters.items()},
                    "selected": s.selected,
                }
                for s in self.effects
            ],
            "ties": [list(group) for group in self.ties],
            "gap": {
                "nominal": None if self.nominal is None else self.nominal.nrmse,
                "refit": None if gap is None else gap.refit,
                "with_effect": None if gap is None else gap.with_effect,
                "noise_floor": None if gap is None else gap.floor,
                "shrink": None if gap is None else gap.share,
                "shrink_interval": None if gap is None else list(gap.interval),
            },
            "location": [
                {
                    "joint": one.joint,
                    "place": one.place,
                    "signal": one.signal,
                    "share": max(one.share, 0.0),
                    "profile": {"signal": one.grid.tolist(), "torque": one.torque.tolist()},
                }
                for one in self.where[:6]
            ],
            "left": [
                {"joint": o.joint, "place": o.place, "signal": o.signal, "share": max(o.share, 0.0)}
                for o in self.left[:3]
            ],
            "unknown_at": dict(zip(("joint", "place"), acts_at(self.courses), strict=True))
            if self.unknown
            else None,
            "courses": [vars(one) for one in self.courses],
            "bent_parameters": list(self.bent),
            "withdrawn": list(self.withdrawn),
            "outvoted": list(self.outvoted),
            "varying_parameters": list(self.varying),
            "cannot_be_told": [*self.untold, *self.together],
            "beyond_training": list(self.beyond),
            "opened": self.opened,
            "halted_elsewhere": self.halted,
            "window": self.search.window,
            "next_experiments": [
                {
                    "name": e.name,
                    "joint": e.joint,
                    "distance": e.distance,
                    "distance_today": e.today,
                    "leaves_together": [list(pair) for pair in e.together],
                }
                for e in self.experiments[:3]
                if e.tells
            ],
        }

"""The diagnosis: where the gap between records and simulator lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hybrid_id.diagnosis.details import Details
from hybrid_id.diagnosis.errors_on_test import Errors, Shrink
from hybrid_id.diagnosis.grade import Interval, RatedEffect
from hybrid_id.diagnosis.locate import Disturbance, Location, acts_at
from hybrid_id.diagnosis.model import FittedModel, Tally
from hybrid_id.diagnosis.next_experiment import Experiment
from hybrid_id.diagnosis.select import Selection
from hybrid_id.identification.horizons import Horizon
from hybrid_id.study.result import as_html
from hybrid_id.systems.by_joint import named
from hybrid_id.systems.chain import System

if TYPE_CHECKING:
    import pandas as pd

LIKELY = 0.2
"""Probability below which an effect that is not selected stands in no table of a page or a notebook."""
EFFECT_COLUMNS = [
    "effect", "where", "probability", "share", "share_lower", "share_upper", "selected", "tied_with", "parameters"
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`hybrid_id.diagnose`.

    Attributes:
        case: name of the dataset.
        verdict: ``effects``, ``parameters_only``, ``no_gap``, ``outside_catalogue`` or ``inconclusive``.
        effects: every effect that was tried, the selected ones first, by their share of the gap.
        ties: groups of effects that these records cannot distinguish.
        unknown: whether something that the catalogue lacks explains at least a tenth of the gap and surely as much as
            all selected effects; at a joint of a robot, surely a tenth.
        remainder: structural share of the gap that stays unexplained, on records left out.
        remainder_interval: 95 % interval.
        beyond_floor: share of the re-fitted model's mean square error on records left out that is the gap.
        horizon: how long the free runs are over which models were fitted and compared, here and on the test records.
        sample_time: of the records as they were fitted, thinned where that loses nothing [s]; None if they share none.
        nominal, refit, with_effect: errors on the test records of the nominal, the re-fitted and the corrected model;
            None without test records.
        shrink: how far the gap shrinks; None without test records.
        contradiction: where the test records contradict the answer, in a sentence; empty elsewhere.
        rest_differs: whether free runs over the test records stick at other rest positions than the machine, while the
            corrected model follows them from measured states.
        location: torques that would explain what the re-fitted model leaves, best first.
        residual_after: the same for the corrected model.
        implausible: parameters that the re-fit has moved beyond data-sheet tolerance, in words.
        experiments: records that together would distinguish tied effects, the best first; empty without ties.
        rejected: effects that were accepted by the search and are not sure enough to be asserted, in words, each with
            the record without which it predicts no better (empty where there is none).
        varying: parameters that differ from record to record, in words, where each record's own values leave noise and
            one common set does not; the chosen model then has the set of the record that fits the others best.
        not_identifiable: changes of the chosen model's parameters that these records do not see, in words.
        confounded: signals of the records (a controller's gain, the temperature) that change together, in words.
        extrapolation: test records that go where no train record has been, in words.
        disturbances: where something outside the catalogue acts, what a torque of arbitrary shape in time would
            explain at each side of each joint, best first.
        relative_std: smallest relative standard error of what these records identify of the nominal model, where no
            effect is named; 0 elsewhere.
        disturbances_before: the same of the re-fitted model, where an effect is named and there are several joints.
        skews: channels that are recorded late against others, in words; the diagnosis has shifted them.
        changes: which physical change explains the new parameter values, in a sentence; empty where none does.
        tally: how many fits the search has tried, and why some failed.
        search: all that was tried.
        details: maps, reversals, parameter statistics and tests of residuals, each computed when first asked for, or
            all by its ``compute()``.
    """

    case: str
    verdict: str
    effects: tuple[RatedEffect, ...]
    ties: tuple[tuple[str, ...], ...]
    unknown: bool
    remainder: float
    remainder_interval: Interval
    beyond_floor: float
    horizon: Horizon
    sample_time: float | None
    nominal: Errors | None
    refit: Errors | None
    with_effect: Errors | None
    shrink: Shrink | None
    contradiction: str
    rest_differs: bool
    location: tuple[Location, ...]
    residual_after: tuple[Location, ...]
    implausible: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    rejected: Mapping[str, str]
    varying: tuple[str, ...]
    not_identifiable: tuple[str, ...]
    confounded: tuple[str, ...]
    extrapolation: tuple[str, ...]
    disturbances: tuple[Disturbance, ...]
    disturbances_before: tuple[Disturbance, ...]
    relative_std: float
    changes: str
    skews: tuple[str, ...]
    tally: Tally
    search: Selection = field(repr=False)
    details: Details = field(repr=False)

    @property
    def interrupted(self) -> bool:
        """Whether the search was stopped before its end, so that the answer holds what had been found until then."""
        return self.search.interrupted

    @property
    def selected(self) -> tuple[RatedEffect, ...]:
        """The effects that the diagnosis asserts."""
        return tuple(s for s in self.effects if s.selected)

    @property
    def corrected(self) -> bool:
        """Whether there is a corrected model: with effects, beside the re-fitted one."""
        return "corrected" in self.fitted

    @property
    def model(self) -> System:
        """The nominal model, re-fitted, with the selected effects."""
        return self.search.chosen.system

    @property
    def fitted(self) -> dict[str, FittedModel]:
        """The models that were fitted: ``re-fitted``, and ``corrected`` where that is another one."""
        return self.search.fitted

    def _named(self, where: str) -> str:
        """A place with the joint's name in the robot that the system is one joint of."""
        return named(self.model, where)

    @property
    def _shown(self) -> list[RatedEffect]:
        """The effects with their places as files and tables have them."""
        return [
            replace(one, where=self._named(one.where), tied_with=tuple(map(self._named, one.tied_with)))
            for one in self.effects
        ]

    def table(self) -> pd.DataFrame:
        """The effects that were tried, one row each, the selected ones first.

        Columns: ``effect``, ``where``, ``probability``, ``share`` of the gap with ``share_lower`` and ``share_upper``
        (NaN where it was not asked for), ``selected``, ``tied_with`` (the effects that these records cannot distinguish
        from it) and ``parameters`` (symbol to value; their intervals are those of ``details.studies[-1].table()``).
        """
        import pandas as pd

        nothing = (math.nan, math.nan)
        rows = [
            {
                "effect": one.name,
                "where": one.where,
                "probability": one.probability,
                "share": math.nan if one.share is None else one.share,
                "share_lower": (one.share_interval or nothing)[0],
                "share_upper": (one.share_interval or nothing)[1],
                "selected": one.selected,
                "tied_with": list(one.tied_with),
                "parameters": {symbol: value for symbol, (value, _) in one.parameters.items()},
            }
            for one in self._shown
        ]
        return pd.DataFrame(rows, columns=EFFECT_COLUMNS)

    def _repr_html_(self) -> str:
        """What a notebook shows: the effects that are selected or likely."""
        table = self.table()
        shown = table.loc[table["selected"] | (table["probability"] >= LIKELY)]
        return as_html(f"{self.case}: {self._heading}", shown, [self._unexplained, *self._remarks])

    @property
    def _heading(self) -> str:
        return f"verdict: {self.verdict}{' (interrupted)' if self.interrupted else ''}"

    @property
    def _unexplained(self) -> str:
        low, high = self.remainder_interval
        return f"unexplained: {100 * self.remainder:.0f} % of the gap ({100 * low:.0f}-{100 * high:.0f} %)"

    @property
    def _remarks(self) -> list[str]:
        """What a page says below the effects."""
        lines = [f"implausible: {one}" for one in self.implausible]
        if self.nominal is not None and self.shrink is not None:
            gap, (low, high) = self.shrink, (f"{100 * end:.0f}" for end in self.shrink.interval)
            closed = f", corrected {gap.with_effect:.3g}; shrink {100 * gap.share:.0f} % ({low}-{high} %)"
            lines.insert(
                0,
                f"NRMSE on the test records, mean of the outputs: nominal {self.nominal.nrmse:.3g}, re-fitted "
                f"{gap.refit:.3g}{closed if self.corrected else '; there is no corrected model'}",
            )
        return lines

    def summary(self) -> str:
        """Verdict, place, effects and gap in a few lines; the command ``diagnose`` says the same in sentences."""
        lines = [self._heading]
        for one in self._shown[:4]:
            share = "" if one.share is None else f"  {100 * one.share:.0f} % of the gap"
            values = ", ".join(f"{k} = {v:.4g}" for k, (v, _) in one.parameters.items())
            mark = "selected" if one.selected else "indistinguishable" if one.tied_with else ""
            lines.append(
                f"  {one.probability:.3f}{share}  {one.name} at {one.where}  {values if mark else ''}  {mark}".rstrip()
            )
        return "\n".join([*lines, f"  {self._unexplained}", *self._remarks])

    @property
    def proposed(self) -> tuple[Experiment, ...]:
        """The records to make next: those of :attr:`experiments`, if all of them together distinguish anything."""
        return self.experiments if self.experiments and self.experiments[-1].distinguishes else ()

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        unknown_at = acts_at(self.disturbances) if self.unknown else None
        return {
            "case": self.case,
            "verdict": self.verdict,
            "interrupted": self.interrupted,
            "unknown": self.unknown,
            "no_gap": self.verdict in ("no_gap", "parameters_only"),
            "effects": [effect_entry(one) for one in self._shown],
            "ties": [[self._named(name) for name in group] for group in self.ties],
            "remainder": {"share": self.remainder, "interval": list(self.remainder_interval)},
            "horizon": self.horizon.as_dict(),
            "sample_time": self.sample_time,
            "gap": gap_entry(self.nominal, self.refit, self.with_effect, self.shrink, self.contradiction)
            | {"rest_positions_differ": self.rest_differs},
            "location": [
                self._location(one) | {"profile": {"signal": one.grid.tolist(), "torque": one.torque.tolist()}}
                for one in self.location[:6]
            ],
            "residual_after": [self._location(one) for one in self.residual_after[:3]],
            "unknown_location": unknown_at and self._sided(*unknown_at),
            "disturbance_location": [
                self._sided(one.joint, one.side) | {"share": one.share, "behind": one.behind}
                for one in self.disturbances
            ],
            "changes": self.changes,
            "implausible_parameters": list(self.implausible),
            "rejected": [self._named(one) for one in self.rejected],
            "rejected_rests_on": {self._named(one): at for one, at in self.rejected.items() if at},
            "between_record_variation": list(self.varying),
            "not_identifiable": [*self.not_identifiable, *self.confounded],
            "skews": list(self.skews),
            "extrapolation": list(self.extrapolation),
            "next_experiments": [
                {
                    "name": e.name,
                    "posture": e.posture,
                    "joint": e.joint,
                    "distance": e.distance,
                    "confounded": [[self._named(name) for name in pair] for pair in e.undistinguished],
                }
                for e in self.proposed
            ],
        }  # fmt: skip

    def _location(self, one: Location) -> dict[str, Any]:
        return self._sided(one.joint, one.side) | {"signal": one.signal, "share": max(one.share, 0.0)}

    def _sided(self, joint: str | None, side: str | None) -> dict[str, Any]:
        """A joint and a side of its gear."""
        return {"joint": joint and self._named(joint), "side": side}


def gap_entry(
    nominal: Errors | None,
    refit: Errors | None,
    with_effect: Errors | None,
    gap: Shrink | None,
    contradiction: str,
) -> dict[str, Any]:
    """The entry ``gap`` of ``diagnosis.json``: errors of the three models on the test records, and the shrink."""
    return {
        "nominal": None if nominal is None else nominal.nrmse,
        "refit": None if gap is None else gap.refit,
        "with_effect": None if gap is None else gap.with_effect,
        "noise_floor": None if gap is None else gap.floor,
        "floor_by_repeats": gap is not None and gap.repeated,
        "shrink": None if gap is None else gap.share,
        "shrink_interval": None if gap is None else list(gap.interval),
        "by_output": {
            name: {"nominal": nominal.by_output[name], "refit": value, "with_effect": with_effect.by_output[name],
                   "rmse": {"nominal": nominal.rmse[name], "refit": refit.rmse[name],
                            "with_effect": with_effect.rmse[name]}}
            for name, value in refit.by_output.items()
        } if nominal and refit and with_effect else {},
        "contradiction": contradiction,
    }  # fmt: skip


def effect_entry(one: RatedEffect) -> dict[str, Any]:
    """One entry of ``effects`` in ``diagnosis.json``."""
    return {
        "name": one.name,
        "where": one.where,
        "probability": round(one.probability, 4),
        "probability_with_ties": round(one.together, 4),
        "share": one.share,
        "share_interval": None if one.share_interval is None else list(one.share_interval),
        "share_alone": one.alone,
        "tied_with": list(one.tied_with),
        "parameters": {symbol: list(value) for symbol, value in one.parameters.items()},
        "selected": one.selected,
    }

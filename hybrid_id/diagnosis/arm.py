"""A robot of many joints, diagnosed joint by joint: each with the others as measured, then the whole robot corrected.

What a joint lacks shows in its own motion where that of the others is given: the search is linear in the joints, and
where something is missing needs no search. Then all joints are simulated: the corrected robot is fitted once more as a
whole, and the test records measure it, driven by the commands alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from hybrid_id.diagnosis.catalogue import brought
from hybrid_id.diagnosis.common_cause import judged_by_all
from hybrid_id.diagnosis.coupled_gear import CoupledGear, coupled_gears, with_gears
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, answered, reported
from hybrid_id.diagnosis.distinguish import distinguished
from hybrid_id.diagnosis.errors_on_test import Errors, Shrink, errors, shrink, unconfirmed
from hybrid_id.diagnosis.fits import engine
from hybrid_id.diagnosis.grade import RatedEffect, tied_sets
from hybrid_id.diagnosis.own_values import borne_out
from hybrid_id.diagnosis.plausibility import within_reach
from hybrid_id.diagnosis.result import Diagnosis, effect_entry, gap_entry
from hybrid_id.diagnosis.screen import Progress
from hybrid_id.diagnosis.select import MAX_EFFECTS
from hybrid_id.diagnosis.whole_robot import (
    UNFITTED,
    WholeRobot,
    acts_on_all,
    brought_to,
    common_horizon,
    parts_of_gap,
)
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import ParameterInfo
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.skew import Skew, find_skews
from hybrid_id.records.units import number_of
from hybrid_id.statistics.uncertainty import robust_covariance
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.by_joint import (
    asked_parts,
    joint_parts,
    joints_to_diagnose,
    moving_records,
    named,
    part_with,
    some,
    together,
    with_drive,
    with_others_measured,
    with_standing_held,
)
from hybrid_id.systems.chain import System

VERDICTS = ("effects", "outside_catalogue", "parameters_only", "inconclusive", "no_gap")
COUPLED = 10
"""Iterations of the fit of the whole robot, which begins where the joints' own fits have ended."""
NOT_ASKED, STOPPED = "not asked for", "the search was stopped"
"""Why joints are not diagnosed."""


@dataclass(frozen=True)
class CommonSize:
    """An effect that several joints have, and whether its size is one for all of them.

    Attributes:
        effect, symbol, unit: which parameter of which effect.
        joints: that have it.
        value, std: its size if it is one for all of them, with its standard error.
        chance: probability that sizes of one value would be found as far apart (Cochran's Q; W. G. Cochran, The
            combination of estimates from different experiments, Biometrics 10, 1954).
    """

    effect: str
    symbol: str
    unit: str
    joints: tuple[str, ...]
    value: float
    std: float
    chance: float

    @property
    def common(self) -> bool:
        """Whether one size for all is not contradicted."""
        return self.chance > CRITERIA.wrong_names


@dataclass(frozen=True, eq=False)
class ArmDiagnosis:
    """Result of :func:`hybrid_id.diagnose_arm`.

    Attributes:
        dataset: the records, of all joints.
        joints: the diagnosis of each joint by the joint's name, the others moving as they were measured; joints of a
            coupled gear are one (:func:`~hybrid_id.systems.by_joint.joint_parts`).
        skipped: joints that were not diagnosed, each with the reason.
        horizon: how long the free runs are over which the joints' parts and the whole robot are measured
            (:func:`~hybrid_id.diagnosis.whole_robot.common_horizon`), or as long as the user has asked for.
        parts: share of each diagnosed joint in the robot's gap, on train records, the others moving as they were
            measured (mean squares over the signal's variance): simulated, an error of one joint would be one of all
            that feel it. Where nothing is missing at any joint, in what the re-fitted robot leaves beyond noise.
        part_bounds: the least and the most that these may be (:func:`~hybrid_id.diagnosis.whole_robot.parts_of_gap`).
        estimates: parameters of the corrected robot with their standard errors, by name, from the fit of all joints;
            empty where that fit was not better than the joints' own, or the search was stopped before it.
        common: parameters of effects that several joints have.
        refit, model: the whole robot, re-fitted and corrected.
        nominal_errors, refit_errors, model_errors: on the test records, all joints simulated; None without.
        shrink: how far the gap shrinks there.
        contradiction: where the test records contradict the answer, in a sentence; empty elsewhere.
        interrupted: whether it was stopped, so that joints, or what all of them say together, may lack.
        skews: channels that are recorded late against others, in words; the diagnosis has shifted them.
        gears: by which motors turn with another joint, too, and which the nominal model lacks; the joints of each were
            diagnosed once more with it, as one.
    """

    dataset: Dataset
    joints: Mapping[str, Diagnosis]
    skipped: Mapping[str, str]
    horizon: Horizon
    parts: Mapping[str, float]
    part_bounds: Mapping[str, tuple[float, float]]
    estimates: Mapping[str, tuple[float, float]]
    common: tuple[CommonSize, ...]
    refit: System
    model: System
    nominal_errors: Errors | None
    refit_errors: Errors | None
    model_errors: Errors | None
    shrink: Shrink | None
    contradiction: str
    interrupted: bool
    skews: tuple[str, ...] = ()
    gears: tuple[CoupledGear, ...] = ()

    @property
    def case(self) -> str:
        """Name of the dataset."""
        return self.dataset.name

    @property
    def effects(self) -> tuple[RatedEffect, ...]:
        """Every effect that was tried, the selected ones first, by share: of the whole robot's gap."""
        return tuple(one for one, _, _ in self.rated())

    def rated(self) -> list[tuple[RatedEffect, RatedEffect, str]]:
        """Effects of the robot in their order, each as the robot and as its joint by itself has it, and that joint."""
        every = []
        for one, joint in ((one, joint) for joint, found in self.joints.items() for one in found.effects):
            # its place, its share of the robot's gap, and its values in the robot's model
            part, bounds, sizes = self.parts[joint], self.part_bounds[joint], one.parameters
            if one.selected:
                infos = brought_to(self.model, (one.name, one.where), self.joints[joint].model)
                sizes = {
                    s: self.estimates.get(infos[s].name, v) if s in infos else v for s, v in sizes.items()
                }
            of_robot = replace(
                one,
                where=self._placed(one.where, joint),
                tied_with=tuple(self._placed(tie, joint) for tie in one.tied_with),
                share=None if one.share is None else one.share * part,
                share_interval=one.share_interval
                and (
                    min(one.share_interval[0] * bound for bound in bounds),
                    max(one.share_interval[1] * bound for bound in bounds),
                ),
                alone=None if one.alone is None else one.alone * part,
                parameters=sizes,
            )
            every.append((of_robot, one, joint))
        return sorted(every, key=lambda of: of[0].rank)

    def _placed(self, where: str, joint: str) -> str:
        """``joint3/motor``, as a joint by itself has it, with the joint's name."""
        return named(self.joints[joint].model, where)

    @property
    def selected(self) -> tuple[RatedEffect, ...]:
        """The effects that the diagnosis asserts."""
        return tuple(one for one in self.effects if one.selected)

    @property
    def tied(self) -> dict[str, tuple[tuple[str, ...], ...]]:
        """Groups of effects that the records cannot distinguish, by joint, as the joint by itself has them.

        Of what explains more than next to nothing of the robot's gap: for less nobody records anew.
        """
        found: dict[str, tuple[tuple[str, ...], ...]] = {}
        for one, own, joint in self.rated():
            if not one.negligible and (groups := tied_sets([own])):
                found[joint] = (*found.get(joint, ()), *groups)
        return found

    @property
    def remainder(self) -> float:
        """Structural share of the robot's gap that stays unexplained, of joints where something is missing."""
        return sum(
            self.parts[joint] * found.remainder
            for joint, found in self.joints.items()
            if found.verdict in ("effects", "outside_catalogue")
        )

    @property
    def unknown(self) -> bool:
        """Whether what the catalogue lacks explains a substantial share of the robot's gap at any joint."""
        return bool(self.joints_with_unknown)

    @property
    def joints_with_unknown(self) -> list[str]:
        """The joints at which it does."""
        return [
            joint
            for joint, found in self.joints.items()
            if found.unknown and self.parts[joint] >= CRITERIA.substantial
        ]

    @property
    def verdict(self) -> str:
        """What the whole robot's is: that of its joints, or ``effects`` where it lacks a coupled gear."""
        return "effects" if self.gears else self.of_joints

    @property
    def of_joints(self) -> str:
        """The first verdict that any joint has, in the order of :data:`VERDICTS`.

        Something is outside the catalogue where it is a substantial part of the robot's gap.
        """
        found = {one.verdict for one in self.joints.values()}
        if not self.unknown and found - {"outside_catalogue"}:
            found -= {"outside_catalogue"}
        if self.interrupted and "effects" not in found:
            return "inconclusive"  # the other joints were not tried
        return next(verdict for verdict in VERDICTS if verdict in found)

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``: the keys of one joint's, and each joint's own under ``joints``."""
        effects = [
            effect_entry(one) | {"joint": joint, "share_of_joint": own.share, "share_alone": own.alone}
            for one, own, joint in self.rated()
        ]
        return {
            "case": self.case,
            "verdict": self.verdict,
            "interrupted": self.interrupted,
            "skews": list(self.skews),
            "unknown": self.unknown,
            "no_gap": self.verdict in ("no_gap", "parameters_only"),
            "coupled_gears": [vars(one) for one in self.gears],
            "effects": effects,
            "ties": [
                [self._placed(name, joint) for name in tie]
                for joint, groups in self.tied.items()
                for tie in groups
            ],
            "remainder": {"share": self.remainder},
            "horizon": self.horizon.as_dict(),
            "gap": gap_entry(
                self.nominal_errors, self.refit_errors, self.model_errors, self.shrink, self.contradiction
            ),
            "location": [
                {"joint": joint, "side": None, "share_of_gap": part}
                for joint, part in sorted(self.parts.items(), key=lambda one: -one[1])
            ],
            "common_sizes": [
                vars(one) | {"joints": list(one.joints), "common": one.common} for one in self.common
            ],
            "skipped": dict(self.skipped),
            "joints": {joint: found.as_dict() for joint, found in self.joints.items()},
        }


def diagnose_arm(
    dataset: Dataset,
    system: System,
    *,
    joints: Sequence[str] | None = None,
    horizon: Horizon | None = None,
    max_effects: int = MAX_EFFECTS,
    jobs: int = 1,
    seed: int = 0,
    level: float = 0.95,
    kept: Kept | None = None,
    progress: Progress | None = None,
) -> ArmDiagnosis:
    """Find out why records of a robot and its simulator disagree, joint by joint.

    Args:
        dataset: train records, validation records if there are any, and test records, of the whole robot.
        system: the nominal model, of a description.
        joints: names of the joints to diagnose; None for all that move. With one of a coupled gear come the others.
        horizon: how long free runs of a joint are; None for what its records ask for.
        max_effects: effects of a joint at most, beside what acts on all joints.
        jobs: processes.
        seed: of the resampling.
        level: confidence of the parameters' intervals.
        kept: fits that an earlier run has kept, and where those of this one are kept.
        progress: called with (stage, done, total); a stage begins with its joint's name.

    Ctrl-C ends it with what it has found.

    Raises:
        InputError: no joint can be diagnosed, or there is none of a name; and see :func:`hybrid_id.diagnose`.
        KeyboardInterrupt: stopped before the first joint's search has found anything, or before its report.
    """
    system = within_reach(system)
    # late channels are shifted, so that there is one time for every stage; but not those of coupled gears, whose
    # encoders tell of several motors
    single = {str(j.number) for j, ratio in zip(system.joints, system.own_ratios, strict=True) if ratio}
    skews = tuple(one for one in find_skews(dataset) if number_of(one.channel) in single)
    if skews:
        try:
            dataset = dataset.without_skew({one.channel: one.late for one in skews})
        except (
            InputError
        ):  # longer than a record: each joint is asked by itself, with the records that it has
            skews = ()
    # the joints to diagnose, those of a coupled gear as one, and those that are left out, each with why
    able, skipped = joints_to_diagnose(dataset, system)
    asked = able if joints is None else asked_parts(system, joints)
    for name, part in zip(joints or (), asked, strict=False):
        if part in skipped:
            raise InputError(
                f"Joint '{name}' cannot be diagnosed by itself: {skipped[part]}; take it out of --joint."
            )
    names = [name for name in able if name in asked]
    skipped |= {name: NOT_ASKED for name in able if name not in names}
    _raise_without_any(names, dataset, skipped)

    def searched(system: System, names: Sequence[str], skipped: dict[str, str]) -> tuple[Found, bool]:
        # of joints, the others as measured, and whether the searches were stopped; failed ones are `skipped`
        found, parts = Found(), joint_parts(system)
        for name in names:

            def say(stage: str, done: int, total: int, name: str = name) -> None:
                if progress is not None:
                    progress(f"{name}: {stage}", done, total)

            try:
                found[name] = answered(
                    with_others_measured(moving_records(dataset, *parts[name]), system, *parts[name]),
                    some(system, parts[name]), horizon=horizon, max_effects=max_effects, jobs=jobs, seed=seed,
                    kept=kept, progress=say,
                )  # fmt: skip
            except InputError as error:  # one joint's records or values must not cost the others theirs
                if len(names) == 1:
                    raise
                skipped[name] = str(error).removesuffix(".")
                continue
            except KeyboardInterrupt:
                if not found:
                    raise
                return found, True
            if found[name].found.interrupted:
                return found, True
        return found, False

    first, stopped = searched(system, names, skipped)
    _raise_without_any(first, dataset, skipped)
    common = horizon or common_horizon(first)
    robot = WholeRobot(dataset, system, first, common, seed, progress)
    gears = tuple[CoupledGear, ...]()
    if not stopped:  # who stops waits for no more fits
        try:
            robot, gears = _with_gears(robot, searched)
            # as the whole robot leaves the answers: what acts on all, ties that it settles, claims that help
            robot.say("the whole robot", 0, 1)
            checked = robot
            for stage in (judged_by_all, distinguished, borne_out):
                checked = replace(checked, answers=stage(checked))
            robot = checked
        except KeyboardInterrupt:
            stopped = True
    # the joints' diagnoses; those that fail are skipped. Stopped after one it has those that are there
    done = dict[str, Diagnosis]()
    for name, answer in robot.answers.items():
        own = (one for one in skews if f"joint{number_of(one.channel)}" in robot.keys(name))
        answer = replace(answer, skews=(*own, *answer.skews))
        try:
            done[name] = reported(answer, robot.drives[name], seed=robot.seed, level=level)
        except InputError as error:
            if len(robot.answers) == 1:
                raise
            skipped[name] = str(error).removesuffix(".")
        except KeyboardInterrupt:
            if not done:
                raise
            break
    _raise_without_any(done, dataset, skipped)
    lacking = [name for name in robot.answers if name not in done and name not in skipped]
    lacking += [name for name in names if name not in first and name not in skipped]
    skipped |= dict.fromkeys(lacking, STOPPED)
    without = {name: one.found.base.system for name, one in first.items() if name not in robot.answers}
    whole = partial(_of_whole_robot, robot, system, done, without, gears, skipped, skews)
    try:
        return whole(stopped=stopped or bool(lacking))
    except KeyboardInterrupt:
        return whole(stopped=True)


Found = dict[str, Answer]
"""What the search says of each joint."""


def _with_gears(
    robot: WholeRobot, searched: Callable[..., tuple[Found, bool]]
) -> tuple[WholeRobot, tuple[CoupledGear, ...]]:
    """The robot with gears that its model lacks, searched with the joints of each as one, and these gears."""
    gears = coupled_gears(robot)
    if not gears:
        return robot, ()
    coupled = with_gears(robot.nominal, gears)
    asked = {part_with(coupled, one.motor): (one.joint, one.motor) for one in gears}
    try:
        more, stopped = searched(coupled, list(asked), {})
    except InputError:
        return robot, ()
    if stopped:
        raise KeyboardInterrupt
    if len(more) < len(asked):
        return robot, ()
    apart = {name for pair in asked.values() for name in pair}
    answers = {name: one for name, one in robot.answers.items() if name not in apart} | more
    return replace(robot, nominal=coupled, answers=answers), gears


def _raise_without_any(found: Collection[str], dataset: Dataset, skipped: Mapping[str, str]) -> None:
    if not found:
        reasons = "; ".join(f"{name}: {why}" for name, why in skipped.items())
        raise InputError(f"No joint of dataset '{dataset.name}' can be diagnosed by itself ({reasons}).")


def _of_whole_robot(
    robot: WholeRobot,
    nominal: System,
    found: Mapping[str, Diagnosis],
    without: Mapping[str, System],
    gears: tuple[CoupledGear, ...],
    skipped: Mapping[str, str],
    skews: Sequence[Skew],
    stopped: bool,
) -> ArmDiagnosis:
    """What the joints' diagnoses make of the robot: both of its models, and the test records that measure them.

    Args:
        robot: with the gears that its model lacks.
        nominal: its model without them.
        found: the diagnoses.
        without: re-fitted drives of the gears' joints without these, by name.
        gears: the gears.
        skipped: see :class:`ArmDiagnosis`.
        skews: channels that are recorded late against others.
        stopped: whether no more is fitted.
    """
    dataset, horizon = robot.dataset, robot.horizon
    refit, model, apart = nominal, robot.nominal, joint_parts(nominal)
    for one in without.values():
        refit = with_drive(refit, one)
    for name, one in found.items():
        model = with_drive(model, one.model)
        if name in apart:
            refit = with_drive(refit, one.search.base.system)
    shown = (known for one in found.values() for known in one.search.shown.items())
    free = (i for name, of in shown for s, i in brought(model, *name).items() if s in of.sizes)
    model = model.with_specs({i.name: replace(i.spec, estimate=True) for i in free})
    moving, now = with_standing_held(dataset, nominal)  # what stands still goes with the records
    if now.seats is not None:
        refit, model = some(refit, now.seats), some(model, now.seats)
    given = [record for record in moving.records if record.role != "test"]

    def coupled(system: System) -> tuple[System, FitResult | None]:
        # fitted with all joints simulated: one by itself takes the motion of the others with its noise, the whole
        # robot does not. As it was, and without a fit, where that errs no less
        with suppress(*UNFITTED):
            batch = horizon.cut(system, engine(), batch_of(moving, system, given))
            options = Options(max_iterations=COUPLED)
            fit = kept_fit(
                robot.kept, system, batch, pooled=True, engine=engine(), options=options, warm=False
            )[0]
            before, after = (
                errors(moving, one, engine(), given, horizon=horizon) for one in (system, fit.system)
            )
            if before is not None and after is not None and after.over_noise < before.over_noise:
                return fit.system, fit
        return system, None

    whole, lacking = None, bool(gears) or any(one.search.chosen.effects for one in found.values())
    if not stopped:  # who stops waits for no more fits
        refit, whole = coupled(refit)
        model, whole = coupled(model) if lacking else (refit, whole)
    gap, contradiction = None, ""
    nominal_errors, before, after = (
        errors(moving, one, engine(), horizon=horizon) for one in (now, refit, model)
    )
    if now.seats is not None:
        refit, model = together(refit), together(model)
    if before is not None and after is not None:
        rest = after.nrmse * float(np.sqrt(1.0 - min(max(after.autocorrelation, 0.0), 1.0)))
        gap = shrink(before, after, min(max(after.noise, rest), after.nrmse), seed=robot.seed)
        contradiction = unconfirmed(gap, "robot") if lacking else ""
    each = {n: (one.details.dataset, one.search.base.system, one.beyond_floor) for n, one in found.items()}
    parts, bounds = parts_of_gap(each, horizon)
    # parameters of the fit with their autocorrelation-robust standard errors, by name; empty without one
    known = dict[str, tuple[float, float]]()
    if whole is not None:
        std = robust_covariance(*whole.of_records(), prior_precision=whole.prior_precision).std_error
        known = {n: (float(v), float(s)) for n, v, s in zip(whole.names, whole.values, std, strict=True)}
    return ArmDiagnosis(
        dataset, found, skipped, horizon, parts, bounds, known, common_sizes(found, model, known), refit, model,
        nominal_errors, before, after, gap, contradiction, stopped, tuple(one.message for one in skews), gears,
    )  # fmt: skip


def common_sizes(
    found: Mapping[str, Diagnosis], model: System, known: Mapping[str, tuple[float, float]]
) -> tuple[CommonSize, ...]:
    """Parameters of effects that several joints have at the same place, each as if one size were theirs.

    Args:
        found: the joints' diagnoses, by name.
        model: the corrected robot.
        known: its parameters with their standard errors, which are compared.
    """
    sizes: dict[tuple[str, ...], list[tuple[str, tuple[float, float], ParameterInfo]]] = {}
    for one in found.values():
        for each in one.selected:
            if (each.name, each.where) in one.search.shown:
                continue  # of one size, by these joints together
            # what acts on all joints stands in the robot once: each joint has its own estimate
            whole, own = model, {}
            if acts_on_all(each.name):
                whole, own = one.model, {s: v for s, v in each.parameters.items() if v[1] > 0.0}
            for symbol, info in brought(whole, each.name, each.where).items():
                size = own.get(symbol) or known.get(info.name)
                if symbol in each.parameters and size is not None:
                    place = each.where.rpartition("/")[2]
                    # by its law: at the motor and at the link an effect has other units
                    kind = info.component.rpartition("/")[2]
                    point = getattr(whole.components[info.component], "point", "")
                    at = named(one.model, each.where).rpartition("/")[0]  # of a coupled gear's joints which
                    sizes.setdefault((each.name, place, kind, point, symbol), []).append((at, size, info))
    result = []
    for (name, *_), each in sizes.items():
        values, stds = np.array([size for _, size, _ in each]).T
        if len(each) > 1 and np.isfinite(stds).all() and (stds > 0.0).all():
            weights = stds**-2.0
            mean = float((weights * values).sum() / weights.sum())
            chance = float(chi2.sf(float((weights * (values - mean) ** 2).sum()), len(each) - 1))
            joints, info = tuple(joint for joint, _, _ in each), each[0][2]
            size = float(weights.sum() ** -0.5)
            result.append(CommonSize(name, info.symbol, info.unit, joints, mean, size, chance))
    return tuple(result)

"""The diagnosed joints of a robot simulated together, and what each is of the robot's gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hybrid_id.components.base import Shared
from hybrid_id.diagnosis.catalogue import CATALOGUE, brought, part_of
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, frozen_again
from hybrid_id.diagnosis.errors_on_test import errors
from hybrid_id.diagnosis.fits import FULL, SLOW, WINDOW, engine, with_priors_of, without_priors
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.screen import Progress
from hybrid_id.diagnosis.select import Selection, best_without, judged_fits
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.horizons import Horizon, shortest
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import ParameterInfo
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import sensor_noise
from hybrid_id.simulation.batch import Batch
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.by_joint import joint_parts, some, with_drive, with_others_measured
from hybrid_id.systems.chain import System

UNFITTED = InputError, RuntimeError, np.linalg.LinAlgError
"""What :func:`train_rows` and :func:`fitted` raise where a robot cannot be fitted."""
What = tuple[str, str]
"""An effect by its name and its place, or, where it acts on all joints, its point on the robot, if it has one."""


@dataclass(frozen=True, eq=False)
class WholeRobot:
    """The diagnosed joints of a robot simulated together; the others, if any, move as they were measured.

    Attributes:
        dataset: of the whole robot.
        nominal: the nominal robot.
        answers: of its joints, by name.
        horizon: how long free runs are.
        seed: of the resampling.
        progress: called with (stage, done, total).
    """

    dataset: Dataset
    nominal: System
    answers: Mapping[str, Answer]
    horizon: Horizon
    seed: int = 0
    progress: Progress | None = None

    @cached_property
    def numbers(self) -> dict[str, list[int]]:
        """Number of each joint in the robot, from 0; of a coupled gear those of its joints."""
        parts = joint_parts(self.nominal)
        return {name: parts[name] for name in self.answers}

    @cached_property
    def simulated(self) -> list[int]:
        """Numbers of all joints that are simulated."""
        return sorted(joint for part in self.numbers.values() for joint in part)

    @cached_property
    def drives(self) -> dict[str, System]:
        """The nominal drive of each joint by itself."""
        return {name: some(self.nominal, part) for name, part in self.numbers.items()}

    @cached_property
    def records(self) -> Dataset:
        """Of the joints that are simulated."""
        if self.every:
            return self.dataset
        return with_others_measured(self.dataset, self.nominal, *self.simulated)

    @property
    def every(self) -> bool:
        """Whether all joints are simulated."""
        return len(self.simulated) == len(self.nominal.joints)

    @property
    def kept(self) -> Kept | None:
        """Fits that an earlier run has kept, and where further ones are kept."""
        return next(iter(self.answers.values())).fits.kept

    def say(self, stage: str, done: int, total: int) -> None:
        """Tell the progress, where anybody listens."""
        if self.progress is not None:
            self.progress(stage, done, total)

    def frozen(self, name: str, searched: Selection) -> Answer:
        """A joint's answer by a search that the whole robot has changed."""
        return frozen_again(self.answers[name], searched, self.drives[name], seed=self.seed)

    def keys(self, name: str) -> list[str]:
        """Where a joint's components stand, or those of a coupled gear's joints."""
        return [f"joint{joint + 1}" for joint in self.numbers[name]]

    def system(self, models: Mapping[str, FittedModel], *, held: bool = False) -> System:
        """The robot with these models of the joints, by name, held as they were in the search or no longer."""
        robot = self.nominal
        for name, one in models.items():
            own = one.system if held else without_priors(one.system, self.drives[name])
            robot = with_drive(robot, own)
        return robot if self.every else some(robot, self.simulated)


def common_horizon(answers: Mapping[str, Answer]) -> Horizon:
    """How long free runs of a whole robot are: the shortest that any joint's records ask for, or less.

    A free run that has lost its record says how far it strays, and not how much is missing: where that of a re-fitted
    joint has, runs begin again from measured states.
    """
    horizon = shortest([one.fits.horizon for one in answers.values()])
    if horizon.kind == "windows" and horizon.seconds <= WINDOW:
        return horizon
    for name, one in answers.items():
        errs = _beyond_noise(one.fits.dataset, one.found.base.system, horizon).values()
        if errs and np.mean([np.sqrt(square * share) for square, share in errs]) > CRITERIA.lost_refit:
            return Horizon("windows", WINDOW, f"longer ones lose the records of {name}")
    return horizon


def train_rows(dataset: Dataset, system: System, horizon: Horizon) -> Batch:
    """The train records of a robot as its fits take them."""
    return horizon.cut(system, engine(), batch_of(dataset, system, dataset.train))


def fitted(system: System, rows: Batch, kept: Kept | None) -> FitResult:
    """One set of a robot's values for all rows, fitted to the end.

    Raises:
        RuntimeError: its free runs diverge, or run away from the end of the fit.
    """
    # a robot that lacks what it is fitted without may wander for long: how it ends decides by percents
    options = Options(max_iterations=FULL, tolerance=0.05, least_gain=SLOW)
    found = kept_fit(kept, system, rows, pooled=True, engine=engine(), options=options, warm=False)[0]
    if not all(np.isfinite(piece).all() for piece in found.residual):
        raise RuntimeError("The fitted robot runs away.")
    return found


def held(model: FittedModel, answer: Answer) -> FittedModel:
    """A joint's model held as its search has left it: as its base is, or no longer where it did better so."""
    searched = answer.searched
    ends = (searched.chosen, *judged_fits(searched.steps, model.effects))
    as_it = next((one for one in ends if one.effects == model.effects), searched.base)
    return model.at(with_priors_of(model.system, as_it.system))


def acts_on_all(effect: str) -> bool:
    """Whether an effect acts on all joints of a robot that it concerns, so that it stands there once."""
    return any(issubclass(law, Shared) for law in CATALOGUE[effect].laws)


def what(effect: Name, system: System) -> What:
    """Which effect a model has, wherever it is listed if it acts on all joints."""
    if not acts_on_all(effect[0]):
        return effect
    parts = (part_of(system, effect[1], kind) for kind in CATALOGUE[effect[0]].kinds)
    return effect[0], next((part.point for part in parts if isinstance(part, Shared)), "")


def brought_to(robot: System, effect: Name, own: System) -> dict[str, ParameterInfo]:
    """Rows of a robot's table of what a joint's effect brings, by symbol.

    One that acts on all joints is found wherever the robot lists it.

    Args:
        robot: which has the joint's effects.
        effect: its name and its place.
        own: the joint by itself, with the effect.
    """
    sought, kinds = what(effect, own), CATALOGUE[effect[0]].kinds
    keys = (key.rpartition("/") for key in robot.components)
    there = ((effect[0], place) for place, _, kind in keys if kind in kinds)
    return next((brought(robot, *one) for one in there if what(one, robot) == sought), {})


def without_effect(
    robot: WholeRobot, models: Mapping[str, FittedModel], name: str, effect: Name
) -> dict[str, FittedModel] | None:
    """The models without an effect of a joint: of one that acts on several joints, wherever it is claimed.

    None where a joint cannot be fitted without it.
    """
    found, lacks = dict(models), what(effect, models[name].system)
    for joint, model in models.items():
        for one in model.effects:
            if what(one, model.system) == lacks:
                rest = less(robot.answers[joint], found[joint], one)
                if rest is None:
                    return None
                found[joint] = rest
    return found


def less(answer: Answer, model: FittedModel, effect: Name) -> FittedModel | None:
    """A joint's model less one of its effects, as the search would have it; None where it cannot be fitted."""
    searched = answer.searched
    return best_without(answer.fits, searched.base, held(model, answer), effect, searched.steps)


def parts_of_gap(
    found: Mapping[str, tuple[Dataset, System, float]], horizon: Horizon
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Share of each diagnosed joint in the robot's gap on train records, and the least and the most that it may be.

    The least if whatever the others leave beyond noise were gap: other values in each record may hide that something is
    missing. The most if no part of the gap that is not substantial were one: other values may look like it, too.

    Args:
        found: by a joint's name its records, its re-fitted model, and what is beyond the floor of what that leaves.
        horizon: how long free runs are.
    """
    gap, beyond = dict.fromkeys(found, 0.0), dict.fromkeys(found, 0.0)
    for name, (dataset, base, beyond_floor) in found.items():
        for square, share in _beyond_noise(dataset, base, horizon).values():
            # records in which a joint stands still are not among its own
            beyond[name] += len(dataset.train) * square * share
            gap[name] += len(dataset.train) * square * min(beyond_floor, share)
    every, whole = sum(beyond.values()), sum(gap.values())
    if every == 0.0:
        even = dict.fromkeys(found, 1.0 / len(found))
        return even, {name: (share, share) for name, share in even.items()}
    if whole == 0.0:
        gap, whole = beyond, every
    parts = {name: size / whole for name, size in gap.items()}
    large = sum(part for part in parts.values() if part >= CRITERIA.substantial)

    def bounds(name: str, part: float) -> tuple[float, float]:
        least = gap[name] / max(gap[name] + every - beyond[name], 1e-300)
        return least, part / max(large + part * (part < CRITERIA.substantial), 1e-300)

    return parts, {name: bounds(name, part) for name, part in parts.items()}


def _beyond_noise(dataset: Dataset, system: System, horizon: Horizon) -> dict[str, tuple[float, float]]:
    """By output the mean square of a model's train errors, over the signal's variance, and its share beyond the noise.

    Without outputs that do not move, or err by no more than it.
    """
    seen = errors(dataset, system, engine(), dataset.train, horizon=horizon)
    found: dict[str, tuple[float, float]] = {}
    if seen is None:
        return found
    known = sensor_noise(dataset)
    for channel in dataset.outputs:
        normalised, square = seen.squares.get(channel.name, (0.0, 0.0))
        if square > known[channel.name] ** 2:
            found[channel.name] = normalised, 1.0 - known[channel.name] ** 2 / square
    return found

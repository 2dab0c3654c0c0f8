"""Which causes a machine has: models with sets of them, estimated in the likelihood of the prediction errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import torch
from scoring import Estimate, Prior, estimate
from sigma_points import Likelihood
from torch import Tensor

from hybrid_id.components import CATALOGUE, Cogging, Component
from hybrid_id.components.base import ServoLoop, Shared
from hybrid_id.components.site import Scales
from hybrid_id.diagnosis.catalogue import with_effect
from hybrid_id.diagnosis.scales import scales
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.by_joint import (
    joint_parts,
    joints_to_diagnose,
    moving_records,
    some,
    with_others_measured,
)
from hybrid_id.systems.chain import System

TOLERANCE, FRICTION, OWN, SLAB = 0.3, 1.0, 1.0, 2.0
"""By what a data sheet misses a value, a friction, and an effect's usual size, as standard deviations of logarithms;
and of a size of either sign, in its usual sizes."""
VARIES = 0.03
"""Share of itself by which a value differs from record to record."""
CHANGED = 1.5
"""The same of a value that has changed for a reason of its own."""
PRICE = math.log(2.0) + math.log(25.0)
"""What a further cause must bring: even odds that there is one, times as many that it might be."""
FASTEST = 500.0
"""Sub-steps a second at most: what swings faster is damped away."""
AFAR, NEAREST = 4, 1
"""Iterations of a first look at a model with other states, and from how many start points."""
AGAIN = 15
"""How many of the best first looks are taken a second time."""
SMALL = 0.02
"""Share of what all causes have gained below which a further one is not looked for beyond."""
STAGES, MOST = ((4, 4), (2, 20)), 5
"""How many of the best are estimated on, and with how many iterations; causes at most."""
WAVES, STARTS, REPEATED = 200, 3, 2.0
"""Waves of a torque over the rotor's angle a turn at most; start points; waves over all motion at least."""
PIECES, DRAWS = 8, 400
"""Least pieces of the records, and draws of their weights."""
AHEAD, SOON = 0.5, 10
"""For how long a model runs by itself where shares are counted [s], and samples over which a cause must not make it
err more."""
SURE, NOMINAL, BEYOND, NAMED = 3.0, 0.02, 2.0, 6
"""Standard errors from which a value has moved; what no data sheet is better than; tolerances beyond which a value is a
cause of its own; values at most that shares name."""


@dataclass(frozen=True, order=True)
class Cause:
    """A law at its place, or values of the model that are not what its data sheet says.

    Attributes:
        name: of the effect, or of the values, apart from each other by a comma.
        where: place of the effect; empty for values.
        point: of a robot's description, where the law sits at one.
        shared: whether it acts on several joints of a robot at once.
    """

    name: str
    where: str = ""
    point: str = ""
    shared: bool = False

    @property
    def values(self) -> tuple[str, ...]:
        """Names of the values."""
        return () if self.where else tuple(self.name.split(","))

    def __str__(self) -> str:
        if not self.where:
            return f"value of {self.name}"
        return (
            f"{self.name} of {self.point or 'the robot'}" if self.shared else f"{self.name} at {self.where}"
        )


@dataclass(frozen=True, eq=False)
class Model:
    """A system with a set of causes, where its estimation ends."""

    causes: frozenset[Cause]
    system: System
    likelihood: Likelihood
    prior: Prior
    end: Estimate

    @property
    def total(self) -> float:
        """Evidence with the prior of so many causes."""
        total = self.end.evidence - PRICE * len(self.causes)
        return total if math.isfinite(total) else -math.inf

    @cached_property
    def there(self) -> System:
        """The system with its estimated values."""
        pairs = zip(self.system.table, self.end.theta.tolist(), strict=True)
        values = {info.name: min(max(v, info.spec.lower), info.spec.upper) for info, v in pairs}
        return self.system.with_values(values)

    @cached_property
    def alone(self) -> float:
        """Mean square of its errors while it runs by itself for :data:`SOON` samples, over the outputs' variances."""
        return float(self.likelihood.alone(self.end.theta[:, None], self.end.logs[None], SOON))

    @property
    def estimates(self) -> dict[str, tuple[float, float]]:
        """Free values with their standard errors."""
        free = self.likelihood.free
        spread = torch.linalg.inv(self.end.hessian).diagonal().clamp_min(0.0).sqrt()
        return {
            self.system.table[i].name: (float(self.end.theta[i]), float(std))
            for i, std in zip(free, spread, strict=True)
        }

    def pieces(self, most: int) -> Tensor:
        """Logarithm of the likelihood of each of some pieces of the records."""
        if len(self.end.each) >= most:
            return -self.end.each
        left = -0.5 * (self.end.errors.square() + self.end.variances).sum(2)
        parts = math.ceil(most / len(left))
        return torch.cat([part.sum(1) for part in left.tensor_split(parts, 1)])


@dataclass(frozen=True)
class Answer:
    """What a machine's gap consists of.

    Attributes:
        model: with all that was found.
        amounts: what each cause and changed value, and the rest of the values, take of the nominal model's squares.
        whole, left: these, and what stays.
        probabilities: of causes, over sets and draws of the records' pieces.
        rivals: of each cause, causes that take its place with so many nats less.
    """

    model: Model
    amounts: Mapping[str, float]
    whole: float
    left: float
    probabilities: Mapping[Cause, float]
    rivals: Mapping[Cause, Mapping[Cause, float]]


class Part:
    """A machine, or a joint of one with the others as measured: models of it, estimated.

    Args:
        nominal: what the user believes.
        records: of the machine.
    """

    def __init__(self, nominal: System, records: Sequence[Record]) -> None:
        self.nominal, self.records, self.fits = nominal, records, 0
        self.sheet = {i.name: float(v) for i, v in zip(nominal.table, nominal.theta().detach(), strict=True)}
        nominal.aliases = {
            (i.component, i.symbol): i.name for i in nominal.table
        }  # whatever is added, names stay
        self.visited: dict[frozenset[Cause], Model] = {}

    def likelihood(self, system: System) -> Likelihood:
        """Of the records under a model."""
        batch = make_batch(system, self.records, signal_share=0.0)
        theta = system.theta().detach()[:, None].expand(-1, batch.rows)
        engine = with_substeps(system, compiled_for(system, Engine()), batch, theta)
        most = max(1, math.ceil(FASTEST * batch.sample_time))
        return Likelihood(system, replace(engine, substeps=min(engine.substeps, most)), batch)

    def fit(
        self,
        system: System,
        causes: frozenset[Cause],
        near: Model | None = None,
        iterations: int = 30,
        *,
        quick: bool = False,
    ) -> Model:
        """Estimate a model from its own values.

        Args:
            system: the model.
            causes: that it has.
            near: one whose noise it begins with.
            iterations: at most.
            quick: whether errors change with the other one's values as they do there.
        """
        self.fits += 1
        likelihood = self.likelihood(system)
        if (
            near is not None and system.state_names != near.system.state_names
        ):  # its states are followed from afar
            near, quick = None, False
        prior = self.prior(system, likelihood, causes)
        beside = None if near is None else near.end
        end = estimate(likelihood, prior, near=beside, iterations=iterations, quick=quick)
        model = Model(causes, system, likelihood, prior, end)
        if not quick and (causes not in self.visited or model.total > self.visited[causes].total):
            self.visited[causes] = model
        return model

    def prior(self, system: System, likelihood: Likelihood, causes: frozenset[Cause]) -> Prior:
        """Of the free values of a model: about its data sheet, and of effects about their usual sizes."""
        free = likelihood.free
        bounds, start = make_bounds(system, free), system.theta().detach()[free]
        names = [system.table[i].name for i in free]
        mean, spread = start.clone(), torch.full_like(start, OWN)
        for k, name in enumerate(names):
            if name in self.sheet:
                mean[k], spread[k] = self.sheet[name], FRICTION if name.startswith("F_") else TOLERANCE
        own = torch.tensor([name not in self.sheet for name in names], dtype=torch.bool)
        plain = (bounds.lower < 0) | (mean <= 0)
        slab = SLAB * torch.maximum(start.abs(), bounds.scale)
        loose = 10.0 * torch.maximum(mean.abs(), bounds.scale)
        mean = torch.where(plain & own, torch.zeros_like(mean), mean)
        covariance = torch.diag(torch.where(plain, torch.where(own, slab, loose), spread).square())
        for cause in causes:
            rows = [names.index(name) for name in cause.values]
            if rows:
                covariance[rows, rows] = 0.01
                covariance[torch.tensor(rows)[:, None], torch.tensor(rows)] += CHANGED**2
        given = bounds.prior_precision
        vary = torch.where(own, 0.0, VARIES).to(mean)
        precision = torch.linalg.inv(covariance) + torch.diag(given * ~own)
        return Prior(tuple(names), bounds, mean, ~plain, precision, vary)

    def candidates(self, model: Model) -> Iterator[tuple[Cause, System]]:
        """Every cause beside a model, at each of its start points."""
        there, rows = model.there, {info.name: info for info in model.there.table}
        groups = [
            (name,)
            for name, value in self.sheet.items()
            if value and rows.get(name) and rows[name].spec.value
        ]
        for key, part in there.components.items():  # a loop's gains are set together
            if isinstance(part, ServoLoop):
                gains = tuple(
                    i.name
                    for i in there.table
                    if i.component == key and i.symbol.startswith("k_") and self.sheet.get(i.name)
                )
                groups += [gains] if len(gains) > 1 else []
        for group in groups:
            cause = Cause(",".join(group))
            free = [rows[name].spec.estimate for name in group]
            if any(set(group) & set(other.values) for other in model.causes) or not all(
                n in rows for n in group
            ):
                continue
            if all(free) and all(abs(self.misses(model, name)) < BEYOND for name in group):
                continue
            with suppress(InputError):
                yield cause, there.with_specs({n: replace(rows[n].spec, estimate=True) for n in group})
        for size in scales(there, model.likelihood.batch):
            for effect in CATALOGUE.values():
                for where, models in with_effect(effect, there, size).items():
                    if any((cause.name, cause.where) == (effect.name, where) for cause in model.causes):
                        continue
                    for system in self.waves(model, size) if effect.name == "cogging" else models:
                        law = next(
                            part
                            for key, part in system.components.items()
                            if key.startswith(f"{where}/") and key.rpartition("/")[2] in effect.kinds
                        )
                        shared = there.tree is not None and isinstance(law, Shared)
                        yield Cause(effect.name, where, getattr(law, "point", ""), shared), system

    def misses(self, model: Model, name: str) -> float:
        """By how many of its tolerances a value misses its data sheet."""
        found, sheet = model.estimates.get(name, (0.0, 0.0))[0], self.sheet[name]
        if found <= 0.0 or sheet <= 0.0:
            return 0.0
        return math.log(found / sheet) / (FRICTION if name.startswith("F_") else TOLERANCE)

    def waves(self, model: Model, size: Scales) -> list[System]:
        """A model with the torques over a rotor's angle that would explain most of its prediction errors."""
        where, turns = f"joint{size.joint}/motor", size.turns / (2.0 * math.pi)
        system = model.there.with_component(where, Cogging(T_c=0.0, T_s=0.0))
        symbols = {info.symbol: info.name for info in system.table if info.component == f"{where}/cogging"}
        periods = torch.arange(max(1, math.ceil(REPEATED / turns)), WAVES + 1).to(model.end.theta)
        batch, joint = model.likelihood.batch, model.there.joint(size.joint)
        if joint.positions[0] + 1 not in model.likelihood.pushed:  # a rotor that nobody sees
            return []
        number = model.likelihood.pushed.index(joint.positions[0] + 1)
        missing, spread = (
            part[0] for part in model.likelihood.torque(model.end.theta[:, None], model.end.logs[None])
        )
        if not (missing.isfinite().all() and bool((spread > 0.0).all())):
            return []
        seen = (batch.weight > 0).any(2)
        angle, speed = (batch.x[..., joint.positions[0] + k][seen] for k in (0, 1))
        torque = size.inertia * missing[..., number][seen]
        sure = 1.0 / spread[..., number][seen]
        usual = torch.stack([torch.ones_like(angle), angle, speed, torch.sign(speed)], 1) * sure[:, None]
        known = torch.linalg.qr(usual).Q
        left = torque * sure
        left = left - known @ (known.T @ left)
        limit, ranked = 3.0 * size.torque, list[tuple[float, list[float]]]()
        for n in periods.tolist():
            pair = torch.stack([torch.cos(n * angle), torch.sin(n * angle)], 1) * sure[:, None]
            pair = pair - known @ (known.T @ pair)
            found = torch.linalg.lstsq(pair, left[:, None]).solution[:, 0]
            ranked.append((float((pair @ found).square().sum()), [n, *found.tolist()]))
        best = sorted(ranked, key=lambda entry: -entry[0])[:STARTS]
        found = list[System]()
        for _, (n, cosine, sine) in best:
            specs = {symbols["n"]: replace(system.parameter(symbols["n"]).spec, value=n)}
            for symbol, value in (("T_c", cosine), ("T_s", sine)):
                specs[symbols[symbol]] = Bounded(min(max(value, -limit), limit), -limit, limit, unit="N m")
            found.append(system.with_specs(specs))
        return found

    def without(self, system: System, cause: Cause) -> System:
        """A system without a cause."""
        if cause.values:
            return system.with_specs({n: self.nominal.parameter(n).spec for n in cause.values})
        was, now = (cast("dict[str, Component]", dict(s.components.items())) for s in (self.nominal, system))
        for key, part in now.items():
            place, _, law = key.rpartition("/")
            effect = type(part).effect
            if key in was or place != cause.where or effect is None or effect.name != cause.name:
                continue
            # where it took the place of another one, that comes back
            before = next((k for k in was if k.startswith(f"{place}/") and k not in now), None)
            if before is not None:
                return system.with_component(place, was[before])
            return system.without_component(place, law)
        raise KeyError(str(cause))

    def look(self, model: Model) -> list[Model]:
        """The model with each further cause, likeliest first; the best of them estimated to their ends."""
        starts, first = dict[Cause, list[System]](), dict[Cause, list[Model]]()
        for cause, system in self.candidates(model):
            starts.setdefault(cause, []).append(system)
        for cause, systems in starts.items():
            # a model with other states has to be followed from afar: only from where its errors begin least
            afar = systems[0].state_names != model.system.state_names or len(cause.values) > 1
            if afar:
                systems = sorted(systems, key=self.begins)[:NEAREST]
            for system in systems:
                with suppress(InputError):
                    tried = self.fit(
                        system,
                        model.causes | {cause},
                        model,
                        AFAR * (1 + bool(cause.values)) if afar else 1,
                        quick=not afar,
                    )
                    first.setdefault(cause, []).append(tried)
        for models in first.values():
            models.sort(key=lambda tried: -tried.total)
        ranked = sorted((models[0] for models in first.values()), key=lambda tried: -tried.total)
        again = [
            tried
            if tried.causes in self.visited
            else self.fit(tried.there, tried.causes, model, 1, quick=True)
            for tried in ranked[:AGAIN]
        ]
        grown = again
        for keep, iterations in STAGES:
            grown = sorted(grown, key=lambda tried: -tried.total)[:keep]
            grown = [self.fit(tried.there, tried.causes, tried, iterations) for tried in grown]
        if grown and not model.causes:  # from the data sheet too, where the optimum without the cause misled
            own = {info.name for info in grown[0].system.table}
            values = {name: value for name, value in self.sheet.items() if name in own}
            grown.append(self.fit(grown[0].system.with_values(values), grown[0].causes))
        best = dict[frozenset[Cause], Model]()
        for tried in (*ranked, *again, *grown):  # what was estimated longest stands
            best[tried.causes] = tried
        for tried in grown:
            best[tried.causes] = max(best[tried.causes], tried, key=lambda model: model.total)
        return sorted(best.values(), key=lambda tried: -tried.total)

    def begins(self, system: System) -> float:
        """Cost of a model as it is, under the strongest noise."""
        likelihood = self.likelihood(system)
        errors, variances = likelihood.errors(system.theta().detach()[:, None], likelihood.first[None])
        cost = float(errors.square().sum() + variances.sum())
        return cost if math.isfinite(cost) else math.inf

    def pruned(self, model: Model) -> Model:
        """The model without causes that it does not need."""
        for cause in sorted(model.causes) if len(model.causes) > 1 else ():
            if cause in model.causes and not cause.shared:
                less = self.fit(self.without(model.there, cause), model.causes - {cause}, model)
                if less.total > model.total:
                    model = less
        return model

    def answer(self, base: Model, best: Model) -> Answer:
        """Probabilities, rivals and shares."""
        rivals = {cause: dict[Cause, float]() for cause in best.causes}
        for cause in sorted(best.causes):
            if frozenset(best.causes - {cause}) not in self.visited:
                with suppress(InputError):
                    self.fit(self.without(best.there, cause), best.causes - {cause}, best)
        for models in self.visited.values():
            for cause in best.causes - models.causes:
                others = models.causes - best.causes
                if len(models.causes) == len(best.causes) and len(others) == 1:
                    rivals[cause][next(iter(others))] = best.total - models.total
        sets = list(self.visited.values())
        pieces = torch.stack([model.pieces(PIECES) for model in sets])
        generator = torch.Generator().manual_seed(0)
        weights = -torch.rand(DRAWS, pieces.shape[1], generator=generator, dtype=pieces.dtype).log()
        weights = pieces.shape[1] * weights / weights.sum(1, keepdim=True)
        totals = torch.tensor([model.total for model in sets]) + (weights - 1.0) @ pieces.T
        chance = torch.softmax(totals, 1).mean(0)
        every = {cause for model in sets for cause in model.causes}
        probabilities = {
            cause: sum(float(p) for p, model in zip(chance, sets, strict=True) if cause in model.causes)
            for cause in every
        }
        amounts, whole, left = self.shares(base, best)
        return Answer(best, amounts, whole, left, probabilities, rivals)

    def shares(self, base: Model, best: Model) -> tuple[dict[str, float], float, float]:
        """What each cause and each value that surely moved takes of the nominal model's squared errors.

        Errors are those of running alone for half a second; Shapley's mean over orders, nothing re-fitted.

        Returns:
            Amounts by name, the nominal model's squares, and what stays.
        """
        quiet = estimate(base.likelihood, base.prior.none(), near=base.end).logs
        every = max(2, round(AHEAD / base.likelihood.batch.sample_time))
        players = {str(cause): list(cause.values) for cause in sorted(best.causes)}
        taken, moved = {name for names in players.values() for name in names}, dict[str, float]()
        for name, (value, std) in best.estimates.items():
            if name in self.sheet and name not in taken:
                sheet = self.sheet[name]
                moved[name] = abs(value - sheet) / max(math.hypot(std, NOMINAL * abs(sheet)), 1e-300)
        surest = sorted((name for name in moved if moved[name] > SURE), key=lambda name: -moved[name])[:NAMED]
        players |= {f"value of {name}": [name] for name in surest}
        players |= {"rest of the values": rest} if (rest := [n for n in moved if n not in surest]) else {}
        laws = {str(cause): cause for cause in sorted(best.causes) if cause.where}
        valued = [player for player in players if player not in laws]
        sets = [frozenset(c) for n in range(len(valued) + 1) for c in itertools.combinations(valued, n)]
        left = dict[frozenset[str], float]()
        for n in range(len(laws) + 1):
            for kept in itertools.combinations(laws, n):
                system = best.there
                for name, law in laws.items():
                    if name not in kept:
                        system = self.without(system, law)
                row = {info.name: i for i, info in enumerate(system.table)}
                theta = system.theta().detach()[:, None].repeat(1, len(sets))
                for k, values in enumerate(sets):
                    for player in set(valued) - values:
                        for name in players[player]:
                            if name in row:
                                theta[row[name], k] = self.sheet[name]
                likelihood = self.likelihood(system)
                logs = quiet if len(quiet) == len(likelihood.first) else likelihood.first
                found = likelihood.alone(theta, logs.expand(len(sets), -1), every).tolist()
                left |= {values | set(kept): found[k] for k, values in enumerate(sets)}
        return shapley([*players], left), left[frozenset()], left[frozenset(players)]


def shapley(players: Sequence[str], squares: Mapping[frozenset[str], float]) -> dict[str, float]:
    """What each player takes of the squares that nobody leaves, mean over orders; who errs more takes nothing."""
    whole, n = squares[frozenset()], len(players)
    amounts = dict.fromkeys(players, 0.0)
    for coalition, left in squares.items():
        for player in set(players) - coalition:
            orders = (
                math.factorial(len(coalition)) * math.factorial(n - len(coalition) - 1) / math.factorial(n)
            )
            amounts[player] += orders * (min(left, whole) - min(squares[coalition | {player}], whole))
    return amounts


def parts_of(system: System, dataset: Dataset) -> dict[str, Part]:
    """A machine, or its joints, each with the others as measured, by name."""
    if system.tree is None:
        return {"": Part(system, dataset.train or dataset.records)}
    found = dict[str, Part]()
    for name in joints_to_diagnose(dataset, system)[0]:
        joints = joint_parts(system)[name]
        own = moving_records(with_others_measured(dataset, system, *joints), *joints)
        found[name] = Part(some(system, joints), own.train or own.records)
    return found


def posterior(parts: Mapping[str, Part], say: Callable[[str], None] = print) -> dict[str, Answer]:
    """The likeliest causes of a machine, found by adding and removing one at a time, and what each takes.

    Args:
        parts: of the machine, by name.
        say: is told what was tried.
    """
    base = {name: part.fit(part.nominal, frozenset()) for name, part in parts.items()}
    say("   nothing: " + ", ".join(f"{name} {m.total:.1f} {m.end.status}" for name, m in base.items()))
    best, stale, grown = dict(base), list(parts), dict[str, list[Model]]()
    while stale:
        for name in stale:
            grown[name] = parts[name].look(best[name])
            gains = {str(*(m.causes - best[name].causes)): m.total - best[name].total for m in grown[name]}
            say(f"     {name} " + ", ".join(f"{cause} {gain:.0f}" for cause, gain in [*gains.items()][:5]))
        choices = list[tuple[float, dict[str, Model]]]()
        together = dict[tuple[str, str], dict[str, Model]]()
        for name, models in grown.items():
            for model in models if len(best[name].causes) < MOST else ():
                (cause,) = model.causes - best[name].causes
                if cause.shared:
                    together.setdefault((cause.name, cause.point), {})[name] = model
                else:
                    choices.append((model.total - best[name].total, {name: model}))
        for models in together.values():
            gain = sum(m.total - best[name].total + PRICE for name, m in models.items()) - PRICE
            choices.append((gain - apart(models, best), models))
        # whatever the likelihood says: a model that runs astray by itself is none
        choices = [
            (gain, models)
            for gain, models in choices
            if gain > SMALL * sum(model.total - base[name].total for name, model in best.items())
            and sum(model.alone for model in models.values()) <= sum(best[name].alone for name in models)
        ]
        if not choices:
            break
        _, chosen = max(choices, key=lambda choice: choice[0])
        stale = list(chosen)
        for name, model in chosen.items():
            model = parts[name].fit(model.there, model.causes, model)
            found = parts[name].pruned(model)
            if found.causes == best[name].causes:  # a circle
                stale.remove(name)
                grown[name] = []
            best[name] = found
            say(f"   {name} {[str(c) for c in sorted(found.causes)]}: {found.total - base[name].total:.1f}")
    return {name: part.answer(base[name], best[name]) for name, part in parts.items()}


def apart(models: Mapping[str, Model], best: Mapping[str, Model]) -> float:
    """By how much sizes of one cause that parts found for themselves contradict each other: half a chi-square."""
    found = dict[str, list[tuple[float, float]]]()
    for name, model in models.items():
        old = best[name].estimates
        for value, size in model.estimates.items():
            if value not in old:
                found.setdefault(value, []).append(size)
    total = 0.0
    for sizes in found.values():
        weights = [1.0 / max(std, 1e-12) ** 2 for _, std in sizes]
        middle = sum(w * size for w, (size, _) in zip(weights, sizes, strict=True)) / sum(weights)
        total += 0.5 * sum(w * (size - middle) ** 2 for w, (size, _) in zip(weights, sizes, strict=True))
    return total


def text(answers: Mapping[str, Answer]) -> str:
    """What an engineer reads first: by size, what takes how much of the nominal model's error, and what stays."""
    whole = sum(answer.whole for answer in answers.values()) or 1.0
    taken = dict[str, float]()
    for part, answer in answers.items():
        for name, amount in answer.amounts.items():
            key = f"{part} {name}".strip() if name.startswith("rest") else name
            taken[key] = taken.get(key, 0.0) + amount
    lines = [
        f"{100.0 * amount / whole:5.1f} %  {name}"
        for name, amount in sorted(taken.items(), key=lambda e: -e[1])
    ]
    lines.append(f"{100.0 * sum(answer.left for answer in answers.values()) / whole:5.1f} %  stays")
    for part, answer in answers.items():
        for cause in sorted(answer.model.causes):
            others = sorted(answer.rivals[cause].items(), key=lambda entry: entry[1])[:3]
            beside = ", ".join(f"{other} {less:.0f}" for other, less in others)
            lines.append(
                f"{part} {cause}: {answer.probabilities[cause]:.2f}; others by so many nats less: {beside}".strip()
            )
        sizes = (f"{name} {value:.4g} ({std:.2g})" for name, (value, std) in answer.model.estimates.items())
        lines.append(f"{part} " + ", ".join(sizes))
        noise = zip(answer.model.likelihood.entries, answer.model.end.logs.exp().tolist(), strict=True)
        lines.append(
            f"{part} noise: " + ", ".join(f"{name} {k + 1} {value:.3g}" for (name, k), value in noise)
        )
    return "\n".join(lines)

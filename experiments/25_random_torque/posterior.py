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
from hybrid_id.simulation.stability import fastest_rate
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
FOLLOWED, REMEMBERED, FASTEST = 1.0, 0.3, 500.0
"""Largest step times the fastest eigenvalue, less with states that remember, and sub-steps a second at most: what
swings faster is damped away."""
LOST = (0.8, 0.4, 0.1)
"""Shares of the largest torque, and of the damping at which a loop does not swing: where a lost value is sought."""
AFAR = 8
"""Iterations of a first look at a model with a further body."""
SCOUTED, SHORT = 8000, 0.7
"""Samples among which causes are looked for first, and their share of the records from which these are short."""
FEW, NEXT, DEEP, MOST = 4, 10, 3, 5
"""Iterations by which the best first looks go on, how many do so, and how many to their ends; causes at most."""
WAVES, STARTS, REPEATED = 200, 3, 2.0
"""Waves of a torque over the rotor's angle a turn at most; start points; waves over all motion at least."""
PIECES, DRAWS = 8, 400
"""Least pieces of the records, and draws of their weights."""
AHEAD, SOON = 0.5, 10
"""For how long a model runs by itself where shares are counted [s], and samples over which a cause must not make it
err more."""
SURELY = 2.0
"""Standard errors from which a cause errs more."""
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
    def alone(self) -> Tensor:
        """Squares of its errors while it runs by itself for :data:`SOON` samples, by piece of the records."""
        return in_pieces(self.likelihood.alone(self.end.theta[:, None], self.end.logs[None], SOON)[0])

    @property
    def estimates(self) -> dict[str, tuple[float, float]]:
        """Free values with their standard errors."""
        free = self.likelihood.free
        spread = torch.linalg.inv(self.end.hessian).diagonal().clamp_min(0.0).sqrt()
        return {
            self.system.table[i].name: (float(self.end.theta[i]), float(std))
            for i, std in zip(free, spread, strict=True)
        }

    def pieces(self) -> Tensor:
        """Logarithm of the likelihood of each piece of the records."""
        if len(self.end.each) >= PIECES:
            return -self.end.each
        return in_pieces(-0.5 * (self.end.errors.square() + self.end.variances).sum(2))


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
        share, self.scout = SCOUTED / sum(record.n_samples for record in records), self
        if share < SHORT:  # the records' middles
            spans = [(0.5 * (r.time[0] + r.time[-1]), 0.5 * share * r.duration) for r in records]
            middles = [r.between(m - half, m + half) for r, (m, half) in zip(records, spans, strict=True)]
            self.scout = Part(nominal, middles)
        self.sheet = {i.name: float(v) for i, v in zip(nominal.table, nominal.theta().detach(), strict=True)}
        nominal.aliases = {
            (i.component, i.symbol): i.name for i in nominal.table
        }  # whatever is added, names stay
        self.usual = dict[str, float]() if self.scout is self else self.scout.usual
        self.visited: dict[frozenset[Cause], Model] = {}

    def likelihood(self, system: System) -> Likelihood:
        """Of the records under a model."""
        batch = make_batch(system, self.records, signal_share=0.0)
        theta = system.theta().detach()[:, None].expand(-1, batch.rows)
        engine = compiled_for(system, Engine())
        followed = REMEMBERED if system.memory_rows else FOLLOWED
        rate = min(fastest_rate(system, engine, batch, theta) / followed, FASTEST)
        substeps = max(1, math.ceil(rate * batch.sample_time))
        return Likelihood(system, replace(engine, substeps=substeps), batch)

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
        if near is not None and len(system.speed_rows) != len(near.system.speed_rows):
            near, quick = None, False  # a further body is followed from afar
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
            if name in self.sheet and not self.idle(name):
                mean[k], spread[k] = self.sheet[name], FRICTION if name.startswith("F_") else TOLERANCE
            else:  # of the size at which it was first tried
                mean[k] = self.usual.setdefault(name, float(start[k]))
        own = torch.tensor([name in self.usual for name in names], dtype=torch.bool)
        plain = (bounds.lower < 0) | (mean <= 0)
        slab = SLAB * torch.maximum(mean.abs(), bounds.scale)
        loose = 10.0 * torch.maximum(mean.abs(), bounds.scale)
        mean = torch.where(plain & own, torch.zeros_like(mean), mean)
        covariance = torch.diag(torch.where(plain, torch.where(own, slab, loose), spread).square())
        for cause in causes:
            rows = [names.index(name) for name in cause.values]
            if rows and not own[rows].any():
                covariance[rows, rows] = 0.01
                covariance[torch.tensor(rows)[:, None], torch.tensor(rows)] += CHANGED**2
        given = bounds.prior_precision
        vary = torch.where(own, 0.0, VARIES).to(mean)
        precision = torch.linalg.inv(covariance) + torch.diag(given * ~own)
        return Prior(tuple(names), bounds, mean, ~plain, precision, vary)

    def candidates(self, model: Model) -> Iterator[tuple[Cause, System]]:
        """Every cause beside a model, at each of its start points."""
        there, rows = model.there, {info.name: info for info in model.there.table}
        groups = dict[tuple[str, ...], list[dict[str, float]]]()
        for name, sheet in self.sheet.items():
            if name in rows and sheet and rows[name].spec.value and not self.idle(name):
                groups[name,] = [{name: rows[name].spec.value}]
        sizes = scales(there, model.likelihood.batch)
        for key, part in there.components.items():  # a loop's gains and limits are set together
            if not isinstance(part, ServoLoop):
                continue
            named = {i.symbol: i.name for i in there.table if i.component == key}
            gains = tuple(name for s, name in named.items() if s.startswith("k_") and self.sheet.get(name))
            if len(gains) > 1:
                groups[gains] = [{name: rows[name].spec.value for name in gains}]
            (size,) = (size for size in sizes if key.startswith(f"joint{size.joint}/"))
            largest = {"tau_max": size.command}
            if "k_p" in part.specs:  # as where the loop just does not swing
                largest["k_d"] = 2.0 * math.sqrt(part.specs["k_p"].value * size.inertia) * size.ratio
            lost = {
                named[symbol]: [share * largest[symbol] for share in LOST]
                for symbol in ("k_d", "tau_max")
                if symbol in named and symbol in largest and self.idle(named[symbol])
            }
            for n in range(1, len(lost) + 1):
                for names in itertools.combinations(lost, n):
                    starts = itertools.product(*(lost[name] for name in names))
                    groups[names] = [dict(zip(names, values, strict=True)) for values in starts]
        for group, starts in groups.items():
            cause = Cause(",".join(group))
            free = [rows[name].spec.estimate for name in group]
            if any(set(group) & set(other.values) for other in model.causes):
                continue
            if all(free) and all(abs(self.misses(model, name)) < BEYOND for name in group):
                continue
            for values in starts:
                with suppress(InputError):
                    specs = {n: replace(rows[n].spec.at(v), estimate=True) for n, v in values.items()}
                    yield cause, there.with_specs(specs)
        for size in sizes:
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

    def idle(self, name: str) -> bool:
        """Whether a held value is at the end of what is declared for it, where it does nothing."""
        info = self.nominal.parameter(name)
        declared = cast(Component, self.nominal.components[info.component]).declared[info.symbol]
        return not info.spec.estimate and self.sheet[name] in (declared.lower, declared.upper)

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
        """The model with each further cause, likeliest first; the best of them estimated to their ends.

        From where the model's estimation ends, and from its data sheet's values, which what is missing has not bent.
        """
        scout, chosen = self.scout, {name for cause in model.causes for name in cause.values}
        sheet = {n: v for n, v in self.sheet.items() if n in model.estimates and n not in chosen}
        origins = [
            model if scout is self else scout.fit(model.there, model.causes, model, FEW),
            scout.fit(model.there.with_values(sheet), model.causes, None, FEW),
        ]
        looked = list[Model]()
        for origin in origins:
            starts, first = dict[Cause, list[System]](), dict[Cause, Model]()
            for cause, system in scout.candidates(origin):
                starts.setdefault(cause, []).append(system)
            for cause, systems in starts.items():
                # a further body has to be followed from afar: only from where its errors begin least
                afar = len(systems[0].speed_rows) != len(model.system.speed_rows) or len(cause.values) > 1
                if afar and origin is not origins[0]:
                    continue
                if afar:
                    systems = [min(systems, key=scout.begins)]
                for system in systems:
                    with suppress(InputError):
                        causes = model.causes | {cause}
                        tried = scout.fit(system, causes, origin, AFAR if afar else 1, quick=not afar)
                        if cause not in first or tried.total > first[cause].total:
                            first[cause] = tried
            ranked = sorted(first.values(), key=lambda tried: -tried.total)
            looked += [scout.fit(tried.there, tried.causes, tried, FEW) for tried in ranked[:NEXT]]
        looked.sort(key=lambda tried: -tried.total)
        looked = [self.fit(tried.there, tried.causes, tried) for tried in looked[:DEEP]]
        best = dict[frozenset[Cause], Model]()
        for tried in sorted(looked, key=lambda tried: -tried.total):
            best.setdefault(tried.causes, tried)
        return list(best.values())

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
        pieces = torch.stack([model.pieces() for model in sets])
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
        quiet = dict[int, Tensor]()  # noise by the number of bodies, at the data sheet's values
        every = max(2, round(AHEAD / base.likelihood.batch.sample_time))
        players = {str(cause): list(cause.values) for cause in sorted(best.causes)}
        taken, moved = {name for names in players.values() for name in names}, dict[str, float]()
        for name, (value, std) in best.estimates.items():
            if name in base.estimates and name not in taken:
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
                likelihood, bodies = self.likelihood(system), len(system.speed_rows)
                if bodies not in quiet:
                    quiet[bodies] = estimate(likelihood, best.prior.none()).logs
                logs = quiet[bodies]
                found = likelihood.alone(theta, logs.expand(len(sets), -1), every).sum((1, 2)).tolist()
                left |= {values | set(kept): found[k] for k, values in enumerate(sets)}
        return shapley([*players], left), left[frozenset()], left[frozenset(players)]


def in_pieces(by_sample: Tensor) -> Tensor:
    """Sums over each of at least :data:`PIECES` pieces of the records of what samples have, ``(R, T)``."""
    return torch.cat([part.sum(1) for part in by_sample.tensor_split(math.ceil(PIECES / len(by_sample)), 1)])


def errs_more(models: Mapping[str, Model], than: Mapping[str, Model]) -> bool:
    """Whether models surely err more than others while they run by themselves, over the records' pieces."""
    more = torch.cat([(model.alone - than[n].alone) / than[n].alone.sum() for n, model in models.items()])
    error = float(more.std()) / math.sqrt(len(more))
    return not bool(more.isfinite().all()) or float(more.mean()) > SURELY * error


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
        choices = [(gain, models) for gain, models in choices if gain > 0.0 and not errs_more(models, best)]
        if not choices:
            break
        _, chosen = max(choices, key=lambda choice: choice[0])
        stale = list(chosen)
        for name, model in chosen.items():
            model = parts[name].fit(model.there, model.causes, model)
            found = parts[name].pruned(model)
            if found.total < best[name].total:  # a hope that did not come true
                found = best[name]
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

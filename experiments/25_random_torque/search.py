"""Which causes a machine has: each candidate re-fitted in the likelihood of the prediction errors, the best kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import torch
from sigma_points import Estimate, Likelihood, estimate
from torch import Tensor

from hybrid_id.components import CATALOGUE, Cogging, Component
from hybrid_id.components.site import Scales
from hybrid_id.diagnosis.catalogue import with_effect
from hybrid_id.diagnosis.scales import scales
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

TOLERANCE, FRICTION, OWN, SLAB = 0.3, 1.0, 1.0, 2.0
"""By what a data sheet misses a value, a friction, and an effect's usual size, as standard deviations of logarithms;
and of a size of either sign, in its usual sizes."""
PRICE = math.log(2.0) + math.log(25.0)
"""What a further cause must bring: even odds that there is one, times as many that it might be."""
FIRST, STAGES, MOST = 2, ((6, 6), (3, 30)), 5
"""Iterations of a first fit; how many of the best are fitted on, and with how many more; causes at most."""

WAVES, STARTS, REPEATED = 200, 3, 2.0
"""Waves of a torque over the rotor's angle a turn at most; start points; waves over all motion at least."""

Kind = tuple[str, str]
"""A cause by effect and place, or by a value's name and "value"."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model with a set of causes, where its fit ends."""

    members: frozenset[Kind]
    system: System
    likelihood: Likelihood
    end: Estimate

    @property
    def total(self) -> float:
        """Evidence with the prior of so many causes."""
        return self.end.evidence - PRICE * len(self.members)

    @property
    def there(self) -> System:
        """The system with its estimated values."""
        pairs = zip(self.system.table, self.end.theta.tolist(), strict=True)
        values = {info.name: min(max(v, info.spec.lower), info.spec.upper) for info, v in pairs}
        return self.system.with_values(values)


class Search:
    """The search for the causes of one machine.

    Args:
        nominal: what the user believes.
        records: of the machine.
        say: is told what was tried.
    """

    def __init__(
        self, nominal: System, records: Sequence[Record], say: Callable[[str], None] = print
    ) -> None:
        self.nominal, self.records, self.say, self.fits = nominal, records, say, 0
        self.sheet = {i.name: float(v) for i, v in zip(nominal.table, nominal.theta().detach(), strict=True)}

    def batch(self, system: System) -> Batch:
        """The records, prepared for a model."""
        return make_batch(system, self.records, signal_share=0.0)

    def likelihood(self, system: System) -> Likelihood:
        """Of the records under a model."""
        batch = self.batch(system)
        theta = system.theta().detach()[:, None].expand(-1, batch.rows)
        return Likelihood(system, with_substeps(system, compiled_for(system, Engine()), batch, theta), batch)

    def fit(
        self, system: System, members: frozenset[Kind], logs: Tensor | None = None, iterations: int = 30
    ) -> Fitted:
        """Estimate a model from its own values, and the noise from another one's if given."""
        self.fits += 1
        likelihood = self.likelihood(system)
        if logs is not None and len(logs) != len(likelihood.first):  # a body more has a torque of its own
            logs = None
        bounds, start = make_bounds(system, likelihood.free), system.theta().detach()[likelihood.free]
        names = [system.table[i].name for i in likelihood.free]
        mean = torch.tensor([self.sheet.get(n, float(v)) for n, v in zip(names, start, strict=True)]).to(
            start
        )
        tolerance = torch.tensor(
            [FRICTION if n.startswith("F_") else TOLERANCE if n in self.sheet else OWN for n in names]
        ).to(start)
        own = torch.tensor([n not in self.sheet for n in names])
        signed = own & ((bounds.lower < 0) | (start <= 0))
        slab = SLAB * torch.maximum(start.abs(), bounds.scale)
        bounds = replace(
            bounds,
            prior_mean=torch.where(signed, torch.zeros_like(mean), mean),
            prior_precision=torch.where(signed, slab.square().reciprocal(), bounds.prior_precision),
        )
        return Fitted(
            members,
            system,
            likelihood,
            estimate(likelihood, bounds, tolerance, logs=logs, iterations=iterations),
        )

    def candidates(self, model: Fitted) -> Iterator[tuple[Kind, System]]:
        """Every cause beside a model, at each of its start points."""
        there = model.there
        for info in there.table:
            if info.spec.value and not info.spec.estimate and info.name in self.sheet:
                with suppress(InputError):
                    yield (
                        (info.name, "value"),
                        there.with_specs({info.name: replace(info.spec, estimate=True)}),
                    )
        for size in scales(there, model.likelihood.batch):
            for effect in CATALOGUE.values():
                for where, models in with_effect(effect, there, size).items():
                    if (effect.name, where) in model.members:
                        continue
                    for system in self.waves(model, size) if effect.name == "cogging" else models:
                        yield (effect.name, where), system

    def waves(self, model: Fitted, size: Scales) -> list[System]:
        """A model with the torques over a rotor's angle that would explain most of its prediction errors."""
        where, turns = f"joint{size.joint}/motor", size.turns / (2.0 * math.pi)
        system = model.there.with_component(where, Cogging(T_c=0.0, T_s=0.0))
        likelihood, names = self.likelihood(system), [info.name for info in system.table]
        symbols = {info.symbol: info.name for info in system.table if info.component == f"{where}/cogging"}
        row = {symbol: names.index(name) for symbol, name in symbols.items()}
        periods = torch.arange(max(1, math.ceil(REPEATED / turns)), WAVES + 1).to(model.end.theta)
        left, base = model.end.errors.flatten(), model.end.slopes.flatten(0, 2)
        amplitude, limit = 0.1 * size.torque, 3.0 * size.torque
        ranked = list[tuple[float, list[float]]]()
        for some in periods.split(20):
            theta = system.theta().detach()[:, None].repeat(1, 2 * len(some))
            theta[row["n"]] = some.repeat_interleave(2)
            theta[row["T_c"], ::2] = theta[row["T_s"], 1::2] = amplitude
            errors, _ = likelihood.errors(theta, model.end.logs.expand(theta.shape[1], -1))
            columns = (errors.flatten(1) - left).T
            columns = columns - base @ torch.linalg.lstsq(base, columns).solution
            for n, pair in zip(some.tolist(), columns.split(2, 1), strict=True):
                found = -torch.linalg.lstsq(pair, left[:, None]).solution[:, 0]
                gain = float((pair @ found).square().sum())
                ranked.append((gain, [n, *(amplitude * found).tolist()]))
        best = sorted(ranked, key=lambda entry: -entry[0])[:STARTS]
        found = list[System]()
        for _, (n, cosine, sine) in best:
            specs = {symbols["n"]: replace(system.parameter(symbols["n"]).spec, value=n)}
            for symbol, value in (("T_c", cosine), ("T_s", sine)):
                specs[symbols[symbol]] = Bounded(min(max(value, -limit), limit), -limit, limit, unit="N m")
            found.append(system.with_specs(specs))
        return found

    def without(self, model: Fitted, kind: Kind) -> System:
        """The model's system without a cause."""
        (name, where), system = kind, model.there
        if where == "value":
            return system.with_specs({name: self.nominal.parameter(name).spec})
        was, now = (cast("dict[str, Component]", dict(s.components.items())) for s in (self.nominal, system))
        for key, part in now.items():
            place, _, law = key.rpartition("/")
            effect = type(part).effect
            if key in was or place != where or effect is None or effect.name != name:
                continue
            # where it took the place of another one, that comes back
            before = next((k for k in was if k.startswith(f"{place}/") and k not in now), None)
            if before is not None:
                return system.with_component(place, was[before])
            return system.without_component(place, law)
        raise KeyError(kind)

    def run(self) -> Fitted:
        """The likeliest model found by adding and removing single causes."""
        base = best = self.fit(self.nominal, frozenset())
        self.say(f"   nothing: {base.total:.1f} {base.end.status}")
        while len(best.members) < MOST:
            first = dict[Kind, Fitted]()
            for kind, system in self.candidates(best):
                with suppress(InputError):
                    tried = self.fit(system, best.members | {kind}, best.end.logs, FIRST)
                    if kind not in first or tried.total > first[kind].total:
                        first[kind] = tried
            grown = list(first.values())
            for keep, iterations in STAGES:
                grown = sorted(grown, key=lambda tried: -tried.total)[:keep]
                grown = [self.fit(tried.there, tried.members, tried.end.logs, iterations) for tried in grown]
            grown.sort(key=lambda tried: -tried.total)
            gains = {
                " at ".join(*(tried.members - best.members)): tried.total - best.total for tried in grown
            }
            self.say("     " + ", ".join(f"{name} {gain:.0f}" for name, gain in gains.items()))
            settled = grown[:1]
            if not best.members:  # from the data sheet too, where the optimum without the cause misled
                for tried in grown[:2]:
                    own = {info.name for info in tried.system.table}
                    values = {name: value for name, value in self.sheet.items() if name in own}
                    settled.append(self.fit(tried.system.with_values(values), tried.members))
            found = max(settled, key=lambda fitted: fitted.total, default=best)
            if found.total <= best.total:
                break
            for kind in sorted(found.members) if len(found.members) > 1 else ():
                less = self.fit(self.without(found, kind), found.members - {kind}, found.end.logs)
                if less.total > found.total:
                    found = less
            self.say(f"   {sorted(found.members)}: {found.total - base.total:.1f} {found.end.status}")
            if found.members == best.members:
                break
            best = found
        return best

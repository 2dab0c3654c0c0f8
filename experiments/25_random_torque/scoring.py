"""Parameters and noise that suit records best, by Fisher's scoring from finite differences of the prediction errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from sigma_points import Likelihood
from torch import Tensor

from hybrid_id.identification.least_squares import Bounds, bounded_lm_step

ITERATIONS, NATS = 30, 0.03
"""Of a fit at most; gain below which it ends."""
APART, LEAST, FIRST, LARGEST = 10.0, 1e-3, 0.03, 0.2
"""Differences by which errors are differentiated: what moves all errors together by so many standard deviations, which
jumps of friction at single samples are small beside; of a value's size the least, the first, and the largest."""
LOG_ASIDE = 0.05
"""The same of the noise's logarithms."""
REACH = (-0.6, 1.5)
"""Largest step of a parameter, over its size."""
TRIES = ((0.0, 1.0), (0.0, 0.3), (1.0, 1.0), (30.0, 1.0))
"""Steps tried side by side: factor of the damping, and share of the step; none at all goes along what records do not
tell."""


@dataclass(frozen=True)
class Prior:
    """Of the free values: Gaussian about a mean, of the logarithm where a value is a size above zero.

    Attributes:
        names: of the values.
        bounds: their box.
        mean: middle of each, ``(n_f,)``.
        sizes: whether it is the logarithm's.
        precision: of all, ``(n_f, n_f)``.
        vary: by which share of itself each differs from record to record, as a standard deviation, ``(n_f,)``.
    """

    names: tuple[str, ...]
    bounds: Bounds
    mean: Tensor
    sizes: Tensor
    precision: Tensor
    vary: Tensor

    def none(self) -> Prior:
        """Of no value: all stay, and only the noise is estimated."""
        bounds = Bounds(*(value[:0] for value in vars(self.bounds).values()))
        return Prior((), bounds, self.mean[:0], self.sizes[:0], self.precision[:0, :0], self.vary[:0])

    def at(self, values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Cost at some values, its gradient, and its Gauss-Newton matrix."""
        size = torch.where(self.sizes, values.clamp_min(1e-12 * self.mean.abs()), 1.0)
        off = torch.where(
            self.sizes, (size / torch.where(self.sizes, self.mean, 1.0)).log(), values - self.mean
        )
        pull = self.precision @ off
        return 0.5 * off @ pull, pull / size, self.precision / torch.outer(size, size)


def differences(told: Tensor, values: Tensor, bounds: Bounds) -> Tensor:
    """Differences of values within their box along the axes of what is known of them, a column each, ``(n, n)``.

    Args:
        told: Fisher's matrix of relative changes, ``(n, n)``.
        values: where they start, ``(n,)``.
        bounds: of these.
    """
    identity = torch.eye(len(values)).to(values)
    if not len(values):
        return identity
    if not told.isfinite().all():  # the model is lost here
        told = identity
    size = torch.maximum(values.abs(), bounds.scale)
    for axes in (torch.linalg.eigh(told)[1], identity):  # else one value at a time
        lengths = APART / torch.einsum("ik,ij,jk->k", axes, told, axes).clamp_min(1e-12).sqrt()
        aside = size[:, None] * axes * lengths.clamp(LEAST, LARGEST)
        above, below = (bounds.upper - values)[:, None], (values - bounds.lower)[:, None]
        ahead, behind = (
            torch.where(way > 0, above / way, torch.where(way < 0, -below / way, 1.0)).clamp(0.0, 1.0).amin(0)
            for way in (aside, -aside)
        )
        if bool((torch.maximum(ahead, behind) > 0.05).all()):
            break
    return aside * torch.where(ahead >= behind, ahead, -behind)


@dataclass(frozen=True)
class Estimate:
    """Where :func:`estimate` ends.

    Attributes:
        theta: all parameters, ``(n_p,)``.
        logs: logarithms of the noise.
        cost: minus the logarithm of likelihood and prior, what differs from record to record integrated out.
        each: of it what each record's likelihood is, ``(R,)``.
        own: by how many of its standard deviations each value that varies differs in each record, ``(R, n_v)``.
        varying: names of these.
        status: "converged", "stalled" or "max_iterations".
        errors, variances: white prediction errors and logarithms of their variances, ``(R, T, n_y)``.
        names: of the values that were free, and of the noise behind them.
        by_error, by_variance: slopes of errors and variances by these, ``(N, n)``.
        precision: of the free values' prior, ``(n_f, n_f)``.
        hessian: of the cost by the free values, the noise and the records' own values eliminated.
        told: the same with these held.
        history: cost after each iteration.
    """

    theta: Tensor
    logs: Tensor
    cost: float
    each: Tensor
    own: Tensor
    varying: tuple[str, ...]
    status: str
    errors: Tensor
    variances: Tensor
    names: tuple[str, ...]
    by_error: Tensor
    by_variance: Tensor
    precision: Tensor
    hessian: Tensor
    told: Tensor
    history: tuple[float, ...]

    @property
    def evidence(self) -> float:
        """Logarithm of the marginal likelihood, by Laplace."""
        return -self.cost - 0.5 * float(torch.logdet(self.hessian) - torch.logdet(self.precision))


def estimate(
    likelihood: Likelihood,
    prior: Prior,
    *,
    near: Estimate | None = None,
    iterations: int = ITERATIONS,
    quick: bool = False,
) -> Estimate:
    """The likeliest values and noise from the system's own values.

    Args:
        likelihood: of the records.
        prior: of the free values.
        near: of a model beside this one, whose noise is the first, and the records' own values.
        iterations: at most.
        quick: whether the slopes by the values that both have are taken from there.
    """
    theta, table = likelihood.system.theta().detach().clone(), likelihood.system.table
    free = [i for i, info in enumerate(table) if info.name in prior.names]
    bounds, count, records = prior.bounds, len(free), len(likelihood.batch.y)
    names = (*prior.names, *(f"{name} {k}" for name, k in likelihood.entries))
    logs, known = likelihood.first if near is None else near.logs, near if quick else None
    damping, history, status = 1e-2, list[float](), "max_iterations"
    new = [k for k, name in enumerate(names) if known is None or name not in known.names]
    same = [k for k in range(len(names)) if k not in new]
    if known is not None:
        there = [known.names.index(names[k]) for k in same]
    varies = prior.vary.nonzero().flatten().tolist()
    off = theta.new_zeros(records, len(varies))  # of each record's own values, in their standard deviations
    identity = torch.eye(len(varies)).to(theta)
    varying = tuple(names[k] for k in varies)
    for k, name in enumerate(varying):
        if near is not None and name in near.varying:
            off[:, k] = near.own[:, near.varying.index(name)]

    def of_records(guesses: Tensor, off: Tensor) -> Tensor:
        """All parameters ``(n_p, K, R)`` of guesses ``(n_p, K)``."""
        found = guesses[:, :, None].repeat(1, 1, records)
        rows = [free[k] for k in varies]
        spread = prior.vary[varies] * torch.maximum(guesses[rows].abs().mT, bounds.scale[varies])
        found[rows] += (spread[:, None] * off).permute(2, 0, 1)
        low, high = (bound[varies][:, None, None] for bound in (bounds.lower, bounds.upper))
        found[rows] = torch.maximum(torch.minimum(found[rows], high), low)
        return found

    def each(white: Tensor, logarithms: Tensor, off: Tensor) -> Tensor:
        """Cost of each record."""
        return 0.5 * ((white.square() + logarithms).view(records, -1).sum(1) + off.square().sum(1))

    size = torch.maximum(theta[free].abs(), bounds.scale)
    told = torch.full_like(size, APART / FIRST).square().diag()  # Fisher's matrix of relative changes
    if near is not None:
        pairs = [(k, near.names.index(n)) for k, n in enumerate(prior.names) if n in near.names]
        if pairs:
            here, beside = (torch.tensor(rows) for rows in zip(*pairs, strict=True))
            told[here[:, None], here] = near.told[beside[:, None], beside] * torch.outer(
                size[here], size[here]
            )
    tries = TRIES if known is None else TRIES[::2]
    moved_on, settled = True, known is not None  # the first axes are a guess
    for _ in range(iterations):
        if moved_on:  # else only the damping is another one
            values = theta[free]
            size = torch.maximum(values.abs(), bounds.scale)
            moving = torch.tensor([k for k in new if k < count], dtype=torch.long)
            box = Bounds(*(value[moving] for value in vars(bounds).values()))
            aside = differences(told[moving[:, None], moving], values[moving], box)
            guesses = theta[:, None].repeat(1, 1 + len(new))
            guesses[torch.tensor(free, dtype=torch.long)[moving], 1 : 1 + len(moving)] += aside
            noises = logs.repeat(1 + len(new), 1)
            for column, k in enumerate(new, 1):
                if k >= count:
                    noises[column, k - count] += LOG_ASIDE
            errors, variances = (
                part.flatten(1) for part in likelihood.errors(of_records(guesses, off), noises)
            )
            by_error, by_variance = (errors.new_empty(errors.shape[1], len(names)) for _ in range(2))
            by_value = torch.eye(len(new)).to(theta) / LOG_ASIDE  # from differences along axes
            by_value[: len(moving), : len(moving)] = torch.linalg.inv(aside)
            by_error[:, new] = (errors[1:] - errors[0]).T @ by_value
            by_variance[:, new] = (variances[1:] - variances[0]).T @ by_value
            if known is not None:
                by_error[:, same], by_variance[:, same] = (
                    known.by_error[:, there],
                    known.by_variance[:, there],
                )
            own_error, own_variance = (part.view(records, -1, len(names)) for part in (by_error, by_variance))
            apart = own_error + 0.5 * errors[0].view(records, -1, 1) * own_variance
            fishers = apart.mT @ apart + 0.5 * own_variance.mT @ own_variance
            slopes = 0.5 * own_variance.sum(1) + torch.einsum(
                "rn,rnk->rk", errors[0].view(records, -1), own_error
            )
            spread = prior.vary[varies] * size[varies]
            across = fishers[:, varies] * spread[:, None]
            inner = across[:, :, varies] * spread + identity
            pull = slopes[:, varies] * spread + off
            back = torch.linalg.solve(inner, across)
            widened = 0.5 * torch.linalg.slogdet(inner)[1]
            fisher = (fishers - across.mT @ back).sum(0)
            gradient = (slopes - torch.einsum("rvk,rv->rk", back, pull)).sum(0)
            more, slope, precision = prior.at(values)
            cost = float((each(errors[0], variances[0], off) + widened).sum()) + float(more)
            gradient[:count] += slope
            fisher[:count, :count] += precision
            history = history or [cost]
            fisher[range(count, len(names)), range(count, len(names))] += 1e-3
            told = (fishers.sum(0)[:count, :count] + precision) * torch.outer(size, size)
            low, high = (likelihood.low - logs).clamp_min(-2.0), (likelihood.high - logs).clamp_max(2.0)
            low = torch.cat([torch.maximum(bounds.lower - values, REACH[0] * size), low])
            high = torch.cat([torch.minimum(bounds.upper - values, REACH[1] * size), high])
        unit = fisher.diagonal().clamp_min(1e-300).rsqrt()
        moved, offs = [], []
        for factor, share in tries:
            parts = (
                part[None]
                for part in (fisher, gradient, unit, torch.full_like(unit, factor * damping), low, high)
            )
            moved.append(share * bounded_lm_step(*parts)[0][0] * unit)
            turn = torch.linalg.solve(inner, (pull + across @ moved[-1])[..., None])[..., 0]
            offs.append(off - share * turn / (1.0 + factor * damping))
        guesses = theta[:, None].repeat(1, len(moved))
        guesses[free] += torch.stack(moved)[:, :count].T
        tried = torch.stack([of_records(guesses[:, k : k + 1], own)[:, 0] for k, own in enumerate(offs)], 1)
        noises = logs + torch.stack(moved)[:, count:]
        found = [part.flatten(1) for part in likelihood.errors(tried, noises)]
        costs = [
            float((each(e, v, own) + widened).sum()) + float(prior.at(guesses[free, k])[0])
            for k, (e, v, own) in enumerate(zip(*found, offs, strict=True))
        ]
        best = min(range(len(costs)), key=lambda k: costs[k] if math.isfinite(costs[k]) else math.inf)
        moved_on = costs[best] < cost
        if not moved_on and not settled:
            moved_on = settled = True
            continue
        if not moved_on:
            damping *= 1e3
            if damping > 1e8:
                status = "stalled"
                break
            continue
        theta, logs, off = guesses[:, best].clone(), noises[best], offs[best]
        damping = max(damping * (tries[best][0] or 0.1), 1e-10)
        errors, variances = found[0][best][None], found[1][best][None]
        history.append(costs[best])
        if cost - costs[best] < NATS and settled:
            status = "converged"
            break
        settled = True
    noise = fisher[count:, count:]
    hessian = fisher[:count, :count] - fisher[:count, count:] @ torch.linalg.solve(
        noise, fisher[count:, :count]
    )
    precision = prior.at(theta[free])[2]
    shape = likelihood.batch.y.shape
    return Estimate(
        theta, logs, history[-1], each(errors[0], variances[0], off) + widened, off, varying, status,
        errors[0].view(shape), variances[0].view(shape), names, by_error, by_variance, precision, hessian,
        told / torch.outer(size, size),
        tuple(history),
    )  # fmt: skip

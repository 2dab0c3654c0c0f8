"""Prediction errors by a sigma-point Kalman filter: a random torque at each joint stands for all that no law describes.

    x' = f(x, u, theta, w),    y = h(x) + v

``w``, an Ornstein-Uhlenbeck process at each body that a sensor sees, is an acceleration: so no fit buys a smaller
torque by a smaller inertia. ``v`` is the sensors' noise and what the scatter of their sampling moments makes of it. The
filter follows the records, so that it is never lost, and sees of each sample only what was before it, so that its
errors are a likelihood, a plain function of the parameters; with no torque it is the free run's. Whether friction holds
is decided at every sigma point by the model itself.

Source: L. Ljung, System Identification, 2nd ed., 1999, 7.4 (prediction errors as a likelihood); I. Arasaratnam,
S. Haykin, "Cubature Kalman filters", IEEE Trans. Automatic Control 54, 2009.
"""

from __future__ import annotations

import functools
import math
from ctypes import CDLL
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from hybrid_id.identification.least_squares import Bounds, bounded_lm_step
from hybrid_id.simulation import compiled
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import call, library
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import PUSH, System

TINY = 1e-9
"""Least standard deviation of a state in the filter, over its largest value."""
WEAKEST = 14.0
"""Least logarithm of the random torque's strength, below that of the records' acceleration."""
ITERATIONS, NATS = 30, 0.1
"""Of a fit at most; gain below which it ends."""
ASIDE, LOG_ASIDE = 1e-4, 0.02
"""Differences by which errors are differentiated, of a parameter's size and of the noise's logarithms."""
REACH = (-0.6, 1.5)
"""Largest step of a parameter, over its size."""
FACTORS = (0.1, 1.0, 10.0, 100.0)
"""Of the damping, tried side by side."""


@functools.cache
def _filter() -> CDLL:
    own = Path(__file__).with_name("sigma_points.c").read_text(encoding="utf-8")
    return library(compiled._sources("lanes.h", "engine.c") + own, ("predict",), compiled.FLAGS)


class Likelihood:
    """The prediction errors of records under a model, by its free parameters and the noise.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: records, prepared for it, with the noise of their outputs as weights.

    Attributes:
        free: indices of the parameters that a fit moves.
        pushed: rows of the state that random torques accelerate: the speeds that outputs tell.
        rate: of each output [its unit/s], ``(R, T, n_y)``.
        entries: name and number of each entry of the noise: ``strength``, the standard deviation of the random torque
            at a speed over the inertia there [rad/s^2], and its correlation ``time`` [s]; of an output the ``scale``
            of its standard deviation, as the batch's weights have it, and the ``jitter`` of its moments [s].
        low, high: bounds of their logarithms.
        first: where a fit begins.
    """

    def __init__(self, system: System, engine: Engine, batch: Batch) -> None:
        # behind a rigid gear what the link does is what the motor does, over the ratio
        y, weight, names = batch.y.clone(), batch.weight.clone(), list(batch.outputs)
        for o, name in enumerate(names):
            joint = system.joint(int(name[len(name.rstrip("0123456789")) :]))
            if name not in system.state_names and name[:3] in ("q_a", "v_a") and joint.rigid:
                names[o] = f"{name[0]}_m{joint.number}"
                y[..., o] *= joint.gear_ratio
                weight[..., o] /= joint.gear_ratio
        batch = replace(batch, y=y, weight=weight, outputs=tuple(names))
        self.system, self.engine, self.batch, self.free = system, engine, batch, system.estimated
        hidden = {row for joint in system.joints for row in joint.hidden_rows(batch.outputs)}
        self.pushed = [row for row in system.speed_rows if row not in hidden]
        rows = [system.state_names.index(name) for name in batch.outputs]
        speeds = [row + 1 if row + 1 in system.speed_rows else None for row in rows]
        self.rate = torch.stack(
            [torch.zeros_like(batch.dt) if row is None else batch.x[..., row] for row in speeds], -1
        )
        moves = (batch.dt[:, :-1] > 0)[..., None]
        change = batch.x[..., self.pushed].diff(dim=1) / batch.dt[:, :-1, None].where(
            moves, torch.ones(()).to(batch.x)
        )
        usual = (change.square() * moves).sum((0, 1)).div(moves.sum()).sqrt().clamp_min(1e-6).log()
        step, longest = math.log(batch.sample_time), math.log(float(batch.dt.sum(1).max()))
        torques, outputs = len(self.pushed), len(rows)
        self.entries = [(name, k) for name in ("strength", "time") for k in range(torques)]
        self.entries += [(name, k) for name in ("scale", "jitter") for k in range(outputs)]
        limits = {
            "strength": [(float(u) - WEAKEST, float(u), float(u)) for u in usual],
            "time": [(step - 1.6, step + 1.6, longest)] * torques,
            "scale": [(-0.5 * math.log(12.0), 0.0, 9.0)] * outputs,
            "jitter": [(step - 7.0, step - 4.6, step)] * outputs,
        }
        bounds = torch.tensor([limits[name][k] for name, k in self.entries]).to(batch.x)
        self.low, self.first, self.high = bounds.unbind(1)

        self.variance = torch.where(weight > 0, weight.clamp_min(1e-300) ** -2, torch.zeros_like(weight))
        self.rows = torch.tensor(rows)
        self.pushes = [f"{PUSH}{system.speed_rows.index(row)}" for row in self.pushed]

    def errors(self, theta: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Prediction errors in their standard deviations, and the logarithms of their variances.

        Args:
            theta: all parameters of K guesses, ``(n_p, K)``.
            logs: logarithms of their noise, ``(K, n)`` in the order of ``entries``.

        Returns:
            ``(K, R, T, n_y)`` each.
        """
        batch, guesses, (records, samples, outputs) = self.batch, theta.shape[1], self.batch.y.shape
        rows, each = guesses * records, theta.repeat_interleave(records, 1)
        u = dict(batch.u)
        if any(joint.drive.delay for joint in self.system.joints):
            u = {name: channel.repeat(guesses, 1) for name, channel in u.items()}
        u = dict(compiled._arrived(self.system, u, each))
        u |= {name: batch.dt.new_zeros(1, samples) for name in self.pushes}
        equations, constants = compiled._equations(self.system, self.engine, tuple(u))
        channels = [channel.contiguous() for channel in u.values()]
        places = torch.tensor([channel.data_ptr() for channel in channels])
        lengths = torch.tensor([len(channel) for channel in channels])
        strength, time, scale, jitter = (
            logs[:, [i for i, entry in enumerate(self.entries) if entry[0] == name]].exp()
            for name in ("strength", "time", "scale", "jitter")
        )

        def of_rows(*parts: Tensor) -> Tensor:
            return torch.stack(parts, -1).repeat_interleave(records, 0).contiguous()

        sizes = torch.cat([batch.x.abs().amax((0, 1)).clamp_min(1e-6), strength[0].clamp_min(1e-6)])
        errors, variances = (batch.y.new_empty(guesses, records, samples, outputs) for _ in range(2))
        parts = [
            (batch.dt / self.engine.substeps).contiguous(), compiled._values(each, constants), batch.y.contiguous(),
            self.variance, self.rate.square().contiguous(), of_rows(scale.square(), jitter.square()),
            batch.x[:, 0].contiguous(), batch.x0_std.square().contiguous(), of_rows(strength.square(), time),
            (TINY * sizes).square(), self.rows, torch.tensor([list(u).index(name) for name in self.pushes]),
        ]  # fmt: skip
        counts = rows, records, samples, self.engine.substeps, outputs, len(self.pushed)
        call(_filter(), "predict", equations, errors, variances, places, lengths, *parts, *counts)
        return errors, variances


@dataclass(frozen=True)
class Estimate:
    """Where :func:`estimate` ends.

    Attributes:
        theta: all parameters, ``(n_p,)``.
        logs: logarithms of the noise.
        cost: minus the logarithm of likelihood and priors.
        status: "converged", "stalled" or "max_iterations".
        errors, variances: white prediction errors and logarithms of their variances, ``(R, T, n_y)``.
        slopes: of the white errors by the free parameters, ``(R, T, n_y, n_f)``.
        precision: of the free parameters' prior there, ``(n_f,)``.
        hessian: of the cost by the free parameters.
        history: cost after each iteration.
    """

    theta: Tensor
    logs: Tensor
    cost: float
    status: str
    errors: Tensor
    variances: Tensor
    slopes: Tensor
    precision: Tensor
    hessian: Tensor
    history: tuple[float, ...]

    @property
    def evidence(self) -> float:
        """Logarithm of the marginal likelihood, by Laplace."""
        return -self.cost - 0.5 * float(torch.logdet(self.hessian) - self.precision.log().sum())


def sheet_prior(values: Tensor, bounds: Bounds, tolerance: Tensor) -> tuple[Tensor, Tensor]:
    """By how many tolerances values miss their data sheet, in logarithms, and the slope of that by each, ``(n_f,)``.

    Args:
        values: of the free parameters.
        bounds: their box; ``prior_mean`` is what the data sheet says.
        tolerance: standard deviation of each one's logarithm; those that may be below zero have none.
    """
    about = bounds.prior_mean
    sheet = ((about > 0) & (bounds.lower >= 0)) / tolerance
    size = torch.where(sheet > 0, values.clamp_min(1e-12 * about.abs()), 1.0)
    return sheet * (size / about.where(sheet > 0, 1.0)).log(), sheet / size


def estimate(
    likelihood: Likelihood,
    bounds: Bounds,
    tolerance: Tensor,
    *,
    logs: Tensor | None = None,
    iterations: int = ITERATIONS,
) -> Estimate:
    """Parameters and noise that suit the records best, by Fisher's scoring from the system's own values.

    Args:
        likelihood: of the records.
        bounds: box and priors of the free parameters.
        tolerance: by what factor a data sheet may miss each, as a standard deviation of its logarithm, ``(n_f,)``: a
            further prior about ``bounds.prior_mean``, for those above zero; infinite where there is none.
        logs: first logarithms of the noise.
        iterations: at most.
    """
    theta, free = likelihood.system.theta().detach().clone(), likelihood.free
    count = len(free)
    logs = likelihood.first if logs is None else logs
    damping, history, status = 1e-2, list[float](), "max_iterations"

    def prior(values: Tensor) -> float:
        missed, _ = sheet_prior(values, bounds, tolerance)
        return float(bounds.prior_cost(values[None])[0] + 0.5 * missed.square().sum())

    moved_on = True
    for _ in range(iterations):
        if moved_on:  # else only the damping is another one
            values = theta[free]
            size = torch.maximum(values.abs(), bounds.scale)
            aside = torch.where(values + ASIDE * size < bounds.upper, ASIDE * size, -ASIDE * size)
            steps = torch.cat([aside, torch.full_like(logs, LOG_ASIDE)])
            guesses = theta[:, None].repeat(1, 1 + len(steps))
            guesses[free, range(1, 1 + count)] += aside
            noises = logs.repeat(1 + len(steps), 1)
            noises[range(1 + count, 1 + len(steps)), range(len(logs))] += LOG_ASIDE
            errors, variances = (part.flatten(1) for part in likelihood.errors(guesses, noises))
            by_error = ((errors[1:] - errors[0]) / steps[:, None]).T
            by_variance = ((variances[1:] - variances[0]) / steps[:, None]).T
            missed, per_value = sheet_prior(values, bounds, tolerance)
            cost = 0.5 * float(errors[0].square().sum() + variances[0].sum()) + prior(values)
            history = history or [cost]
            gradient = 0.5 * by_variance.sum(0) + errors[0] @ by_error
            apart = by_error + 0.5 * errors[0][:, None] * by_variance
            fisher = apart.T @ apart + 0.5 * by_variance.T @ by_variance
            precision = bounds.prior_precision + per_value.square()
            gradient[:count] += bounds.prior_precision * (values - bounds.prior_mean) + per_value * missed
            fisher[range(count), range(count)] += precision
            fisher[range(count, len(steps)), range(count, len(steps))] += 1e-3
            low = torch.cat(
                [
                    torch.maximum(bounds.lower - values, REACH[0] * size),
                    (likelihood.low - logs).clamp_min(-2.0),
                ]
            )
            high = torch.cat(
                [
                    torch.minimum(bounds.upper - values, REACH[1] * size),
                    (likelihood.high - logs).clamp_max(2.0),
                ]
            )
        unit = fisher.diagonal().clamp_min(1e-300).rsqrt()
        tried = []
        for factor in FACTORS:
            parts = (
                part[None]
                for part in (fisher, gradient, unit, torch.full_like(unit, factor * damping), low, high)
            )
            tried.append(bounded_lm_step(*parts)[0][0] * unit)
        moved = torch.stack(tried)
        guesses = theta[:, None].repeat(1, len(tried))
        guesses[free] += moved[:, :count].T
        found = [part.flatten(1) for part in likelihood.errors(guesses, logs + moved[:, count:])]
        costs = [
            0.5 * float(e.square().sum() + v.sum()) + prior(guesses[free, k])
            for k, (e, v) in enumerate(zip(*found, strict=True))
        ]
        best = min(range(len(costs)), key=lambda k: costs[k] if math.isfinite(costs[k]) else math.inf)
        moved_on = costs[best] < cost
        if not moved_on:
            damping *= FACTORS[-1] / FACTORS[0]
            if damping > 1e8:
                status = "stalled"
                break
            continue
        theta, logs, damping = (
            guesses[:, best].clone(),
            logs + moved[best, count:],
            max(damping * FACTORS[best], 1e-10),
        )
        history.append(costs[best])
        if cost - costs[best] < NATS:
            status = "converged"
            break
    loose = (precision == 0) * (0.1 / bounds.scale).square()
    hessian = fisher[:count, :count] + torch.diag(loose)
    shape = likelihood.batch.y.shape
    return Estimate(
        theta, logs, history[-1], status, errors[0].view(shape), variances[0].view(shape),
        by_error[:, :count].reshape(*shape, count), precision + loose, hessian, tuple(history),
    )  # fmt: skip

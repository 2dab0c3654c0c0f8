"""Least squares of prediction errors: a random torque at each joint stands for all that no law of the model describes.

    x' = f(x, u, theta) + G w,    y = h(x, u, theta) + v

``v`` is the noise of the sensors, ``w`` an Ornstein-Uhlenbeck process at each body that a sensor sees: an acceleration,
so that no fit buys a smaller torque by a smaller inertia. Whitened by it, a drift costs what a random torque of that
size costs, and no more. Its strength is estimated with the parameters: where the model describes a simulated drive it
goes to zero, and the estimate is that of the free run.

Everything is linear about *smoothed* states, where the model need not find the way by itself: one sample of the engine
from each of them, differentiated (:mod:`hybrid_id.simulation.lifted`), the Kalman filter along them
(:mod:`hybrid_id.simulation.kalman`), a step of the parameters, and the smoother for the next states. The first states
are smoothed from the outputs alone. Where the model's friction would hold a joint that the records see sliding, that
sample slides as they have it.

Source: L. Ljung, System Identification, 2nd ed., 1999, chapters 5 and 7.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from kalman import Maps, Predictions, predict, smooth
from scipy.optimize import minimize
from torch import Tensor

from hybrid_id.identification.least_squares import Bounds, bounded_lm_step
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import Linearisation, condense, linearise, linearise_outputs
from hybrid_id.simulation.step import Engine, fill_jacobian, rk4, update_internal_states
from hybrid_id.systems.balance import Directions
from hybrid_id.systems.chain import Channels, Rows, System, Views

STILL = 2.0
"""Standard errors of a smoothed speed within which a joint may be at rest."""
CREEP = 1e-3
"""Its first guess where friction holds, as a share of the largest speed."""
ROUNDS = 30
"""Linearisations at most."""
SETTLED = 0.02
"""Standard errors below which the next step of the parameters ends the fit."""
WORSE = 3
"""Rounds without a lower cost after which the best is taken."""
REACH = (-0.6, 1.5)
"""Largest step of a parameter, over its size."""
OWN_ROUNDS = 6
"""Newton's steps in which states that only another model has are found along the smoothed ones."""
ANYWHERE = 1e4
"""Standard deviation of a first state of which nothing is known [rad, rad/s]."""


@dataclass(frozen=True)
class Noise:
    """What the records add to the model.

    Attributes:
        strength: standard deviation of the random torque at each speed over the inertia there [rad/s^2], ``(n_v,)``.
        time: its correlation time [s], ``(n_v,)``.
        creep: speed of a random walk where the model's friction holds [rad/s], ``(n_v,)``.
        scale: of the outputs' standard deviations, as the batch's weights have them, ``(n_y,)``.
    """

    strength: Tensor
    time: Tensor
    creep: Tensor
    scale: Tensor

    def with_strength(self, factor: float) -> Noise:
        """The same with a random torque of another strength."""
        return replace(self, strength=factor * self.strength)


Block = tuple[list[int], list[int], list[int]]
"""States, random torques and outputs of a joint by their numbers."""


class RandomTorque:
    """The prediction errors of records about smoothed states, and what they say of parameters.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: records, prepared for it, with the noise of their outputs as weights.
        free: indices of the parameters to differentiate by.

    Attributes:
        pushed: rows of the state that random torques accelerate: the speeds that outputs tell.
        x: smoothed states, ``(R, T, n_x)``.
        still: a speed's standard error, :data:`STILL` times, ``(R, T, n_v)``.
        noise: how strong the random torques are, and the outputs' noise.
    """

    def __init__(self, system: System, engine: Engine, batch: Batch, free: Sequence[int]) -> None:
        self.system, self.engine, self.batch, self.free = system, engine, batch, list(free)
        hidden = {row for joint in system.joints for row in joint.hidden_rows(batch.outputs)}
        self.pushed = [row for row in system.speed_rows if row not in hidden]
        measured = batch.weight > 0
        self.variance = torch.where(
            measured, batch.weight.clamp_min(1e-300) ** -2, torch.zeros_like(batch.weight)
        )
        numbers = [int(name[len(name.rstrip("0123456789")) :]) for name in batch.outputs]
        bounds = [
            (joint.positions[0], joint.positions[0] + len(joint.state_names)) for joint in system.joints
        ]
        states, torques, outputs = range(batch.x.shape[2]), range(len(self.pushed)), range(len(batch.outputs))
        self.whole: Block = list(states), list(torques), list(outputs)
        self.blocks: list[Block] = [
            (
                list(range(*ends)),
                [k for k, row in enumerate(self.pushed) if ends[0] <= row < ends[1]],
                [o for o, number in enumerate(numbers) if number == joint.number],
            )
            for joint, ends in zip(system.joints, bounds, strict=True)
        ]
        self._smooth_outputs()

    def _smooth_outputs(self) -> None:
        """The measured states from the outputs alone: angles that a random acceleration drives, and nothing else."""
        batch, n_x = self.batch, self.batch.x.shape[2]
        rows, samples = batch.dt.shape
        theta = self.system.theta().detach().to(batch.x)[:, None].expand(-1, rows)
        seen = linearise_outputs(self.system, batch.x, batch.u, theta, [], batch.outputs)
        a = batch.x.new_zeros(rows, samples, n_x, n_x)
        a[..., range(n_x), range(n_x)] = 1.0
        for row in self.pushed:
            a[..., row - 1, row] = batch.dt
        lin = Linearisation(**vars(seen), x_next=batch.x, a=a, b=a[..., :0])
        # as a map of the states themselves: the outputs are what the guess of them leaves, and the guess
        kinematic = replace(
            lin, y=seen.y - (seen.c @ batch.x[..., None])[..., 0], x_next=torch.zeros_like(batch.x)
        )
        spread = torch.zeros(rows, n_x).to(batch.x)
        for row in self.pushed:
            spread[:, [row - 1, row]] = ANYWHERE
        speed = batch.x[..., self.pushed]
        usual = speed.diff(dim=1).abs().flatten(0, 1).median(0).values / batch.sample_time
        self.x = torch.zeros_like(batch.x)
        self.noise = Noise(
            3.0 * usual.clamp_min(1e-3),
            torch.full_like(usual, 5.0 * batch.sample_time),
            CREEP * speed.flatten(0, 1).abs().amax(0),
            torch.ones_like(batch.weight[0, 0]),
        )
        self._likeliest_noise(kinematic, self.batch.x.new_zeros(0), 0.7, spread)
        maps = self._with(self.maps(kinematic, spread), self.noise)
        states, variances = smooth(maps, predict(maps, keep=True), batch.x.new_zeros(0))
        self.x = batch.x.clone()
        for row in self.pushed:
            self.x[..., [row - 1, row]] = states[..., [row - 1, row]]
        self.still = STILL * variances[..., self.pushed].clamp_min(0.0).sqrt()

    def linearise(self, theta: Tensor) -> Linearisation:
        """One sample of the model from every smoothed state, and the outputs there, with their Jacobians."""
        return self._linear(self.system, self.batch, self.x, theta, self.free)

    def beside(self, theta: Tensor, model: System, batch: Batch) -> Linearisation:
        """One sample of another model, from the same states and from those that it alone has as they follow from them.

        Args:
            theta: all its parameters, ``(n_p,)``.
            model: has all states of this one.
            batch: the same records, prepared for it.
        """
        names = self.system.state_names
        own = [k for k, name in enumerate(model.state_names) if name not in names]
        x = batch.x.clone()
        for k, name in enumerate(model.state_names):
            if name in names:
                x[..., k] = self.x[..., names.index(name)]
        found = self._linear(model, batch, x, theta, [])
        for _ in range(OWN_ROUNDS if own else 0):
            part = replace(
                found, x_next=found.x_next[..., own], a=found.a[..., own, :][..., own], b=found.b[..., own, :]
            )
            step = condense(part, x[..., own].contiguous())[..., -1]
            x = x.clone()
            x[..., own] += step
            found = self._linear(model, batch, x, theta, [])
            size = x[..., own].abs().amax((0, 1)).clamp_min(1e-12)
            if not bool(step.isfinite().all()) or float((step.abs() / size).max()) < 1e-6:
                break
        return found

    def _linear(
        self, system: System, batch: Batch, x: Tensor, theta: Tensor, free: Sequence[int]
    ) -> Linearisation:
        rows, samples, n_x = x.shape
        each = theta[:, None].expand(-1, rows).contiguous()
        lin = linearise(system, self.engine, x, batch.u, batch.dt, each, free, batch.outputs)
        after = torch.cat([x[:, 1:], x[:, -1:]], 1)
        slides = torch.zeros(rows, samples, dtype=torch.bool, device=x.device)
        pushed = [system.state_names.index(self.system.state_names[row]) for row in self.pushed]
        for k, row in enumerate(pushed):
            if system.dry[system.speed_rows.index(row)]:
                held = (lin.x_next[..., row] == 0.0) & (batch.dt > 0)
                slides |= held & (
                    torch.minimum(x[..., row].abs(), after[..., row].abs()) > self.still[..., k]
                )
        lanes = slides.flatten().nonzero().flatten()
        if len(lanes) == 0:
            return lin
        leaves = [column[lanes].clone().requires_grad_() for column in x.flatten(0, 1).unbind(1)]
        values = [value.expand(1) for value in theta]
        for i in free:
            values[i] = theta[i].expand(len(lanes)).clone().requires_grad_()
        p, h = system.views(values), batch.dt.flatten()[lanes] / self.engine.substeps
        speeds = [(x[..., row], after[..., row]) for row in system.speed_rows]
        means = [
            ((now + then) / (now.abs() + then.abs()).clamp_min(1e-12)).flatten()[lanes]
            for now, then in speeds
        ]
        directions = [mean if dry else None for mean, dry in zip(means, system.dry, strict=True)]
        with torch.enable_grad():
            u = system.hold({name: channel.flatten()[lanes] for name, channel in batch.u.items()}, p)
            end = list(leaves)
            for _ in range(self.engine.substeps):
                end = update_internal_states(system, end, u, p, 0.5 * h)
                end = rk4(end, h, lambda now: _sliding(system, now, u, p, directions))
                end = update_internal_states(system, end, u, p, 0.5 * h)
            end = [row.expand(len(lanes)) for row in end]
        jacobian = x.new_zeros(n_x, n_x + len(free), len(lanes))
        fill_jacobian(jacobian, end, [*leaves, *(values[i] for i in free)])
        x_next, a, b = lin.x_next.clone(), lin.a.clone(), lin.b.clone()
        x_next.view(rows * samples, n_x)[lanes] = torch.stack([row.detach() for row in end], -1)
        a.view(rows * samples, n_x, n_x)[lanes] = jacobian[:, :n_x].permute(2, 0, 1)
        b.view(rows * samples, n_x, len(free))[lanes] = jacobian[:, n_x:].permute(2, 0, 1)
        return replace(lin, x_next=x_next, a=a, b=b)

    def maps(
        self,
        lin: Linearisation,
        spread: Tensor | None = None,
        columns: Tensor | None = None,
        seen: Tensor | None = None,
    ) -> Maps:
        """The states with their random torques as linear maps, for :meth:`_with`: the parameters' columns, then others.

        Args:
            lin: about the smoothed states.
            spread: standard deviation of the first states, ``(R, n_x)``; the batch's if not given.
            columns: further changes of the next state, ``(R, T, n_x, n)``.
            seen: the same of the outputs, ``(R, T, n_y, n)``.
        """
        batch, n_x, dt = self.batch, self.x.shape[2], self.batch.dt
        n_z = n_x + len(self.pushed)
        a = self.x.new_zeros(*dt.shape, n_z, n_z)
        a[..., :n_x, :n_x] = lin.a
        q = self.x.new_zeros(*dt.shape, n_z)
        for k, row in enumerate(self.pushed, n_x):
            # an acceleration through the sample, by the mean of the states' response at its ends
            pushes = 0.5 * dt[..., None] * lin.a[..., row]
            pushes[..., row] += 0.5 * dt
            pushes[..., row - 1] = 0.5 * dt.square()
            held = (lin.x_next[..., row] == 0.0) & (lin.a[..., row, row] == 0.0)
            a[..., :n_x, k] = pushes * ~held[..., None]
            q[..., row - 1] = held * dt.square()
        defect = lin.x_next.clone()
        defect[:, :-1] -= self.x[:, 1:]
        defect[:, -1] = 0.0
        further = [] if columns is None else [columns]
        b = torch.cat([defect[..., None], lin.b, *further], -1)
        b = torch.cat([b, b.new_zeros(*dt.shape, len(self.pushed), b.shape[-1])], 2)
        e = torch.cat([(batch.y - lin.y)[..., None], -lin.d, *([] if seen is None else [-seen])], -1)
        e = torch.cat([e, e.new_zeros(*e.shape[:3], b.shape[-1] - e.shape[-1])], -1)
        c = torch.cat([lin.c, lin.c.new_zeros(*lin.c.shape[:3], len(self.pushed))], -1)
        mean = self.x.new_zeros(len(dt), n_z, b.shape[-1])
        mean[:, :n_x, 0] = batch.x[:, 0] - self.x[:, 0] if spread is None else self.x[:, 0]
        first = torch.cat(
            [batch.x0_std if spread is None else spread, mean.new_ones(len(dt), len(self.pushed))], 1
        )
        return Maps(a, b, q, c, e, self.variance, mean, torch.diag_embed(first.square()))

    def _with(self, maps: Maps, noise: Noise, block: Block | None = None) -> Maps:
        """Maps of a joint, or of the whole system, with their noise."""
        states, torques, outputs = block or self.whole
        a, q, covariance = maps.a.clone(), maps.q.clone(), maps.covariance.clone()
        for k, torque in enumerate(torques, len(states)):
            keeps, power = torch.exp(-self.batch.dt / noise.time[torque]), noise.strength[torque].square()
            a[..., k, k], q[..., k], covariance[:, k, k] = keeps, power * (1.0 - keeps.square()), power
            q[..., states.index(self.pushed[torque]) - 1] *= noise.creep[torque].square()
        variance = self.variance[..., outputs] * noise.scale[outputs].square()
        return replace(maps, a=a, q=q, noise=variance, covariance=covariance)

    def _likeliest_noise(
        self, lin: Linearisation, eta: Tensor, step: float, spread: Tensor | None = None
    ) -> None:
        """Strength and time of each random torque and scale of the outputs' noise that suit the records best.

        Joint after joint, with the others' motion as smoothed.

        Args:
            lin: about the smoothed states.
            eta: step of the parameters.
            step: of the logarithms at first.
            spread: see :meth:`_maps`.
        """
        whole, n_x = self.maps(lin, spread), self.x.shape[2]
        weights = torch.cat([eta.new_ones(1), eta])
        least, most = 0.2 * self.batch.sample_time, float(self.batch.dt.sum(1).max())
        for block in self.blocks:
            states, torques, outputs = block
            if not torques or not outputs:
                continue
            z = [*states, *(n_x + k for k in torques)]
            own = Maps(
                whole.a[..., z, :][..., z], (whole.b[..., z, :] @ weights)[..., None], whole.q[..., z],
                whole.c[..., outputs, :][..., z], (whole.e[..., outputs, :] @ weights)[..., None],
                whole.noise[..., outputs], (whole.mean[:, z] @ weights)[..., None], whole.covariance[:, z][:, :, z],
            )  # fmt: skip

            count = len(torques)

            def noise(logs: np.ndarray, block: Block = block, count: int = count) -> Noise:
                new, found = torch.tensor(np.exp(logs)).to(self.x), replace(self.noise)
                parts = (
                    new[:count],
                    new[count].expand(count),
                    new[count + 1].expand(count),
                    new[count + 2 :],
                )
                for name, part in zip(("strength", "time", "creep", "scale"), parts, strict=True):
                    index = torch.tensor(block[2] if name == "scale" else block[1], device=new.device)
                    found = replace(found, **{name: getattr(found, name).index_copy(0, index, part)})
                return found

            def cost(logs: np.ndarray, own: Maps = own, noise=noise, block: Block = block) -> float:
                found = predict(self._with(own, noise(logs), block))
                value = 0.5 * float(found.errors.square().sum() + found.log_variance.sum())
                return value if math.isfinite(value) else math.inf

            known = self.noise
            now = torch.cat(
                [
                    known.strength[torques],
                    known.time[torques[:1]],
                    known.creep[torques[:1]],
                    known.scale[outputs],
                ]
            )
            limits = [(-27.0, 27.0)] * count + [(math.log(least), math.log(most)), (-27.0, 27.0)]
            limits += [(-9.0, 9.0)] * len(outputs)
            start = np.clip(now.clamp_min(1e-12).log().cpu().numpy(), *np.array(limits).T)
            simplex = start + np.vstack([np.zeros(len(start)), step * np.eye(len(start))])
            settings = {"maxiter": 15 * len(start), "xatol": 0.03, "fatol": 0.05, "initial_simplex": simplex}
            self.noise = noise(minimize(cost, start, method="Nelder-Mead", bounds=limits, options=settings).x)

    def columns(
        self, lin: Linearisation, columns: Tensor | None = None, seen: Tensor | None = None
    ) -> Predictions:
        """Prediction errors by the parameters, and by further changes of the next state and of the outputs."""
        return predict(self._with(self.maps(lin, columns=columns, seen=seen), self.noise))

    def smooth(self, lin: Linearisation, eta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """States, random torques and their standard errors, as all samples tell them after a step of the parameters."""
        maps = self._with(self.maps(lin), self.noise)
        states, variances = smooth(maps, predict(maps, keep=True), eta)
        n_x = self.x.shape[2]
        return self.x + states[..., :n_x], states[..., n_x:], variances[..., n_x:].clamp_min(0.0).sqrt()


def _sliding(system: System, x: Rows, u: Channels, p: Views, directions: Directions) -> list[Tensor]:
    """Rates of the motion where friction acts in these directions, their means included, and holds nothing."""
    rates, speeds = [torch.zeros_like(x[0])] * len(x), [x[row] for row in system.speed_rows]
    pairs = [
        v.abs() if d is None else (d * v).clamp_min(0.0) for v, d in zip(speeds, directions, strict=True)
    ]
    ahead = [((v if d is None else d) > 0).to(v) for v, d in zip(speeds, directions, strict=True)]
    found = system.balances(x, u, p, pairs, ahead).accelerations(directions, held=False)
    for row, acceleration in zip(system.speed_rows, found, strict=True):
        rates[row - 1], rates[row] = x[row], acceleration
    return rates


@dataclass(frozen=True)
class Estimate:
    """Where :func:`estimate` ends.

    Attributes:
        theta: all parameters, ``(n_p,)``.
        cost: minus the logarithm of likelihood and priors.
        status: "converged", "stalled", "max_iterations", "interrupted" or "diverged".
        rounds: linearisations.
        predictions: of the last one.
        torque: random torque at each pushed speed over its inertia [rad/s^2], ``(R, T, n_v)``.
        torque_std: its standard error.
        history: cost after each round.
    """

    theta: Tensor
    cost: float
    status: str
    rounds: int
    predictions: Predictions
    torque: Tensor
    torque_std: Tensor
    history: tuple[float, ...]


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
    likelihood: RandomTorque,
    theta: Tensor,
    bounds: Bounds,
    *,
    tolerance: Tensor | None = None,
    rounds: int = ROUNDS,
    progress: Callable[[int, float], bool | None] | None = None,
) -> Estimate:
    """Parameters, noise and smoothed states that suit the records best; the likelihood keeps the latter two.

    Args:
        likelihood: of the records, with their first smoothed states.
        theta: start values of all parameters, ``(n_p,)``.
        bounds: box and priors of the free ones.
        tolerance: by what factor a data sheet may miss each, as a standard deviation of its logarithm, ``(n_f,)``: a
            further prior about ``bounds.prior_mean``, for those above zero; infinite where there is none.
        rounds: linearisations at most.
        progress: called after each with (round, cost); true ends the fit.
    """
    free, history = likelihood.free, list[float]()
    about, index = bounds.prior_mean, torch.tensor(likelihood.free, device=theta.device)
    tolerance = torch.full_like(about, torch.inf) if tolerance is None else tolerance
    ends: list[tuple[float, Tensor, Tensor, Noise, str]] = []
    # first along what the outputs alone say of the states, where no stick and slip leads astray; then along what the
    # model makes of them, which ends at its free run where no random torque is needed
    rows = range(likelihood.x.shape[2])
    own = [row for row in rows if row not in likelihood.pushed and row + 1 not in likelihood.pushed]
    for redrawn in (own, rows):
        best: tuple[float, Tensor, Tensor, Noise] | None = None
        worse, status = 0, "max_iterations"
        for number in range(rounds):
            lin, eta, values = likelihood.linearise(theta), theta.new_zeros(len(free)), theta[free]
            for again in (False, True):
                if again:
                    likelihood._likeliest_noise(lin, eta, 0.7 if number < 3 else 0.2)
                found = likelihood.columns(lin)
                flat = found.errors.flatten(0, 2)
                left, slope = flat[:, 0], flat[:, 1:]
                missed, per_value = sheet_prior(values, bounds, tolerance)
                hessian = slope.T @ slope + torch.diag(bounds.prior_precision + per_value.square())
                gradient = slope.T @ left + bounds.prior_precision * (values - about) + per_value * missed
                diagonal = hessian.diagonal()
                unit = diagonal.clamp_min(1e-300).rsqrt().where(diagonal > 0, torch.zeros_like(diagonal))
                size = torch.maximum(values.abs(), bounds.scale)
                low = torch.maximum(bounds.lower - values, REACH[0] * size)
                high = torch.minimum(bounds.upper - values, REACH[1] * size)
                damping = 1e-12 + (unit == 0).to(unit) + (unit / size).square()
                parts = (part[None] for part in (hessian, gradient, unit, damping, low, high))
                eta = bounded_lm_step(*parts)[0][0] * unit
            cost = 0.5 * float((left + slope @ eta).square().sum() + found.log_variance.sum())
            cost += float(
                bounds.prior_cost((values + eta)[None])[0] + 0.5 * (missed + per_value * eta).square().sum()
            )
            history.append(cost)
            if progress is not None and progress(len(history), cost):
                status = "interrupted"
                break
            if not math.isfinite(cost):
                status = "stalled" if best else "diverged"
                break
            length = float((eta @ hessian @ eta).clamp_min(0.0).sqrt())
            worse = 0 if best is None or cost < best[0] else worse + 1
            if worse == 0:
                best = cost, theta, likelihood.x, likelihood.noise
            if length < SETTLED or worse == WORSE:
                status = "converged" if length < SETTLED else "stalled"
                break
            moved = likelihood.smooth(lin, eta)[0] if redrawn else likelihood.x
            likelihood.x = likelihood.x.index_copy(
                2, torch.tensor(list(redrawn), dtype=torch.long), moved[..., list(redrawn)]
            )
            theta = theta.index_copy(0, index, values + eta)
        if best is not None:
            ends.append((*best, status))
            _, theta, likelihood.x, likelihood.noise = best
        if status in ("interrupted", "diverged"):
            break
    cost, theta, likelihood.x, likelihood.noise, reached = min(
        ends, default=(math.inf, theta, likelihood.x, likelihood.noise, status), key=lambda end: end[0]
    )
    status = status if status in ("interrupted", "diverged") else reached
    lin = likelihood.linearise(theta)
    _, torque, std = likelihood.smooth(lin, theta.new_zeros(len(free)))
    return Estimate(theta, cost, status, len(history), likelihood.columns(lin), torque, std, tuple(history))

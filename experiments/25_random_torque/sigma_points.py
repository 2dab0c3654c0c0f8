"""Prediction errors by a sigma-point Kalman filter: a random torque at each joint stands for all that no law describes.

    x' = f(x, u, theta, w),    y = h(x, u, theta) + v

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
from pathlib import Path

import torch
from torch import Tensor

from hybrid_id.diagnosis.catalogue import rotor_share
from hybrid_id.simulation import compiled
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import call, library
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import PUSH, System

TINY = 1e-9
"""Least standard deviation of a state in the filter, over its largest value."""
WEAKEST = 14.0
"""Least logarithm of the random torque's strength, below that of the records' acceleration."""
LASTS = 0.1
"""Correlation time of a random torque at most [s], and at least of ten samples: what lasts longer is a cause."""


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
        rate: of each output that is an angle [rad/s], 0 of others, ``(R, T, n_y)``.
        entries: name and number of each entry of the noise: ``strength``, the standard deviation of the random torque
            at a speed over the inertia there [rad/s^2], its correlation ``time`` [s], and the ``creep`` there, at rest
            too [rad/sqrt(s)]; of an output the ``scale`` of its standard deviation, as the batch's weights have it,
            and the ``jitter`` of its moments [s].
        low, high: bounds of their logarithms.
        first: where a fit begins.
    """

    def __init__(self, system: System, engine: Engine, batch: Batch) -> None:
        self.system, self.engine, self.batch, self.free = system, engine, batch, system.estimated
        self.pushed = list(system.speed_rows)
        p, self.rate = system.views(list(system.theta().detach()[:, None])), torch.zeros_like(batch.y)
        for o, name in enumerate(batch.outputs):
            if name.startswith("q"):
                (self.rate[..., o],) = system.outputs([f"v{name[1:]}"], batch.x.unbind(-1), {}, p)
        moves = (batch.dt[:, :-1] > 0)[..., None]
        change = batch.x[..., self.pushed].diff(dim=1) / batch.dt[:, :-1, None].where(
            moves, torch.ones(()).to(batch.x)
        )
        usual = (change.square() * moves).sum((0, 1)).div(moves.sum()).sqrt().clamp_min(1e-6).log()
        for joint in system.joints:  # each side of a gear is the lighter for its share
            share = rotor_share(system, f"{joint.name}/")
            if len(joint.positions) > 1 and share is not None:
                for row, part in zip(
                    joint.positions, (share.spec.value, 1.0 - share.spec.value), strict=True
                ):
                    usual[self.pushed.index(row + 1)] -= math.log(min(max(part, 0.01), 0.99))
        step = math.log(batch.sample_time)
        longest = max(math.log(LASTS), step + math.log(10.0))
        torques, outputs = len(self.pushed), len(batch.outputs)
        self.entries = [(name, k) for name in ("strength", "time", "creep") for k in range(torques)]
        self.entries += [(name, k) for name in ("scale", "jitter") for k in range(outputs)]
        creeps = []
        for row in self.pushed:  # by one deviation of its sensor from sample to sample
            (joint,) = (joint for joint in system.joints if row - 1 in joint.positions)
            ratio = joint.gear_ratio if row - 1 == joint.positions[0] else 1.0
            scales = {f"q_m{joint.number}": 1.0, f"q_a{joint.number}": ratio}
            shown = [
                float(scales[name] / batch.weight[..., o][batch.weight[..., o] > 0].median())
                for o, name in enumerate(batch.outputs)
                if name in scales
            ]
            creeps.append(math.log(min(shown, default=1e-9)) - 0.5 * step)
        limits = {
            "strength": [(float(u) - WEAKEST, float(u), float(u)) for u in usual],
            "time": [(step - 1.6, step + 1.6, longest)] * torques,
            "creep": [(creep - 9.0, creep, creep + 3.0) for creep in creeps],
            "scale": [(-0.5 * math.log(12.0), 0.0, 9.0)] * outputs,
            "jitter": [(step - 7.0, step - 4.6, step)] * outputs,
        }
        bounds = torch.tensor([limits[name][k] for name, k in self.entries]).to(batch.x)
        self.low, self.first, self.high = bounds.unbind(1)

        seen = batch.weight > 0
        self.variance = torch.where(seen, batch.weight.clamp_min(1e-300) ** -2, torch.zeros_like(batch.y))
        self.pushes = [f"{PUSH}{system.speed_rows.index(row)}" for row in self.pushed]

    def errors(self, theta: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Prediction errors in their standard deviations, and the logarithms of their variances.

        Args:
            theta: all parameters of K guesses, ``(n_p, K)``, or by record ``(n_p, K, R)``.
            logs: logarithms of their noise, ``(K, n)`` in the order of ``entries``.

        Returns:
            ``(K, R, T, n_y)`` each.
        """
        white, variances, *_ = self._filtered(theta, logs)
        return white, variances

    def ahead(self, theta: Tensor, logs: Tensor, every: int) -> Tensor:
        """Errors of the outputs while the model runs by itself, ``(K, R, T, n_y)``; 0 where it starts or none is seen.

        Args:
            theta, logs: as of :meth:`errors`.
            every: samples after which it starts again, from the filter's mean.
        """
        return self._filtered(theta, logs, every=every)[2]

    def alone(self, theta: Tensor, logs: Tensor, every: int) -> Tensor:
        """Squares of these errors over the outputs' variances, by sample, ``(K, R, T)``; infinite for a lost model."""
        spread = self.batch.std(self.batch.y).mean(0).clamp_min(1e-12)
        return (self.ahead(theta, logs, every) / spread).square().sum(3).nan_to_num(math.inf)

    def torque(self, theta: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
        """Random torques given the whole records [rad/s^2], and their standard deviations, ``(K, R, T, n)`` each.

        Source: S. Sarkka, "Unscented Rauch-Tung-Striebel smoother", IEEE Trans. Automatic Control 53, 2008.
        """
        n, z = self.batch.x.shape[-1], self.batch.x.shape[-1] + len(self.pushed)
        path = self._filtered(theta, logs, whole=True)[3].movedim(2, 0)
        m, P, next_m, next_P, both = path.split([z, z * z, z, z * z, z * z], -1)
        P, next_P, both = (part.unflatten(-1, (z, z)) for part in (P, next_P, both))
        size = next_P.diagonal(dim1=-2, dim2=-1).clamp_min(1e-300).sqrt()[..., None]
        alike = next_P / size / size.mT + 1e-13 * torch.eye(z).to(P)
        gain = torch.linalg.solve(alike, (both / size.mT).mT).mT / size.mT
        mean, variance = m[-1, ..., None], P[-1]
        means, variances = [mean], [variance]
        for t in range(len(m) - 2, -1, -1):
            mean = m[t, ..., None] + gain[t] @ (mean - next_m[t, ..., None])
            variance = P[t] + gain[t] @ (variance - next_P[t]) @ gain[t].mT
            means.append(mean)
            variances.append(variance)
        smooth = torch.stack(means[::-1], 2)[..., n:, 0]
        spread = torch.stack(variances[::-1], 2).diagonal(dim1=-2, dim2=-1)[..., n:]
        return smooth, spread.clamp_min(0.0).sqrt()

    def _filtered(
        self, theta: Tensor, logs: Tensor, *, every: int = 0, whole: bool = False
    ) -> tuple[Tensor, ...]:
        """What the filter finds: errors, variances, errors of running alone, moments; of these what is asked for."""
        batch, guesses, (records, samples, outputs) = self.batch, theta.shape[1], self.batch.y.shape
        rows = guesses * records
        each = theta.flatten(1) if theta.ndim == 3 else theta.repeat_interleave(records, 1)
        u = dict(batch.u)
        late = {
            name
            for joint in self.system.joints
            for name in (*joint.drive.past(batch.sample_time), f"step{joint.number}")
        }
        u |= {name: c.repeat(guesses, 1) for name, c in u.items() if name.partition("@")[0] in late}
        u = dict(compiled._arrived(self.system, u, each))
        u |= {name: batch.dt.new_zeros(1, samples) for name in self.pushes}
        equations, constants = compiled._equations(self.system, self.engine, tuple(u), outputs=batch.outputs)
        channels = [channel.contiguous() for channel in u.values()]
        places = torch.tensor([channel.data_ptr() for channel in channels])
        lengths = torch.tensor([len(channel) for channel in channels])
        strength, time, creep, scale, jitter = (
            logs[:, [i for i, entry in enumerate(self.entries) if entry[0] == name]].exp()
            for name in ("strength", "time", "creep", "scale", "jitter")
        )

        def of_rows(*parts: Tensor) -> Tensor:
            return torch.stack(parts, -1).repeat_interleave(records, 0).contiguous()

        sizes = torch.cat([batch.x.abs().amax((0, 1)).clamp_min(1e-6), strength[0].clamp_min(1e-6)])
        errors, variances = (batch.y.new_zeros(guesses, records, samples, outputs) for _ in range(2))
        parts = [
            (batch.dt / self.engine.substeps).contiguous(), compiled._values(each, constants), batch.y.contiguous(),
            self.variance, self.rate.square().contiguous(), of_rows(scale.square(), jitter.square()),
            batch.x[:, 0].contiguous(), batch.x0_std.square().contiguous(),
            of_rows(strength.square(), time, creep.square()), (TINY * sizes).square(),
            torch.tensor([list(u).index(name) for name in self.pushes]), torch.tensor(self.pushed),
        ]  # fmt: skip
        counts = rows, records, samples, self.engine.substeps, outputs, len(self.pushed), every
        more = outputs if every else 0, (2 + 3 * len(sizes)) * len(sizes) if whole else 0
        found = errors, variances, *(errors.new_zeros(*errors.shape[:3], size) for size in more)
        call(_filter(), "predict", equations, *found, places, lengths, *parts, *counts)
        return found

"""The filter in C gives what its formulas give, written plainly."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hybrid_id.components import MotorEncoder, TorqueSensor
from hybrid_id.identification.fit import make_bounds
from hybrid_id.simulation import compiled
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from drives import batch_of, flexible_drive, multisine, rigid_drive, stored  # pyright: ignore[reportMissingImports]
from scoring import Prior, estimate
from sigma_points import TINY, Likelihood

ENGINE = Engine(compiled=True)
NOISE = {"q": 1e-3, "v": 0.1, "i": 0.05, "t": 0.5}
RIGID = (
    rigid_drive(vertical=True)
    .with_component("joint1/sensor", MotorEncoder(offset=0.3))
    .with_component("joint1/sensor", TorqueSensor(g=1.1, tau_0=0.2))
)


def likelihood(system: System, *outputs: str, samples: int = 150, rows: int = 2) -> Likelihood:
    """Of simulated records with noise, some samples unseen, the second one shorter."""
    volts = torch.stack([torch.tensor(multisine(k, samples=samples)) for k in range(rows)]).numpy()
    batch = batch_of(system, {"u1": volts}, rows=rows, outputs=outputs)
    run, std = simulate(system, ENGINE, batch), torch.tensor([NOISE[name[0]] for name in outputs]).double()
    noise = torch.randn(run.y.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weight = (1.0 / std).expand_as(run.y).clone()
    weight[:, 5::7, 0] = weight[1:, -20:] = 0.0
    dt = batch.dt.clone()
    dt[1:, -21:] = 0.0
    x0_std = torch.full_like(batch.x0_std, 1e-2)
    return Likelihood(
        system, ENGINE, replace(batch, y=run.y + std * noise, weight=weight, x=run.x, dt=dt, x0_std=x0_std)
    )


def reference(own: Likelihood, r: int, theta: Tensor, logs: Tensor) -> tuple[Tensor, Tensor]:
    """White errors and logarithms of variances of one record, (T, n_y)."""
    system, batch, n = own.system, own.batch, own.batch.x.shape[-1]
    parts = {
        name: logs[[i for i, e in enumerate(own.entries) if e[0] == name]].exp() for name, _ in own.entries
    }
    z = n + len(own.pushed)
    w = range(n, z)
    m, P = torch.cat([batch.x[r, 0], torch.zeros(z - n)]), torch.zeros(z, z).double()
    P[range(n), range(n)], P[w, w] = batch.x0_std[r].square(), parts["strength"].square()
    least = TINY * torch.cat([batch.x.abs().amax((0, 1)), parts["strength"]]).clamp_min(1e-6)
    p, all_theta = system.views(list(theta[:, None])), theta[:, None].expand(-1, 2 * z)
    white, variances = torch.zeros_like(batch.y[r]), torch.zeros_like(batch.y[r])

    def points() -> Tensor:
        L = math.sqrt(z) * torch.linalg.cholesky(P + torch.diag(least.square()))
        return m + torch.cat([L.T, -L.T])

    for t, h in enumerate(batch.dt[r]):
        X = points()
        u = {name: channel[r, t].expand(2 * z) for name, channel in batch.u.items()}
        u |= {name: X[:, n + k] for k, name in enumerate(own.pushes)}
        x = X[:, :n].unbind(1)
        Y = torch.stack(system.outputs(batch.outputs, x, u, p, system.signs(x)), 1)
        seen = batch.weight[r, t] > 0
        if seen.any():
            apart = (Y - Y.mean(0))[:, seen]
            noise = (parts["scale"] / batch.weight[r, t]).square() + (
                own.rate[r, t] * parts["jitter"]
            ).square()
            L = torch.linalg.cholesky(apart.T @ apart / (2 * z) + torch.diag(noise[seen]))
            error = torch.linalg.solve_triangular(L, (batch.y[r, t] - Y.mean(0))[seen][:, None], upper=False)
            gain = torch.linalg.solve_triangular(L, apart.T @ (X - m) / (2 * z), upper=False)
            white[t, seen], variances[t, seen] = error[:, 0], 2.0 * L.diagonal().log()
            m, P = m + (gain.T @ error)[:, 0], P - gain.T @ gain
        X = points()
        u = {name: channel[r, t].expand(2 * z, 2) for name, channel in batch.u.items()}
        u |= {name: X[:, n + k, None].expand(-1, 2) for k, name in enumerate(own.pushes)}
        steps = torch.stack([h, 0.0 * h]).expand(2 * z, 2)
        after = compiled.shoot(system, ENGINE, X[:, None, :n].repeat(1, 2, 1), u, steps, all_theta, 2)[:, 1]
        keeps = (-h / parts["time"]).exp()
        X = torch.cat([after, X[:, n:] * keeps], 1)
        m = X.mean(0)
        P = (X - m).T @ (X - m) / (2 * z)
        P[w, w] += parts["strength"].square() * (1.0 - keeps.square())
        angles = [row - 1 for row in own.pushed]
        P[angles, angles] += parts["creep"].square() * h
    return white, variances


@pytest.mark.parametrize(
    ("system", "outputs"),
    [
        (RIGID, ("q_m1", "q_a1", "i1", "tau_a1")),
        (RIGID, ("i1",)),
        (flexible_drive(), ("q_m1", "q_a1", "v_a1", "tau_a1")),
    ],
)
def test_the_filter_is_its_formulas(system: System, outputs: tuple[str, ...]) -> None:
    own = likelihood(system, *outputs)
    guesses, logs = stored(system, 2) * torch.tensor([1.0, 1.1]), own.first.repeat(2, 1)
    logs[1] -= 1.0
    white, variances = own.errors(guesses, logs)
    for k, r in ((0, 0), (1, 1)):
        expected = reference(own, r, guesses[:, k], logs[k])
        torch.testing.assert_close(white[k, r], expected[0], rtol=1e-8, atol=1e-8)
        torch.testing.assert_close(variances[k, r], expected[1], rtol=1e-8, atol=1e-8)


def test_alone_the_model_runs_as_in_a_simulation() -> None:
    own = likelihood(RIGID, "q_m1", "i1")
    n, theta, logs, batch = own.batch.x.shape[-1], stored(RIGID), own.first[None], own.batch
    means = own._filtered(theta, logs, whole=True)[3][0, :, :, :n]
    for every in (10, 150):
        ahead = own.ahead(theta, logs, every)[0]
        for start in range(0, 150, every):
            here = slice(start, start + every)
            part = {name: getattr(batch, name)[:, here] for name in ("dt", "y", "weight")}
            u = {name: channel[:, here] for name, channel in batch.u.items()}
            run = simulate(RIGID, ENGINE, replace(batch, u=u, x=means[:, here], **part))
            expected = (part["y"] - run.y) * (part["weight"] > 0)
            expected[:, 0] = 0.0
            torch.testing.assert_close(ahead[:, here], expected, rtol=1e-9, atol=1e-12)


def test_the_torque_is_that_of_all_samples_at_once() -> None:
    """A linear drive: regression on its first state and on what drives the random torque."""
    system = rigid_drive().without_component("joint1/motor_friction", "coulomb_friction")
    own = likelihood(system, "q_m1", "v_m1")
    theta, batch, samples = stored(system, 2), own.batch, 150
    logs = own.first.clone()
    logs[own.entries.index(("creep", 0))] = -40.0
    mean, std = own.torque(theta[:, :1], logs[None])
    own_noise = dict(zip(own.entries, logs.exp(), strict=True))
    keeps = (-batch.dt / own_noise["time", 0]).exp()
    steady, jacobian = compiled.linearise(system, ENGINE, batch.x, batch.u, batch.dt, theta, [])
    pushed = {**batch.u, own.pushes[0]: torch.ones_like(batch.dt)}
    push = compiled.linearise(system, ENGINE, batch.x, pushed, batch.dt, theta, [])[0] - steady
    for r in range(batch.rows):
        # the state and the torque at a sample, by the unknowns: 1, first state, first torque, what drives it later
        known = torch.zeros(3, samples + 3).double()
        known[:2, 0], known[range(3), range(1, 4)] = batch.x[r, 0], 1.0
        variance = torch.ones(samples + 2).double()
        variance[:2], variance[2:] = batch.x0_std[r].square(), own_noise["strength", 0].square()
        rows, given, torques = list[Tensor](), list[Tensor](), list[Tensor]()
        for t in range(samples):
            for o in range(2):
                if (weight := batch.weight[r, t, o]) > 0:
                    scale, jitter = own_noise["scale", o] / weight, own_noise["jitter", o] * own.rate[r, t, o]
                    unit = (scale.square() + jitter.square()).rsqrt()
                    rows.append(unit * known[o])
                    given.append(unit * batch.y[r, t, o])
            torques.append(known[2])
            after = jacobian[r, t] @ known[:2] + push[r, t, :, None] * known[2]
            after[:, 0] += steady[r, t] - jacobian[r, t] @ batch.x[r, t]
            known = torch.cat([after, keeps[r, t] * known[None, 2]])
            if t < samples - 1:
                known[2, t + 4] = (1.0 - keeps[r, t].square()).sqrt()
        A, w = torch.stack(rows), torch.stack(torques)
        posterior = torch.linalg.inv(A[:, 1:].T @ A[:, 1:] + torch.diag(1.0 / variance))
        found = posterior @ (A[:, 1:].T @ (torch.stack(given) - A[:, 0]))
        spread = torch.einsum("ti,ij,tj->t", w[:, 1:], posterior, w[:, 1:]).sqrt()
        torch.testing.assert_close(std[0, r, :, 0], spread, rtol=1e-6, atol=0.0)
        size = float(found.abs().max())
        torch.testing.assert_close(mean[0, r, :, 0], w[:, 1:] @ found, rtol=1e-6, atol=1e-6 * size)


def test_a_fit_ends_at_the_prior_along_what_records_do_not_tell() -> None:
    """Torque constant, friction and inertia may all grow alike: only their ratios show in a motion."""
    system = rigid_drive()
    truth = dict(zip((info.name for info in system.table), stored(system)[:, 0].tolist(), strict=True))
    start = {"P_m1": 1.3, "P_m2": 0.9, "F_c": 0.6, "F_v": 1.5, "J": 0.8}
    own = likelihood(system, "q_m1", "v_m1", samples=800)
    own = Likelihood(system.with_values({n: k * truth[n] for n, k in start.items()}), ENGINE, own.batch)
    names = tuple(own.system.table[i].name for i in own.free)
    wide = torch.tensor([1.0 if name[0] == "F" else 0.3 for name in names]).double()
    mean = torch.tensor([truth[name] for name in names]).double()
    kinds = torch.ones(len(names), dtype=torch.bool), torch.diag(wide**-2), torch.zeros_like(wide)
    end = estimate(own, Prior(names, make_bounds(own.system, own.free), mean, *kinds))
    found = {name: float(end.theta[i]) / truth[name] for i, name in zip(own.free, names, strict=True)}
    spread = torch.linalg.inv(end.hessian).diagonal().sqrt() / (torch.tensor([*found.values()]) * mean)
    alike = 1.0 / math.sqrt(sum(1.0 / w**2 for w, n in zip(wide.tolist(), names, strict=True) if n != "P_m2"))
    for name, std in zip(names, spread.tolist(), strict=True):
        if name in ("P_m1", "J", "F_c"):
            assert found[name] / found["J"] == pytest.approx(1.0, abs=0.05)
            assert found[name] == pytest.approx(1.0, abs=alike)
            assert std == pytest.approx(alike, rel=0.25)

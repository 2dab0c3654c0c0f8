"""Coupled speeds with dry friction: accelerations by elimination, and who moves among many at rest."""

import itertools

import numpy as np
import pytest
import torch

from hybrid_id.systems.balance import Balances, Rest, SpeedBalance

B = 64


def coupled(n, seed, *, loaded=False):
    """Random balances of n coupled speeds, their mass matrix (B, n, n), forces and levels (B, n)."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(B, n, n))
    links = root @ root.transpose(0, 2, 1)
    mass = links + rng.uniform(0.5, 2.0, (B, n, 1)) * np.eye(n)  # and what the rotors have
    force, level = 3.0 * rng.normal(size=(B, n)), rng.uniform(0.0, 3.0, (B, n))
    row = torch.tensor
    speeds = [
        SpeedBalance(
            row(mass[:, k, k]),
            row(force[:, k]),
            row(level[:, k]),
            row(np.full(B, 0.1)) if loaded else None,
            row(links[:, k, k] / mass[:, k, k]) if loaded else None,
            row(rng.normal(size=B)) if loaded else None,
        )
        for k in range(n)
    ]
    couplings = {(i, j): row(mass[:, i, j]) for i in range(n) for j in range(i + 1, n)}
    return Balances(speeds, couplings), mass, force, level


def as_array(rows):
    return np.stack([np.asarray(row) for row in rows], 1)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_moving_speeds_accelerate_by_the_mass_matrix(n):
    balances, mass, force, level = coupled(n, n)
    directions = [torch.ones(B, dtype=torch.float64)] * n
    found = as_array(balances.accelerations(directions, held=True))
    np.testing.assert_allclose(found, np.linalg.solve(mass, (force - level)[..., None])[..., 0], rtol=1e-9)


def test_a_speed_that_is_held_pushes_no_other():
    balances, mass, force, level = coupled(3, 0)
    zero, one = torch.zeros(B, dtype=torch.float64), torch.ones(B, dtype=torch.float64)
    found = as_array(balances.accelerations([one, zero, one], held=True))
    part = np.ix_(range(B), [0, 2], [0, 2])
    known = np.linalg.solve(mass[part], (force - level)[:, [0, 2], None])[..., 0]
    np.testing.assert_allclose(found[:, [0, 2]], known, rtol=1e-9)
    assert not found[:, 1].any()


def energy(a, mass, force, level):
    """What the accelerations of speeds at rest minimise."""
    return 0.5 * np.einsum("bi,bij,bj->b", a, mass, a) + (-force * a + level * np.abs(a)).sum(1)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_of_all_combinations_the_one_of_least_energy_is_found(n):
    balances, mass, force, level = coupled(n, 10 + n)
    rest = Rest(balances, balances)
    directions = rest.stick_slip([torch.zeros(B, dtype=torch.float64)] * n)
    found = as_array(balances.accelerations(directions, held=True))
    best = np.full(B, np.inf)
    for choice in itertools.product([0.0, 1.0, -1.0], repeat=n):
        trial = [torch.full((B,), c, dtype=torch.float64) for c in choice]
        a = as_array(balances.accelerations(trial, held=True))
        best = np.minimum(best, energy(a, mass, force, level))
    np.testing.assert_allclose(energy(found, mass, force, level), best, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("loaded", [False, True])
@pytest.mark.parametrize("n", [6, 8])
def test_no_balance_is_contradicted_and_friction_never_drives(n, loaded):
    balances, *_ = coupled(n, 20 + n, loaded=loaded)
    rest = Rest(balances, balances)
    start = [torch.zeros(B, dtype=torch.float64)] * n
    start[1] = torch.ones(B, dtype=torch.float64)  # it moves already
    directions = rest.stick_slip(start)
    found = as_array(balances.accelerations(directions, held=True))
    signs = as_array(directions)
    margins = as_array([margin for _, margin in rest.breakaway_margins(directions)])
    resting = np.delete(np.arange(n), 1)
    assert (signs[:, 1] == 1).all()
    assert (signs * found)[:, resting].min() >= -1e-9
    assert margins[:, resting][signs[:, resting] == 0].max() <= 1e-9
    assert 0.05 < (signs[:, resting] == 0).mean() < 0.95

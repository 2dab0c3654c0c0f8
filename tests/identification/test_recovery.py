"""Twins with a known truth: estimates lie within their standard errors, and what cannot be told is visible."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from drives import flexible_drive, make_record, make_records, multisine, only, rigid_drive
from scipy import stats

from hybrid_id.components import (
    Component,
    Dahl,
    LoadDependent,
    LuGre,
    MotorEncoder,
    Stribeck,
)
from hybrid_id.identification.fit import fit
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

NOISE = {"q_m1": 0.02, "q_a1": 2e-4, "i1": 0.02, "tau1": 1e-3}


def away(system: System, factor: float = 1.3) -> System:
    """The system with every estimated parameter off its value, alternately up and down."""
    free = [i for i in system.table if i.spec.estimate]
    return system.with_values({i.name: i.spec.value * factor ** (-1) ** k for k, i in enumerate(free)})


def records(
    system: System,
    seeds: Sequence[int],
    outputs: tuple[str, ...] = ("q_m1",),
    samples: int = 1000,
    amplitude: float = 8.0,
) -> list[Record]:
    voltages = [multisine(seed, samples=samples, amplitude=amplitude) for seed in seeds]
    made = make_records(system, voltages, seeds=seeds, noise=NOISE, outputs=outputs)
    return [replace(record, name=f"seed{seed}") for record, seed in zip(made, seeds, strict=True)]


def covariance(result: FitResult) -> np.ndarray:
    """Plain covariance of the estimates."""
    j = np.concatenate([part.reshape(-1, len(result.names)) for part in result.jacobian])
    return np.linalg.inv(j.T @ j + np.diag(result.prior_precision)) * result.noise_scale**2


def scores(results: Sequence[FitResult], truth: System) -> np.ndarray:
    """Errors in standard errors, (G, n_f)."""
    exact = np.array([truth.parameter(n).spec.value for n in results[0].names])
    return np.array([(r.values - exact) / np.sqrt(np.diag(covariance(r))) for r in results])


def information(result: FitResult) -> np.ndarray:
    """J'J with every parameter in units of its value."""
    j = np.concatenate([part.reshape(-1, len(result.names)) for part in result.jacobian]) * result.values
    return j.T @ j


def rank(matrix: np.ndarray) -> int:
    """Number of directions that are told to better than a part in a million of the best one's information."""
    scale = np.sqrt(np.diag(matrix))
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    return int((eigenvalues > 1e-7 * eigenvalues[-1]).sum())


def assert_recovered(results: Sequence[FitResult], truth: System) -> None:
    """Estimates lie as far from the truth as their covariances say, one by one and together."""
    exact = np.array([truth.parameter(n).spec.value for n in results[0].names])
    assert all(r.status == "converged" for r in results), [r.status for r in results]
    assert all(0.9 < r.noise_scale < 1.1 for r in results)
    z = scores(results, truth)
    assert (np.abs(z) < 3.0).mean() >= 0.9 and np.abs(z).max() < 4.5, z
    distance = [(r.values - exact) @ np.linalg.solve(covariance(r), r.values - exact) for r in results]
    low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], z.size)
    assert low < np.sum(distance) < high, (low, distance, high)


RIGID = only(rigid_drive(), "J", "F_c", "F_v")
FLEXIBLE = only(flexible_drive(), "J_m", "J_a", "k", "d", "F_cm", "F_vm", "F_va")


@cache
def rigid_fits() -> list[FitResult]:
    runs = records(RIGID, range(8))
    return fit(away(RIGID), make_batch(RIGID, runs, noise_std=NOISE, signal_share=0.0))


def test_rigid_drive_record_by_record() -> None:
    assert_recovered(rigid_fits(), RIGID)
    assert [r.records for r in rigid_fits()] == [(f"seed{k}",) for k in range(8)]


def test_rigid_drive_pooled_is_sharper() -> None:
    runs = records(RIGID, range(8))
    (pooled,) = fit(away(RIGID), make_batch(RIGID, runs, noise_std=NOISE, signal_share=0.0), pooled=True)
    assert pooled.status == "converged"
    assert np.abs(scores([pooled], RIGID)).max() < 3.5
    best = np.min([np.diag(covariance(r)) for r in rigid_fits()], 0)
    assert (np.diag(covariance(pooled)) < 0.6 * best).all()
    assert pooled.n_samples == 8000 and len(pooled.jacobian) == 8 and pooled.x0.shape == (8, 2)
    # the information of the parts adds up to that of the whole
    parts = sum(information(r) / np.outer(r.values, r.values) for r in rigid_fits())
    np.testing.assert_allclose(parts, information(pooled) / np.outer(pooled.values, pooled.values), rtol=0.2)


@pytest.mark.parametrize("outputs", [("q_m1",), ("q_m1", "q_a1")], ids=["motor", "both sides"])
def test_flexible_drive(outputs: tuple[str, ...]) -> None:
    # reversals excite the spring; with the motor's encoder alone it is told through its reaction
    runs = records(FLEXIBLE, range(5), outputs, samples=800, amplitude=10.0)
    results = fit(away(FLEXIBLE, 1.2), make_batch(FLEXIBLE, runs, noise_std=NOISE, signal_share=0.0))
    assert_recovered(results, FLEXIBLE)


def test_voltage_and_angle_leave_two_directions_open_and_current_or_torque_closes_one() -> None:
    # every torque may be multiplied by one number, and P_m2 hides behind F_v, until current or torque is measured
    system = only(rigid_drive(), "J", "P_m1", "P_m2", "F_c", "F_v")
    ranks, errors = {}, {}
    for outputs in (("q_m1",), ("q_m1", "tau1"), ("q_m1", "i1")):
        runs = records(system, [0, 1], outputs)
        (found,) = fit(system, make_batch(system, runs, noise_std=NOISE, signal_share=0.0), pooled=True)
        ranks[outputs[-1]] = rank(information(found))
        errors[outputs[-1]] = found
    assert ranks["q_m1"] == 3, "J / P_m1, F_c / P_m1 and P_m2 + F_v / P_m1"
    assert ranks["tau1"] == 5, "a measured torque tells P_m1 and P_m2"
    assert ranks["i1"] == 5, "i = tau / P_m2: a measured current tells P_m1 / P_m2 and P_m2"
    for name in ("tau1", "i1"):
        assert np.abs(scores([errors[name]], system)).max() < 4.0
    # the combinations are told all the same
    found = dict(zip(errors["q_m1"].names, errors["q_m1"].values, strict=True))
    assert found["J"] / found["P_m1"] == pytest.approx(2e-5 / 0.019, rel=0.01)
    assert found["P_m2"] + found["F_v"] / found["P_m1"] == pytest.approx(0.0254 + 5e-5 / 0.019, rel=0.01)


def test_priors_close_the_open_directions() -> None:
    system = rigid_drive()
    prior = {n: 0.02 * system.parameter(n).spec.value for n in ("P_m1", "P_m2")}
    held = only(system, "J", "P_m1", "P_m2", "F_c", "F_v")
    held = held.with_specs(
        {
            n: replace(held.parameter(n).spec, prior_mean=system.parameter(n).spec.value, prior_std=s)
            for n, s in prior.items()
        }
    )
    start = held.with_values({"J": 2.6e-5, "F_c": 0.014, "P_m1": 0.0195})
    results = fit(start, make_batch(held, records(system, range(4)), noise_std=NOISE, signal_share=0.0))
    z = scores(results, system)
    assert np.abs(z).max() < 3.5
    spread = np.sqrt(np.diag(covariance(results[0])))
    at = results[0].names.index("P_m1")
    assert spread[at] == pytest.approx(prior["P_m1"], rel=0.05), "the records add nothing to the scale"
    assert results[0].values[at] == pytest.approx(0.019, rel=0.02), "the prior's mean holds it, not the start"


def test_start_in_motion_is_estimated() -> None:
    cut = [r.between(0.7, 2.0) for r in records(RIGID, range(6))]
    batch = make_batch(RIGID, cut, noise_std=NOISE, signal_share=0.0)
    free = fit(away(RIGID, 1.1), batch)
    assert_recovered(free, RIGID)
    held = fit(away(RIGID, 1.1), replace(batch, x0_std=torch.zeros_like(batch.x0_std)))
    assert np.mean([h.cost for h in held]) > 1.3 * np.mean([f.cost for f in free]), (
        "a wrong start speed costs"
    )


def test_encoder_offset_is_told_by_gravity() -> None:
    truth = rigid_drive(vertical=True, ratio=20.0).with_values({"G_l": 1.0})
    truth = only(
        truth.with_component("joint1/sensor", MotorEncoder(offset=4.0)), "J", "F_c", "F_v", "G_l", "offset"
    )
    truth = truth.with_specs({"offset": Bounded(4.0, -100.0, 100.0, "rad")})
    runs = records(truth, range(4), samples=1500, amplitude=10.0)
    start = truth.with_values({"offset": 0.5, "J": 2.3e-5})
    assert_recovered(fit(start, make_batch(start, runs, noise_std=NOISE, signal_share=0.0)), truth)


@pytest.mark.parametrize("output", ["v_m1", "q_a1"])
def test_other_single_outputs_tell_a_rigid_drive(output: str) -> None:
    noise = {"v_m1": 0.5, "q_a1": 1e-4}
    runs = [
        make_record(RIGID, multisine(k, samples=1000), seed=k, noise=noise, outputs=(output,), name=f"r{k}")
        for k in range(4)
    ]
    results = fit(away(RIGID), make_batch(RIGID, runs, noise_std=noise, signal_share=0.0))
    assert_recovered(results, RIGID)


@pytest.mark.parametrize(
    "law, free",
    [
        (LoadDependent(mu=0.2), ("mu", "G_l")),
        (Stribeck(F_drop=0.008, v_s=20.0), ("F_drop", "v_s")),
        (LuGre(sigma_0=0.5, sigma_1=1e-3), ("sigma_0", "sigma_1")),
        (Dahl(sigma=0.5), ("sigma",)),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_friction_laws_are_found(law: Component, free: tuple[str, ...]) -> None:
    vertical, noise = "G_l" in free, {"q_m1": 0.005}
    truth = rigid_drive(vertical=vertical, ratio=30.0).with_component("joint1/motor_friction", law)
    truth = only(truth.with_values({"G_l": 0.6}) if vertical else truth, "J", "F_c", "F_v", *free)
    runs = [
        make_record(
            truth,
            multisine(k, samples=1000, amplitude=3.0),
            seed=k,
            noise=noise,
            engine=Engine(substeps=12),
            name=f"r{k}",
        )
        for k in range(3)
    ]
    results = fit(away(truth, 1.2), make_batch(truth, runs, noise_std=noise, signal_share=0.0))
    assert_recovered(results, truth)

"""Where a fit over an angle begins is found in what a model without it leaves."""

# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drives import flexible_drive, make_records, multisine
from gapcase import small_case

from hybrid_id import load_model, save_model
from hybrid_id.components import Cogging, KinematicError, LocalFriction, PositionDependent
from hybrid_id.components.base import Component
from hybrid_id.components.transmission.kinematic_error import WAVES
from hybrid_id.diagnosis import periodic
from hybrid_id.diagnosis.catalogue import CATALOGUE, effect, with_effect, with_further
from hybrid_id.diagnosis.fits import engine
from hybrid_id.diagnosis.grade import parameters_of
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.periodic import (
    Residual,
    friction_spots,
    friction_waves,
    gear_waves,
    rotor_waves,
)
from hybrid_id.diagnosis.scales import scales
from hybrid_id.diagnosis.validation import validation
from hybrid_id.identification.finite_differences import finite_difference_fit
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.study.replay import batch_of

NEAR = 0.1
"""Periods a turn that records of a few turns of the rotor tell apart."""


@cache
def left_by(law: type[Component], **values: float) -> Residual:
    """Today's model fitted to records of a drive with something beside its motor."""
    places = {Cogging: "motor", KinematicError: "transmission"}
    dataset, today = small_case(law(**values), f"joint1/{places.get(law, 'motor_friction')}")
    batch = batch_of(replace(dataset, signal_share=0.1), today, dataset.train)
    return Residual(finite_difference_fit(today, batch, engine=engine(), iterations=8), batch)


@pytest.mark.parametrize("n", [1.0, 2.23, 0.83])
def test_periods_of_cogging(n: float) -> None:
    """Also between whole numbers, beside a gear ratio that is not the nominal one, or of a shaft behind the rotor."""
    found, first, second = rotor_waves(left_by(Cogging, T_c=0.004, T_s=-0.003, n=n), 1, "motor")[0]
    assert found == pytest.approx(n, abs=NEAR)
    if n == 1.0:
        assert (first, second) == pytest.approx((0.004, -0.003), rel=0.5)


def test_a_wave_that_does_not_come_again_is_none() -> None:
    """Cogging repeats; what does not within the range may be any torque over the angle, a latch or a spring."""
    fit = left_by(Cogging, T_c=0.004, T_s=-0.003, n=1.0)
    phase = fit.batch.x[..., fit.opened(1, "motor").row]
    twice = 4.0 * np.pi / float(phase.max() - phase.min())
    assert all(n >= twice for n, *_ in rotor_waves(fit, 1, "motor"))
    short = replace(fit, batch=replace(fit.batch, x=1e-4 * fit.batch.x), _responses=fit._responses)
    assert rotor_waves(short, 1, "motor") == []  # no motor has so many periods a turn


def test_whole_numbers_of_periods_are_looked_at_however_far_the_rotor_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Over so many turns a wave between two that are looked at is lost; poles and slots have whole numbers of them."""
    fit = left_by(Cogging, T_c=0.004, T_s=-0.003, n=1.0)
    phase = fit.batch.x[..., fit.opened(1, "motor").row]
    wide = replace(
        fit,
        batch=replace(fit.batch, x=1e5 / float(phase.max() - phase.min()) * fit.batch.x),
        _responses=fit._responses,
    )
    monkeypatch.setattr(periodic, "_strongest", lambda opened, count, shape: [(i, ()) for i in range(count)])
    monkeypatch.setattr(periodic, "_peaks", list)
    periods = {n for (n,) in rotor_waves(wide, 1, "motor")}
    assert set(map(float, range(1, 49))) <= periods and 84.0 in periods
    monkeypatch.setattr(periodic, "_peaks", lambda found: found[-2:])  # the last that are looked at
    assert [n for (n,) in friction_waves(wide, 1, "motor_friction")] == [3.0, 4.0]


def test_error_of_a_gear() -> None:
    fit = left_by(KinematicError, E_c=2e-3, E_s=-3e-3, n=0.5)
    found = gear_waves(fit, 1, "transmission")
    assert found[0][0] == pytest.approx(0.5, abs=NEAR)
    assert found[0][1] > 0 > found[0][2]


def test_fits_begin_with_several_periods_of_a_gear() -> None:
    """Whole runs have lost the phase, so that the strongest wave there need not be the right one."""
    left = left_by(KinematicError, E_c=2e-3, E_s=-3e-3, n=0.5)
    system = left.result.system
    found = with_effect(effect("kinematic_error"), system, scales(system, left.batch)[0], left)
    begun = [one.parameter("n").spec for one in found["joint1/transmission"]]
    assert any(spec.lower <= 0.5 <= spec.upper for spec in begun)
    assert len({spec.value for spec in begun}) == 2 + WAVES


def test_errors_of_a_compliant_gear_and_their_overtone() -> None:
    """Of a gear behind which the link swings: what winds it up drives both sides."""
    today = flexible_drive()
    waves = KinematicError(E_c=1e-3, E_s=-5e-4, n=1.0, E_c2=3e-4, E_s2=2e-4, n_2=2.0)
    truth, noise = today.with_component("joint1/transmission", waves), {"q_m1": 1e-3, "q_a1": 1e-5}
    voltages = [multisine(k, samples=400, amplitude=6.0 + k, rest=20, step=0.005) for k in range(2)]
    records = make_records(truth, voltages, noise=noise, outputs=tuple(noise), step=0.005)
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 1e-3), Channel("q_a1", "rad", 1e-5))
    dataset = Dataset("wavy gear", *channels, tuple(records), 0.005)
    batch = batch_of(replace(dataset, signal_share=0.1), today, dataset.train)
    n, *size = gear_waves(
        Residual(finite_difference_fit(today, batch, engine=engine(), iterations=4), batch), 1, ""
    )[0]
    assert n == pytest.approx(1.0, abs=NEAR)
    assert np.linalg.norm(np.subtract(size, (1e-3, -5e-4))) < 0.4 * np.linalg.norm((1e-3, -5e-4))
    known = today.with_component("joint1/transmission", KinematicError(E_c=1e-3, E_s=-5e-4, n=1.0))
    others = gear_waves(
        Residual(finite_difference_fit(known, batch, engine=engine(), iterations=4), batch), 1, ""
    )
    n, *size = next(one for one in others if abs(one[0] - 1.0) > NEAR)
    assert n == pytest.approx(2.0, abs=NEAR)
    assert np.linalg.norm(np.subtract(size, (3e-4, 2e-4))) < 0.4 * np.linalg.norm((3e-4, 2e-4))


def test_waves_of_friction() -> None:
    fit = left_by(PositionDependent, A_c=0.004, A_s=0.003, n=7.0)
    found = friction_waves(fit, 1, "motor_friction")
    assert min(abs(n - 7.0) for n, _, _ in found) < 1.5


def test_a_local_friction_of_friction() -> None:
    fit = left_by(LocalFriction, A=0.008, q_0=0.2, w=0.1)
    angle = fit.batch.x[..., 0].numpy() / 50.0
    found = friction_spots(fit, 1, "motor_friction")
    assert min(abs(q - 0.2) for q, _, _ in found) < 0.1 * float(np.ptp(angle))
    assert all(height > 0 for _, _, height in found)


def test_models_from_a_scan_go_through_a_file(tmp_path: Path) -> None:
    left = left_by(LocalFriction, A=0.008, q_0=0.2, w=0.1)
    size = scales(left.result.system, left.batch)[0]
    for name in ("position_dependent_friction", "cogging"):
        for starts in with_effect(CATALOGUE[name], left.result.system, size, left).values():
            for start in starts:
                save_model(start, tmp_path / "model.yaml")
                assert list(load_model(tmp_path / "model.yaml").components) == list(start.components)


def test_a_second_wave_is_of_another_period() -> None:
    left = left_by(Cogging, T_c=0.003, T_s=-0.002, n=2.0)
    first = Cogging(T_c=0.004, T_s=0.0, n=1.0)
    system = left.result.system.with_component("joint1/motor", first)
    (freer,) = with_further(
        CATALOGUE["cogging"], system, "joint1/motor", left
    )  # which is the first one's overtone, too
    part = freer.components["joint1/motor/cogging"]
    assert part.specs["n_2"].value == 2.0
    assert not part.specs["n_2"].estimate
    assert part.specs["T_c2"].estimate
    assert part.specs["T_s2"].estimate
    assert part.specs["T_c2"].value > 0 > part.specs["T_s2"].value
    # where the strongest other wave is none, the overtone is tried beside it
    odd = left.result.system.with_component("joint1/motor", Cogging(T_c=0.004, T_s=0.0, n=3.0))
    periods = [s.components["joint1/motor/cogging"].specs["n_2"].value for s in
               with_further(CATALOGUE["cogging"], odd, "joint1/motor", left)]  # fmt: skip
    assert periods == pytest.approx([2.0, 6.0], abs=NEAR)
    # what is free already is not freed again
    assert not with_further(CATALOGUE["cogging"], freer, "joint1/motor", left)
    # a law with nothing left open
    assert not with_further(CATALOGUE["quadratic_drag"], system, "joint1/motor_friction", left)


def test_periods_that_are_fixed_are_told() -> None:
    left = left_by(Cogging, T_c=0.004, T_s=-0.003, n=1.0)
    system = left.result.system.with_component("joint1/motor", Cogging(T_c=0.003, T_s=-0.002, n=1.0))
    fit = finite_difference_fit(system, left.batch, engine=left.result.engine, iterations=8)
    name = ("cogging", "joint1/motor")
    told = parameters_of(FittedModel((name,), fit, validation(fit.residual, 0.005, fit.records)), name)
    assert set(told) == {"T_c", "T_s", "n"}
    assert told["n"] == (1.0, 0.0)
    assert told["T_c"][1] > 0.0

"""What start values are measured by does not depend on what has been added already."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import STEP, multisine
from gapcase import RATIO, small_case

from hybrid_id.components import Coulomb, Dahl, ElectricalLag
from hybrid_id.diagnosis.catalogue import effect, with_effect
from hybrid_id.diagnosis.scales import scales
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.study.replay import batch_of
from hybrid_id.systems import two_link


@pytest.mark.parametrize(
    ("place", "part"), [("motor", ElectricalLag(T_e=0.01)), ("motor_friction", Dahl(sigma=0.1))]
)
def test_torque_is_known_beside_what_remembers(place, part) -> None:
    dataset, today = small_case()
    richer = today.with_component(f"joint1/{place}", part)
    plain, known = (
        scales(s, batch_of(replace(dataset, signal_share=0.1), s, dataset.train))[0] for s in (today, richer)
    )
    assert known.torque == pytest.approx(plain.torque)
    assert known.dry == pytest.approx(plain.dry, rel=1e-3)


def test_the_second_joint_of_an_arm_is_known_beside_a_lag_of_the_first() -> None:
    arm, u = two_link((50.0, 40.0)), multisine(0, samples=400)
    time = STEP * np.arange(400)
    motion = {"q_m1": 3.0 * np.sin(5.0 * time), "q_m2": 7.0 * np.cos(3.0 * time)}
    record = Record("moves", time, {"u1": u, "u2": 0.5 * u}, motion)
    late = arm.with_component("joint1/motor", ElectricalLag(T_e=0.01))
    plain, known = (scales(s, make_batch(s, [record])) for s in (arm, late))
    assert known == plain
    assert plain[1].turns > 2.0 * plain[0].turns


def test_a_drive_that_never_moves_has_scales_to_divide_by() -> None:
    dataset, today = small_case()
    batch = batch_of(dataset, today, dataset.train)
    still = replace(
        batch, x=torch.zeros_like(batch.x), u={k: torch.zeros_like(v) for k, v in batch.u.items()}
    )
    (size,) = scales(today, still)
    assert min(size.speed, size.turns, size.angle, size.torque, size.command, size.command_rms) == 1.0


def test_long_rests_make_nothing_smaller() -> None:
    """A pause of any length after a move: what moves is as fast and as strong as it was."""
    dataset, today = small_case()
    batch = batch_of(replace(dataset, signal_share=0.1), today, dataset.train)
    x, pause = batch.x, 40 * batch.x.shape[1]

    def paused(signal: torch.Tensor, last: torch.Tensor) -> torch.Tensor:
        return torch.cat([signal, last.expand(len(signal), pause, *signal.shape[2:])], 1)

    rest = x[:, -1:].clone()
    rest[..., 1] = 1e-3 * x[..., 1].abs().max()  # an encoder's noise
    longer = replace(
        batch,
        x=paused(x, rest),
        u={name: paused(u, torch.zeros(1, 1)) for name, u in batch.u.items()},
        weight=paused(batch.weight, batch.weight[:, -1:]),
    )
    plain, known = (scales(today, one)[0] for one in (batch, longer))
    assert known.speed == pytest.approx(plain.speed, rel=0.01)
    assert known.torque == pytest.approx(plain.torque, rel=0.01)
    assert known.command_rms == pytest.approx(plain.command_rms)


def test_friction_on_the_links_side_of_a_rigid_gear_is_known() -> None:
    dataset, today = small_case()
    level = today.parameter("F_c").spec.value
    moved = today.without_component("joint1/motor_friction", "coulomb_friction")
    moved = moved.with_component("joint1/link_friction", Coulomb(F_c=RATIO * level))
    plain, known = (
        scales(s, batch_of(replace(dataset, signal_share=0.1), s, dataset.train))[0] for s in (today, moved)
    )
    assert known.dry == pytest.approx(plain.dry)
    alone = moved.without_component("joint1/motor_friction", "viscous_friction")
    for name in ("stribeck_friction", "presliding_friction"):
        assert list(with_effect(effect(name), alone, known)) == ["joint1/link_friction"]
        assert list(with_effect(effect(name), today, plain)) == ["joint1/motor_friction"]


def test_viscous_friction_is_looked_for_where_the_motors_torque_is_seen() -> None:
    dataset, today = small_case()
    bare = today.without_component("joint1/motor_friction", "viscous_friction")
    batch = batch_of(replace(dataset, signal_share=0.1), bare, dataset.train)
    off = replace(batch, u=dict(batch.u) | {"enable1": torch.zeros_like(batch.dt)})
    for seen, places in (
        (batch, []),
        (replace(batch, outputs=("i1",)), ["joint1/motor_friction"]),
        (off, None),
    ):
        found = list(with_effect(effect("viscous_friction"), bare, scales(bare, seen)[0]))
        assert found == (["joint1/motor_friction"] if places is None else places)

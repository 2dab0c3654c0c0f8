"""Records to tensors: start states, weights, padding, switches, windows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from drives import flexible_drive, make_record, multisine, rigid_drive

from hybrid_id.components import MotorEncoder
from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import Horizon
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import LEAST, make_batch, typical_deviations
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.builders import one_link_flexible, robot

NOISE = {"q_m1": 0.01, "q_a1": 1e-4, "v_m1": 0.1, "i1": 0.01}


def record(seed: int = 0, samples: int = 400, outputs: tuple[str, ...] = ("q_m1",), system=None) -> Record:
    return make_record(
        system or rigid_drive(),
        multisine(seed, samples=samples),
        seed=seed,
        noise=NOISE,
        outputs=outputs,
        name=f"r{seed}",
    )


def test_start_is_the_mean_of_the_samples_at_rest() -> None:
    r = record()
    batch = make_batch(rigid_drive(), [r], noise_std=NOISE)
    assert batch.x[0, 0, 1] == 0.0
    assert batch.x[0, 0, 0].item() == pytest.approx(r.outputs["q_m1"][:50].mean(), abs=1e-9)
    assert batch.x0_std[0, 0].item() == pytest.approx(0.01 / np.sqrt(50), rel=0.05)
    assert batch.x0_std[0, 1] == 0.0
    held = make_batch(rigid_drive(), [r], noise_std=NOISE, estimate_start=False)
    assert (held.x0_std == 0).all()


def test_start_in_motion_is_free_within_its_uncertainty() -> None:
    r = record(samples=800)
    cut = r.between(0.5, 1.2)
    batch = make_batch(rigid_drive(), [cut], noise_std=NOISE)
    truth = simulate(rigid_drive(), Engine(), make_batch(rigid_drive(), [r])).x[0, 250, 1].item()
    assert (batch.x0_std[0] > 0).all()
    assert abs(batch.x[0, 0, 1].item() - truth) < 3 * batch.x0_std[0, 1].item()


def test_records_of_different_length_are_padded() -> None:
    records = [record(1, samples=300), record(2, samples=500)]
    batch = make_batch(rigid_drive(), records, noise_std=NOISE)
    assert batch.dt.shape == (2, 500)
    assert (batch.dt[0, 299:] == 0).all() and batch.dt[0, 298] > 0 and batch.dt[1, 499] == 0
    assert (batch.weight[0, 300:] == 0).all() and (batch.weight[0, :300] > 0).all()
    assert batch.names == ("r1", "r2")
    free_run = simulate(rigid_drive(), Engine(), batch)
    alone = simulate(rigid_drive(), Engine(), make_batch(rigid_drive(), records[:1], noise_std=NOISE))
    torch.testing.assert_close(free_run.y[0, :300], alone.y[0], rtol=0, atol=1e-9)


def test_weight_is_noise_plus_a_share_of_the_signal() -> None:
    r = record(outputs=("q_m1", "i1"))
    batch = make_batch(rigid_drive(), [r], noise_std=NOISE)
    for k, name in enumerate(("q_m1", "i1")):
        std = np.hypot(NOISE[name], 0.004 * np.std(r.outputs[name]))
        np.testing.assert_allclose(batch.weight[0, :, k], 1 / std)
    bare = make_batch(rigid_drive(), [r], outputs=["i1"], noise_std=NOISE, signal_share=0.0)
    np.testing.assert_allclose(bare.weight[0, :, 0], 100.0)


def test_noise_is_estimated_where_nobody_tells_it() -> None:
    batch = make_batch(rigid_drive(), [record(samples=1500)], signal_share=0.0)
    assert 1 / batch.weight[0, 0, 0].item() == pytest.approx(0.01, rel=0.15)


def test_a_record_in_which_a_joint_stands_is_not_taken_for_exact() -> None:
    """It shows neither its sensor's noise nor what a model misses: a tenth of what others do is the least."""
    moving = [record(seed=1), record(seed=2)]
    angle = moving[0].outputs["q_m1"]
    rounding, still = 0.3 + 1e-12 * np.sin(np.arange(angle.size)), np.full_like(angle, 0.3)
    rests, stands = (replace(moving[0], outputs={"q_m1": values}) for values in (rounding, still))
    batch = make_batch(rigid_drive(), [*moving, rests, stands])
    usual = np.median([1.0 / batch.weight[k, 0, 0].item() for k in range(2)])
    among = typical_deviations([*moving, rests, stands])["q_m1"]
    assert among <= usual and 1.0 / batch.weight[2, 0, 0].item() == pytest.approx(LEAST * among)
    assert 1.0 / batch.weight[3, 0, 0].item() == pytest.approx(among)
    alone = make_batch(rigid_drive(), [stands], typical=typical_deviations(moving))
    assert 1.0 / alone.weight[0, 0, 0].item() == pytest.approx(usual)


def test_uneven_stamps_become_steps() -> None:
    r = record()
    time = r.time + 0.0005 * np.sin(np.arange(r.n_samples))
    batch = make_batch(rigid_drive(), [replace(r, time=time)], noise_std=NOISE)
    np.testing.assert_allclose(batch.dt[0, :-1], np.diff(time))


@pytest.mark.parametrize("outputs", [("q_a1",), ("v_m1",), ("q_m1", "q_a1"), ("v_a1", "i1")])
def test_guess_of_the_states_from_any_output(outputs: tuple[str, ...]) -> None:
    system = flexible_drive()
    noise = dict.fromkeys(("q_m1", "q_a1", "v_m1", "v_a1", "i1"), 1e-6)
    u = multisine(3, samples=400)
    r = make_record(system, u, seed=3, noise=noise, outputs=outputs)
    batch = make_batch(system, [r], noise_std=noise)
    truth = simulate(
        system, Engine(substeps=4), make_batch(system, [r], noise_std=noise, estimate_start=False)
    ).x[0]
    link = (batch.x[0, 50:, 3] - truth[50:, 3]).std() / truth[50:, 3].std()
    assert link < (0.05 if outputs[-1] == "q_a1" else 0.6)
    assert (batch.x0_std[0, 1] == 0) and (batch.x0_std[0, 3] == 0)  # at rest
    settled = simulate(system, Engine(substeps=4), replace(batch, x0_std=0 * batch.x0_std))
    assert settled.status == ("ok",)
    assert batch.outputs == outputs


@pytest.mark.parametrize("outputs", [("q_m1",), ("q_a1",), ("q_m1", "q_a1")])
def test_a_hanging_load_has_wound_up_the_gear_from_whichever_side_it_is_seen(
    outputs: tuple[str, ...],
) -> None:
    """The motor's dry friction holds the load: both sides stay at rest, as far apart as its torque asks."""
    bare = one_link_flexible(156.0, vertical=True)
    system = bare.with_values(
        {"k": 300.0, "G_l": 6.0, "F_cm": 0.05, "F_va": 0.3, "P_m1": 0.019, "P_m2": 0.0254}
    )
    angle = 0.6
    twist = -6.0 * np.sin(angle) / 300.0
    seen = {"q_m1": np.full(400, 156.0 * (angle - twist)), "q_a1": np.full(400, angle)}
    still = Record(
        "r0", 0.002 * np.arange(400), {"u1": np.zeros(400)}, {name: seen[name] for name in outputs}
    )
    batch = make_batch(system, [still], noise_std=dict.fromkeys(seen, 1e-4))
    assert batch.x[0, 0, 2] - batch.x[0, 0, 0] / 156.0 == pytest.approx(twist, rel=0.02)
    run = simulate(system, Engine(substeps=4), replace(batch, x0_std=0 * batch.x0_std))
    assert np.ptp(run.x[0, :, 2].numpy()) < 0.05 * abs(twist)


def test_readings_that_stay_on_one_count_do_not_average() -> None:
    r = record()
    count = 0.2
    coarse = replace(r, outputs={"q_m1": count * np.floor(r.outputs["q_m1"] / count + 0.5)})
    assert np.ptp(coarse.outputs["q_m1"][:20]) == 0.0
    std = make_batch(rigid_drive(), [coarse], noise_std=NOISE).x0_std[0, 0].item()
    assert std == pytest.approx(count / np.sqrt(12), rel=0.01)


def test_encoder_offset_is_taken_off_the_start() -> None:
    system = rigid_drive(vertical=True).with_component("joint1/sensor", MotorEncoder(offset=30.0))
    r = record(system=system)
    assert abs(r.outputs["q_m1"][:50].mean() - 30.0) < 0.01
    batch = make_batch(system, [r], noise_std=NOISE)
    assert abs(batch.x[0, 0, 0].item()) < 0.01
    residual = simulate(system, Engine(substeps=4), batch).y[0, :, 0] - batch.y[0, :, 0]
    assert residual.std() < 0.02


def test_encoder_offset_of_a_joint_with_two_digits_is_its_own(tmp_path: Path) -> None:
    bodies = "".join(
        f'<body><joint name="j{k}" axis="0 0 1" armature="0.01"/><inertial mass="1" pos="0.1 0 0" '
        'diaginertia="0.01 0.01 0.01"/></body>'
        for k in range(11)
    )
    (tmp_path / "row.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    system = robot(load_tree(tmp_path / "row.xml"))
    system = system.with_component(
        "joint11/sensor", MotorEncoder(offset=Bounded(3.0, -1e3, 1e3, "rad", True))
    )
    time = 0.002 * np.arange(100)
    torques = {f"tau{k}": 0.0 * time for k in range(1, 12)}
    angles = {f"q_m{k}": 3.0 + 0.0 * time for k in range(1, 12)}
    batch = make_batch(system, [Record("run", time, torques, angles)])
    rows = [joint.positions[0] for joint in system.joints]
    assert batch.x[0, 0, rows].tolist() == pytest.approx([3.0] * 10 + [0.0])
    assert (batch.x0_std[0, rows] > 0.5).tolist() == [False] * 10 + [True]


def test_switch_is_read_where_records_have_it() -> None:
    r = record()
    off = replace(r, inputs={**r.inputs, "enable1": (r.time > 0.3).astype(float)}, name="off")
    batch = make_batch(rigid_drive(), [r, off], noise_std=NOISE)
    assert (batch.u["enable1"][0] == 1).all(), "a record without a switch has its motor on"
    assert (batch.u["enable1"][1, :100] == 0).all()
    assert "enable1" not in make_batch(rigid_drive(), [r], noise_std=NOISE).u


@pytest.mark.parametrize(
    "change, words",
    [
        ({"inputs": {"tau1": np.zeros(400)}}, ("'r0'", "'u1'")),
        ({"outputs": {"i1": np.zeros(400)}}, ("'r0'", "neither angle nor speed")),
    ],
)
def test_missing_channel_is_named(change: dict, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        make_batch(rigid_drive(), [replace(record(), **change)], noise_std=NOISE)
    assert all(word in str(caught.value) for word in words), caught.value


def test_output_that_a_record_lacks_is_named() -> None:
    for outputs in (["q_a1"], ["u1"]):  # u1 is there, but as an input
        with pytest.raises(InputError, match=outputs[0]):
            make_batch(rigid_drive(), [record()], outputs=outputs, noise_std=NOISE)
    with pytest.raises(InputError, match="no record"):
        make_batch(rigid_drive(), [])


def test_windows_cover_the_record_and_start_where_it_is() -> None:
    batch = make_batch(rigid_drive(), [record(1), record(2, samples=300)], noise_std=NOISE)
    windows, row = batch.windows(100, 100, torch.full((2, 2), 0.5))
    assert windows.dt.shape == (7, 100)  # 4 of the long one, 3 of the short one: padding alone makes none
    assert row.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert (windows.dt[:, -1] == 0).all()
    torch.testing.assert_close(windows.x[1], batch.x[0, 100:200])
    torch.testing.assert_close(windows.y[6, :, 0], batch.y[1, 200:300, 0])
    assert (windows.x0_std == 0.5).all()


@pytest.mark.parametrize("side", ["q_m1", "q_a1"])
def test_a_gear_may_begin_as_far_wound_up_as_its_drive_winds_it(side: str) -> None:
    """Free by a tenth of the motion, a gear that is nearly rigid began anywhere, and explained short records."""
    quiet = {side: 1e-9}
    later = make_record(
        flexible_drive(), multisine(1, samples=800), seed=1, noise=quiet, outputs=(side,), name="later"
    ).between(0.5, 1.5)
    spread, motors = [], []
    for k in (50.0, 100.0):
        soft = flexible_drive().with_values({"k": k})
        batch = make_batch(soft, [later], noise_std=quiet)
        joint = soft.joints[0]
        hidden = joint.positions[1] if side == "q_m1" else joint.positions[0]
        spread.append(batch.x0_std[0, hidden].item())
        rows, views = list(batch.x[0].unbind(1)), soft.views(list(soft.theta()[:, None].detach()))
        drive = joint.drive.torque(rows, {name: u[0] for name, u in batch.u.items()}, views)
        twist = joint.gear_ratio * drive.square().mean().sqrt().item() / k
        motors.append(twist if side == "q_m1" else twist * joint.gear_ratio)
    assert spread == pytest.approx(motors, rel=1e-3)


def test_what_a_fit_may_move_of_a_record_is_its_own() -> None:
    long, short = (
        make_record(flexible_drive(), multisine(1, samples=n), seed=1, noise=NOISE, name=f"r{n}").between(
            0.5, end
        )
        for n, end in ((3000, 5.5), (800, 1.1))
    )
    both, alone = (make_batch(flexible_drive(), some, noise_std=NOISE) for some in ([long, short], [short]))
    torch.testing.assert_close(both.x0_std[1], alone.x0_std[0])


@pytest.mark.parametrize(
    "outputs, rows",
    [
        (("q_m1",), [2, 3]),
        (("q_a1",), [0, 1]),
        (("v_a1",), [0, 1]),
        (("q_a1", "v_m1"), [0]),
        (("q_m1", "v_a1"), [2]),
        (("q_m1", "q_a1"), []),
    ],
)
def test_what_no_encoder_tells_is_hidden_and_held_in_windows(
    outputs: tuple[str, ...], rows: list[int]
) -> None:
    system = flexible_drive()
    assert system.joints[0].hidden_rows(outputs) == rows
    one = make_record(system, multisine(1, samples=800), seed=1, noise=NOISE, outputs=outputs, name="r")
    batch = make_batch(system, [one], noise_std=NOISE)
    pieces = Horizon("windows", 0.5).cut(system, Engine(), batch)
    assert (pieces.x0_std[:, rows] == 0.0).all()
    assert (pieces.x0_std < 0.1 * batch.x[0].std(0)).all()  # nothing is free but for what a sensor leaves


def test_offset_that_is_estimated_frees_the_start_angle() -> None:
    held, free = (
        rigid_drive(vertical=True).with_component(
            "joint1/sensor", MotorEncoder(offset=Bounded(3.0, -1e3, 1e3, "rad", estimate))
        )
        for estimate in (False, True)
    )
    r = record(system=held)
    assert make_batch(held, [r], noise_std=NOISE).x0_std[0, 0] < 0.01
    assert make_batch(free, [r], noise_std=NOISE).x0_std[0, 0] > 1.0


def test_output_that_never_changes_takes_its_weight_from_other_records() -> None:
    time = 0.002 * np.arange(100)
    still = Record("still", time, {"u1": 0.1 * np.sin(9 * time)}, {"q_m1": np.full(100, 0.4)})
    batch = make_batch(rigid_drive(), [record(), still])
    assert batch.weight[1, 0, 0] == batch.weight[0, 0, 0]
    assert (make_batch(rigid_drive(), [still]).weight == 1.0).all()


@pytest.mark.parametrize("samples", [2, 4])
def test_record_of_a_few_samples_is_refused_by_name(samples: int) -> None:
    with pytest.raises(InputError, match=rf"record 'r0' has {samples} samples; give at least 5"):
        make_batch(rigid_drive(), [record().between(0.2, 0.2 + 0.002 * (samples - 0.5))])


def test_padding_is_no_part_of_a_record() -> None:
    values = torch.tensor([[[1.0], [3.0], [3.0], [3.0]], [[1.0], [2.0], [3.0], [4.0]]], dtype=torch.float64)
    weight = torch.tensor([[[1.0], [1.0], [0.0], [0.0]], [[1.0]] * 4], dtype=torch.float64)
    empty = torch.zeros(2, 4, dtype=torch.float64)
    batch = Batch({}, empty, values, weight, values, empty[:, :1], ("q_m1",), ("short", "long"))
    torch.testing.assert_close(batch.std(values)[:, 0], torch.stack([values[0, :2].std(), values[1].std()]))

"""Arms, repeats and splits of an ablation, and the models that it compares."""

# pyright: reportCallIssue=false

from dataclasses import replace

import pytest
import torch
from drives import flexible_drive, make_record, multisine, rigid_drive

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study.ablation_plan import BLACK_BOX, Arm, Cell, Factors, plan, split_records, with_arm
from hybrid_id.systems import two_link
from hybrid_id.systems.builders import black_box
from hybrid_id.systems.model_file import describe_model

DRIVE = rigid_drive(ratio=20.0)


def dataset(count: int, tests: int = 0) -> Dataset:
    record = make_record(DRIVE, multisine(0, samples=40, rest=5), seed=0, noise={})
    records = [
        replace(record, name=f"run_{k}", role="test" if k >= count - tests else "train", note=f"{k} V")
        for k in range(count)
    ]
    return Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), tuple(records))


def test_every_combination_is_an_arm_beside_physics_only() -> None:
    factors = Factors(widths=(4, 8), places=(("joint1/motor",), ("joint1/input",)), physics=(("F_v",),))
    arms = factors.arms
    assert arms[0] == Arm() and arms[-1].residual == BLACK_BOX
    assert len(arms) == 2 * (1 + 2 * 2 * 2) + 1 == len(set(arms)) == len({arm.name for arm in arms})
    cells = plan(factors, range(5))
    assert len({cell.name for cell in cells}) == len(cells) == 5 * len(arms)
    assert all(cell.name.replace("-", "").replace("_", "").isalnum() for cell in cells)
    assert Factors(residuals=(), black_box=None).arms == [Arm()]


def test_a_split_is_the_seeds_alone_and_divides_no_experiment() -> None:
    data = dataset(10)
    first, again, other = (split_records(data, seed) for seed in (3, 3, 4))
    assert first == again != other
    parts = first.train, first.validation, first.test
    assert [len(p) for p in parts] == [6, 2, 2] and len(set().union(*parts)) == 10
    assert first.overlap == pytest.approx(2 / 8)


def test_test_records_stay_test_records() -> None:
    splits = [split_records(dataset(10, tests=3), seed) for seed in range(4)]
    assert {split.test for split in splits} == {("run_7", "run_8", "run_9")}
    assert len({split.train for split in splits}) > 1


def test_validation_records_validate_in_every_repeat() -> None:
    data = dataset(10, tests=3)
    records = (replace(r, role="validation") if r.name in ("run_0", "run_4") else r for r in data)
    data = replace(data, records=tuple(records))
    for seed in range(4):
        split = split_records(data, seed, beyond=["run_1"])
        assert split.validation == ("run_0", "run_4") and split.train == ("run_2", "run_3", "run_5", "run_6")
    assert (
        len(split_records(data, 0, beyond=["run_0", "run_4"]).validation) == 1
    )  # drawn, as there is none in range


def test_what_is_out_of_range_is_never_trained_on() -> None:
    for seed in range(4):
        split = split_records(dataset(8), seed, beyond=["run_2", "7 V"])
        assert split.beyond == ("run_2", "run_7")
        assert not {*split.beyond} & {*split.train, *split.validation, *split.test}


def test_faults_of_a_split_are_told() -> None:
    with pytest.raises(InputError, match="Pattern 'run_9' fits no name"):
        split_records(dataset(5), 0, beyond=["run_9"])
    with pytest.raises(InputError, match="too few records"):
        split_records(dataset(2), 0)


def test_physics_is_taken_out_by_component_or_parameter() -> None:
    arm = Arm(
        "memory", ("joint1/motor", "joint1/input"), 4, ("F_v", "joint1/motor_friction/coulomb_friction")
    )
    system = with_arm(DRIVE, arm, ("speed",), memory=3, lipschitz=None, seed=1)
    assert system.parameter("F_v").spec.value == 0.0 and not system.parameter("F_v").spec.estimate
    assert "joint1/motor_friction/coulomb_friction" not in system.components
    assert len(system.networks) == 2 and all(part.memory == 3 for part in system.networks.values())
    for taken, words in (
        (("F_x",), "no parameter 'F_x'"),
        (("J",), "J cannot be zero"),
        (("a/b/c",), "no c at"),
    ):
        with pytest.raises(InputError, match=words):
            with_arm(DRIVE, Arm(without=taken), ("speed",), 0, None, 0)


@pytest.mark.parametrize("system", [DRIVE, flexible_drive(), two_link((20.0, 30.0))], ids=lambda s: s.name)
def test_a_network_alone_moves_by_nothing_else(system) -> None:
    accelerations = [100.0 * (k + 1) for k in range(len(system.joints))]
    alone = black_box(system, accelerations, hidden=(4,), seed=0)
    assert [info.symbol for info in alone.table if info.spec.estimate] == ["T_0"] * len(system.joints)
    assert all(joint.rigid for joint in alone.joints) and alone.input_names == system.input_names
    for part in alone.networks.values():
        with torch.no_grad():
            part.layers[-1].bias.fill_(2.0)
    x = [torch.full((3,), 0.5, dtype=torch.float64)] * len(alone.state_names)
    u = {name: torch.ones(3, dtype=torch.float64) for name in alone.input_names}
    rates = alone.rates(x, u, alone.views(list(alone.theta()[:, None])))
    for row, acceleration in zip(alone.speed_rows, accelerations, strict=True):
        torch.testing.assert_close(rates[row], 2.0 * acceleration * torch.ones(3, dtype=torch.float64))
    assert describe_model(alone)["system"] == system.name


def test_a_network_alone_needs_a_size() -> None:
    with pytest.raises(InputError, match="positive"):
        black_box(DRIVE, [0.0])


def test_a_network_alone_sleeps_at_first() -> None:
    record = make_record(DRIVE, multisine(0, samples=40, rest=10), seed=0, noise={"q_m1": 0.01})
    alone = black_box(DRIVE, [10.0])
    run = simulate(alone, Engine("smooth"), make_batch(alone, [record]))
    assert run.x[..., 1].abs().max() == 0.0 and Cell(Arm(), 3).name == "physics-only-seed-3"


def test_a_cell_of_many_places_has_a_name_that_a_file_system_takes() -> None:
    places = tuple(f"left_shoulder_pitch_joint_{k}/motor_friction" for k in range(7))
    names = {Cell(Arm("static", places[:n], 8), 1).name for n in (6, 7)}
    assert len(names) == 2 and all(len(name) < 150 for name in names)

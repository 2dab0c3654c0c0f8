"""Free runs over whole records, from rest to rest, or over windows, and which of them the records ask for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import make_record, multisine, rigid_drive
from torch import Tensor

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import (
    WHOLE,
    Horizon,
    choose_horizon,
    free_runs,
)
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import Simulation, simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import compare, identify
from hybrid_id.systems.builders import one_link

ENGINE = Engine(compiled=compiler() is not None)
TRUTH = rigid_drive()
START = TRUTH.with_values({"F_c": 0.007, "F_v": 6e-5}).with_specs(
    {"J": replace(TRUTH.parameter("J").spec, estimate=False)}
)


def strokes_of_voltage(seed: int, samples: int = 2500) -> np.ndarray:
    """Pulses of voltage there and back, with rests between them."""
    generator, wave, k, side = np.random.default_rng(seed), np.zeros(samples), 50, 1.0
    while k < samples:
        length = int(generator.integers(150, 350))
        wave[k : k + length] = side * generator.uniform(4.0, 9.0)
        k, side = k + length + 120, -side
    return wave


def drifting(waves: Sequence[np.ndarray], strength: float) -> list[Record]:
    """Records whose voltage is disturbed slowly beside what the logger saw: free runs drift off the angle."""
    found = []
    for k, wave in enumerate(waves):
        noise = np.random.default_rng(100 + k).standard_normal(len(wave))
        slow = np.zeros(len(wave))
        for i in range(1, len(wave)):
            slow[i] = 0.98 * slow[i - 1] + strength * 0.2 * noise[i]
        record = make_record(TRUTH, wave + slow * (wave != 0), seed=k, noise={"q_m1": 0.01}, name=f"run_{k}")
        found.append(Record(record.name, record.time, {"u1": wave}, dict(record.outputs)))
    return found


@pytest.fixture(scope="module")
def drifted() -> list[Record]:
    return drifting([strokes_of_voltage(k) for k in range(3)], 1.5)


@pytest.fixture(scope="module")
def sound() -> list[Record]:
    return drifting([strokes_of_voltage(k) for k in range(3)], 0.0)


def dataset_of(records: Sequence[Record]) -> Dataset:
    channels = Channel("u1", "V"), Channel("q_m1", "rad")
    return Dataset("bench", channels[:1], channels[1:], tuple(records))


def samples_of(batch: Batch, name: str) -> int:
    rows = torch.tensor([own == name for own in batch.names])
    return int((batch.weight[rows] > 0).any(2).sum())


def test_words_of_the_user_are_horizons() -> None:
    assert Horizon.of("auto") is None
    assert Horizon.of("whole") == WHOLE
    assert Horizon.of("strokes") == Horizon("strokes")
    assert Horizon.of("0.5") == Horizon.of(0.5) == Horizon("windows", 0.5)
    for wrong in ("-1", "0", "inf", "nan", "long"):
        with pytest.raises(InputError, match="give a length in seconds"):
            Horizon.of(wrong)
    assert str(Horizon("windows", 0.5)) == "free runs of 0.5 s from measured states"


def test_strokes_begin_at_rests_and_follow_each_other_without_overlap(sound: list[Record]) -> None:
    batch = make_batch(TRUTH, sound)
    part = Horizon("strokes").cut(TRUTH, ENGINE, batch)
    assert part.rows > 2 * batch.rows
    assert tuple(dict.fromkeys(part.names)) == batch.names
    for name in batch.names:
        assert samples_of(part, name) == samples_of(batch, name)
    speed = TRUTH.joints[0].positions[0] + 1
    assert float(part.x[:, 0, speed].abs().max()) < 0.02 * float(batch.x[..., speed].abs().max())
    first = part.names.index("run_1")
    assert torch.equal(part.y[first, 0], batch.y[1, 0])
    last = int((part.weight[0] > 0).any(1).sum())
    assert torch.equal(part.y[1, 0], batch.y[0, last])


def test_records_that_never_rest_stay_whole() -> None:
    batch = make_batch(TRUTH, drifting([multisine(0)], 0.0))
    assert Horizon("strokes").cut(TRUTH, ENGINE, batch) is batch


def test_strokes_of_a_sound_model_fit_the_same_values(sound: list[Record]) -> None:
    batch = make_batch(START, sound)
    (whole,) = fit(START, batch, engine=ENGINE, pooled=True)
    part = Horizon("strokes").cut(START, ENGINE, batch)
    (cut,) = fit(START, part, engine=ENGINE, pooled=True)
    np.testing.assert_allclose(cut.values, whole.values, rtol=0.03)
    each = fit(START, part, engine=ENGINE)
    assert len(each) == batch.rows
    assert set(each[1].records) == {"run_1"}


def test_whole_records_are_chosen_where_free_runs_follow_them(sound: list[Record]) -> None:
    batch = make_batch(START, sound)
    assert choose_horizon(START, ENGINE, batch).kind == "whole"


def test_windows_are_chosen_where_free_runs_drift_and_find_better_values(drifted: list[Record]) -> None:
    batch = make_batch(START, drifted)
    (whole,) = fit(START, batch, engine=ENGINE, pooled=True)
    said: list[tuple[int, int]] = []
    chosen = choose_horizon(START, ENGINE, batch, [whole], say=lambda *counts: said.append(counts))
    assert chosen.kind != "whole" and Horizon.of(chosen.wish) == replace(chosen, reason="")
    assert said == [(done, 6) for done in range(6)]  # each fit is counted before it is made
    assert "whole runs lose the records after" in str(chosen)
    (cut,) = fit(START, chosen.cut(START, ENGINE, batch), engine=ENGINE, pooled=True)
    truth = np.array([TRUTH.parameter(name).spec.value for name in cut.names])
    error = [np.linalg.norm(np.log(np.maximum(one.values, 1e-9) / truth)) for one in (whole, cut)]
    assert error[1] < 0.7 * error[0]


def test_study_uses_its_horizon_throughout(drifted: list[Record]) -> None:
    dataset = dataset_of([*drifted[:2], replace(drifted[2], role="test")])
    study = identify(dataset, START, engine=ENGINE, horizon=Horizon("windows", 0.5))
    assert study.horizon == Horizon("windows", 0.5)
    assert [set(one.records) for one in study.sets] == [{"run_0"}, {"run_1"}]
    assert study.cross_validation.record_names == ("run_0", "run_1")
    assert study.cross_validation.fits.shape[:2] == (2, 2)
    assert study.cross_validation.fits[..., 0].min() > 80.0
    assert 0.0 < study.test_nrmse["run_2"] < 0.2
    assert np.isfinite(study.engine_error)


def test_models_are_compared_over_one_horizon(drifted: list[Record]) -> None:
    dataset, models = dataset_of(drifted), {"start": START, "truth": TRUTH}
    long, short = (
        compare(dataset, models, engine=ENGINE, horizon=h) for h in (WHOLE, Horizon("windows", 0.25))
    )
    assert short.horizon.seconds == 0.25
    assert (short.table("nrmse")["truth"] < long.table("nrmse")["truth"]).all()
    run = short.replays["truth"][0].outputs["q_m1"]
    assert len(run) == 2500
    assert compare(dataset, models, engine=ENGINE).horizon.kind != "whole"


def test_no_window_errs_more_than_from_its_measured_state(sound: list[Record]) -> None:
    """Where a joint sticks, a step of its first state says nothing of what happens beyond."""
    stuck = TRUTH.with_values({"F_c": 6.0 * TRUTH.parameter("F_c").spec.value})
    batch = make_batch(stuck, sound, noise_std={"q_m1": 1e-5}, signal_share=0.0)
    pieces = Horizon("windows", 0.25).cut(stuck, ENGINE, batch)

    def errors(run: Simulation) -> Tensor:
        return ((run.y - pieces.y) * pieces.weight).square().sum((1, 2))

    measured, moved = errors(simulate(stuck, ENGINE, pieces)), errors(free_runs(stuck, ENGINE, pieces))
    assert (moved <= (1.0 + 1e-5) * measured).all() and (moved < 0.9 * measured).any()


def test_strokes_are_cut_alike_for_a_rigid_and_a_compliant_gear(sound: list[Record]) -> None:
    """With encoders on both sides the rests are those of the rotor, or models would be compared over other pieces."""
    rigid = one_link(50.0)
    link = [np.roll(record.outputs["q_m1"], 3) / 50.0 for record in sound]
    both = [
        replace(record, outputs={"q_m1": record.outputs["q_m1"], "q_a1": angle})
        for record, angle in zip(sound, link, strict=True)
    ]
    compliant = rigid.with_component("joint1/transmission", REGISTRY["joint_flexibility"](compliance=0.02))
    noise = {"q_m1": 0.01, "q_a1": 0.001}
    found = [
        Horizon("strokes").cut(system, ENGINE, make_batch(system, both, noise_std=noise))
        for system in (rigid, compliant)
    ]
    assert found[0].rows == found[1].rows > len(sound)
    assert (found[0].weight > 0).equal(found[1].weight > 0)

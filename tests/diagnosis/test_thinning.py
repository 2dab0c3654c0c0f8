"""Records are thinned where that loses nothing, by what the train records and the nominal model say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drives import make_records, multisine, rigid_drive

from hybrid_id.diagnosis.thinning import thinned
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.systems import System

STEP, NOISE = 0.002, 0.02


def slow_drive() -> tuple[Dataset, System]:
    """Records of 2 s at 2 ms, the last of them a test record, and the drive that made them."""
    truth = rigid_drive(ratio=50.0)
    voltages = [multisine(k, samples=1001, amplitude=6.0, rest=20, step=STEP) for k in range(3)]
    records = make_records(truth, voltages, noise={"q_m1": NOISE}, step=STEP)
    records[2] = replace(records[2], role="test")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", NOISE),)
    return Dataset("slow drive", *channels, tuple(records), STEP), truth


def with_output(dataset: Dataset, added: float, role: str) -> Dataset:
    """A ringing of 110 Hz on the angles of the records of one role."""
    records = []
    for record in dataset:
        ringing = added * np.sin(2 * np.pi * 110.0 * record.time) * (record.role == role)
        records.append(replace(record, outputs={k: v + ringing for k, v in record.outputs.items()}))
    return replace(dataset, records=tuple(records))


def test_a_slow_drive_is_thinned_and_keeps_every_sample_it_needs() -> None:
    dataset, nominal = slow_drive()
    found = thinned(dataset, nominal)
    assert dataset.sample_time is not None and found.sample_time is not None
    factor = round(found.sample_time / dataset.sample_time)
    assert factor > 1 and found.sample_time <= 5e-3 + 1e-12
    for old, new in zip(dataset, found, strict=True):
        assert new.role == old.role and np.allclose(new.time, old.time[::factor][: new.n_samples])
        for name, values in new.outputs.items():
            assert np.allclose(values, old.outputs[name][::factor][: new.n_samples], rtol=0, atol=1e-12)
        for name, values in new.inputs.items():
            whole = old.inputs[name][: factor * (new.n_samples - 1)].reshape(-1, factor)
            assert np.allclose(values[: len(whole)], whole.mean(1))


def test_what_rings_between_the_samples_forbids_it_in_train_records_alone() -> None:
    dataset, nominal = slow_drive()
    loud = 0.1 * float(np.std(dataset.records[0].outputs["q_m1"]))
    assert thinned(with_output(dataset, loud, "train"), nominal).sample_time == dataset.sample_time
    quiet = thinned(dataset, nominal).sample_time
    assert thinned(with_output(dataset, loud, "test"), nominal).sample_time == quiet


def test_records_without_one_sample_time_and_short_ones_stay() -> None:
    dataset, nominal = slow_drive()
    stamped = replace(dataset, sample_time=None)
    assert thinned(stamped, nominal) is stamped
    short = replace(dataset, records=tuple(r.between(r.time[0], r.time[150]) for r in dataset))
    assert thinned(short, nominal) is short

"""Errors on records that no fit has seen, by record and output, and how far the gap shrinks."""

from dataclasses import replace

import numpy as np
import pytest
from drives import flexible_drive, make_records, multisine
from gapcase import small_case
from hypothesis import given
from hypothesis import strategies as st

import hybrid_id.diagnosis.errors_on_test as module
from hybrid_id.diagnosis.errors_on_test import Errors, repeatability, shrink
from hybrid_id.diagnosis.fits import engine
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record


def made(rng: np.random.Generator, size: float, blocks: int, noise: float = 0.0) -> Errors:
    """Errors of one record whose blocks scatter by a fifth about a size."""
    squares = size**2 * (1 + 0.2 * rng.standard_normal(blocks))
    nrmse = float(np.sqrt(squares.mean()))
    return Errors(nrmse, {"run": nrmse}, {"q_m1": nrmse}, ((squares,),), noise)


def test_share_lies_in_its_interval(rng: np.random.Generator) -> None:
    found = shrink(made(rng, 0.1, 16), made(rng, 0.03, 16), 0.01)
    assert found.share == pytest.approx(
        (found.refit - found.with_effect) / (found.refit - found.floor), rel=1e-12
    )
    assert found.interval[0] < found.share < found.interval[1]
    assert 0.6 < found.share < 0.9


def test_more_blocks_tell_more(rng: np.random.Generator) -> None:
    few, many = (shrink(made(rng, 0.1, n), made(rng, 0.05, n, 0.049), 0.049) for n in (6, 600))
    assert np.ptp(many.interval) < 0.5 * np.ptp(few.interval)


def test_the_floor_is_known_to_lie_above_the_noise_only(rng: np.random.Generator) -> None:
    before = made(rng, 0.1, 600)
    sure = shrink(before, made(rng, 0.05, 600, noise=0.049), 0.049)
    unsure = shrink(before, made(rng, 0.05, 600, noise=0.01), 0.049)
    assert sure.interval[0] > 0.9
    assert unsure.interval[0] == pytest.approx(0.05 / 0.09, abs=0.08)
    assert unsure.interval[1] >= unsure.share > 0.95


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0), st.floats(0.0, 1.0), st.integers(0, 5))
def test_an_interval_holds_its_share_however_little_there_was_to_close(
    first: float, second: float, floor: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    found = shrink(made(rng, first, 4), made(rng, second, 4), floor * second)
    assert found.interval[0] <= found.share <= found.interval[1]


def test_what_errs_more_than_before_has_an_interval_below_zero_that_holds_its_share(
    rng: np.random.Generator,
) -> None:
    found = shrink(made(rng, 0.05, 60), made(rng, 0.15, 60, noise=0.01), 0.02)
    assert found.interval[0] < found.share < found.interval[1] < 0.0


def test_nothing_is_closed_where_nothing_changes(rng: np.random.Generator) -> None:
    same = made(rng, 0.1, 16)
    assert shrink(same, same, 0.05).share == 0.0
    assert shrink(same, same, same.nrmse).share == 0.0


def test_a_model_may_do_better_by_chance_than_the_right_one(rng: np.random.Generator) -> None:
    before, after = made(rng, 0.1, 30), made(rng, 0.05, 30, noise=0.06)
    found = shrink(before, after, after.nrmse)
    right = 1.01 * after.nrmse  # the floor is a hundredth higher on these records
    assert found.interval[0] < (before.nrmse - after.nrmse) / (before.nrmse - right) < found.interval[1]
    assert found.interval[1] < 1.3


def test_errors_over_one_window_of_a_whole_record_are_those_of_the_record() -> None:
    dataset, nominal = small_case()
    whole = module.errors(dataset, nominal, engine())
    length = max(r.time[-1] for r in dataset.test)
    same = module.errors(dataset, nominal, engine(), horizon=Horizon("windows", 1.1 * length))
    assert whole is not None and same is not None
    assert same.nrmse == whole.nrmse and same.by_record == whole.by_record
    few = module.errors(dataset, nominal, engine(), horizon=Horizon("windows", 0.4 * length))
    assert few is not None and few.nrmse < whole.nrmse  # two windows, though fits want four
    short = module.errors(dataset, nominal, engine(), horizon=Horizon("windows", 0.3))
    assert short is not None and short.by_record.keys() == whole.by_record.keys()
    assert short.nrmse < whole.nrmse  # each begins at a measured state
    assert sum(len(b) for row in short.blocks for b in row) >= sum(
        len(b) for row in whole.blocks for b in row
    )


def test_errors_by_output_and_by_record_have_one_mean() -> None:
    drive, noise = flexible_drive(), {"q_m1": 1e-3, "q_a1": 1e-5}
    voltages = [multisine(k, samples=300, amplitude=6.0 + k, rest=20, step=0.005) for k in range(3)]
    records = make_records(drive, voltages, noise=noise, outputs=tuple(noise), step=0.005)
    channels = (Channel("u1", "V"),), tuple(Channel(n, "rad", std) for n, std in noise.items())
    dataset = Dataset("both", *channels, tuple(records), 0.005)
    off = drive.with_values({"F_cm": 0.02})
    found = module.errors(dataset, off, engine(), records)
    assert found is not None and set(found.by_output) == {"q_m1", "q_a1"}
    assert found.nrmse == pytest.approx(np.mean(list(found.by_output.values())))
    assert found.nrmse == pytest.approx(np.mean(list(found.by_record.values())))
    for c, output in enumerate(("q_m1", "q_a1")):
        one = module.errors(dataset, off, engine(), records[:1])
        assert one is not None and one.by_output[output] == pytest.approx(
            np.sqrt(one.blocks[0][c].mean()), rel=0.05
        )


def test_a_record_that_stands_still_has_no_error_over_its_spread() -> None:
    dataset, nominal = small_case()
    (moving,) = dataset.test
    still = {name: np.full_like(values, 0.3) for name, values in moving.outputs.items()}
    resting = replace(moving, outputs=still, name="still")
    both = module.errors(replace(dataset, records=(*dataset.train, moving, resting)), nominal, engine())
    assert both is not None and set(both.by_record) == {moving.name}
    assert module.errors(replace(dataset, records=(*dataset.train, resting)), nominal, engine()) is None
    assert module.errors(replace(dataset, records=dataset.train), nominal, engine()) is None


def test_errors_leave_out_where_in_a_count_an_encoder_began(sound) -> None:
    """One that rounds and one that counts edges are off by half a count from each other, which has no colour."""
    dataset, _, found = sound
    count, seen = 0.1, []
    for phase in (0.5, 0.0, 0.8):
        read = tuple(
            replace(r, outputs={n: count * np.floor(q / count + phase) for n, q in r.outputs.items()})
            for r in dataset.records
        )
        seen.append(module.errors(replace(dataset, records=read), found.search.base.system, engine()))
    assert all(one is not None and one.autocorrelation < 0.1 for one in seen)
    sizes = [one.over_noise for one in seen if one is not None]
    assert max(sizes) < 1.1 * min(sizes)


def test_the_floor_of_a_repeated_record_is_its_repeatability(rng: np.random.Generator) -> None:
    """Two runs of one input scatter by what no model predicts; another input, or another start, repeats nothing."""
    time = np.arange(2000) * 0.005
    u, y = np.sin(3.0 * time), 2.0 * np.sin(3.0 * time - 0.4)

    def run(name: str, role: str, volts: np.ndarray, start: float = 0.0) -> Record:
        angle = y + start + 0.005 * rng.standard_normal(len(time))
        return Record(name, time, {"u1": volts}, {"q_m1": angle}, role)

    def of(*records: Record) -> Dataset:
        return Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), records)

    again = of(run("a", "train", u), run("b", "train", u[::-1].copy()), run("c", "test", u))
    assert repeatability(again) == pytest.approx(0.005 / y.std(), rel=0.05)
    assert repeatability(of(run("a", "train", u[::-1].copy()), run("c", "test", u))) is None
    assert repeatability(of(run("a", "train", u, 1.0), run("c", "test", u))) is None

"""What an ablation says of given cells: pairing, the choice by validation, the answer in words."""

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy import stats

from hybrid_id.errors import InputError
from hybrid_id.study.ablation import Arm, Cell, CellResult, Rung, Split
from hybrid_id.study.ablation_result import HYBRID, OPEN, PHYSICS, Ablation, answer, gather, verdict

NETWORK, OTHER = Arm("static", ("joint1/motor",), 8), Arm("memory", ("joint1/motor",), 8)
SPLIT = Split(("a", "b"), ("v",), ("t", "u"), ("far",))
PHYSICS_ERROR = [4.0, 5.0, 3.0, 6.0, 4.5]


def cell(
    arm: Arm, seed: int, test: float, *, validation: float = 1.0, far: float = 2.0, **other
) -> CellResult:
    """A cell whose two test records miss by the same."""
    errors = {"a": 1.0, "b": 1.0, "v": validation, "t": test, "u": test, "far": far}
    role = {"share": 0.1, "overlap": 0.2} | other
    bare = Rung(math.inf, errors, {"t": 1.0}, {"J": 2.0}, {"J": 0.1}, 0.0, 0.0, "converged")
    rung = Rung(1.0, errors, {"t": 1.0}, {"J": 2.1}, {"J": 0.1}, **role, status="converged")
    rungs = (bare, rung) if arm.hybrid else (bare,)
    return CellResult(Cell(arm, seed, SPLIT), rungs, len(rungs) - 1, 0.0, {}, {})


def compared(factors: Mapping[Arm, list[float]], **settings) -> Ablation:
    """Physics only and arms whose test error is its own times a factor a seed."""
    cells = [cell(Arm(), seed, error, validation=3.0) for seed, error in enumerate(PHYSICS_ERROR)]
    for arm, factor in factors.items():
        cells += [
            cell(arm, s, f * e, **settings)
            for s, (f, e) in enumerate(zip(factor, PHYSICS_ERROR, strict=True))
        ]
    return gather(cells)


def test_changes_are_paired_by_seed() -> None:
    factors = [0.30, 0.32, 0.29, 0.31, 0.30]
    result = compared({NETWORK: factors})
    _, scores = result.scores
    change = scores.change["test"]
    plain = stats.ttest_1samp(np.log(factors), 0.0).confidence_interval(0.95)
    wider = math.sqrt((1 / 5 + SPLIT.overlap) * 5)  # two records tested on, three worked with
    assert SPLIT.overlap == pytest.approx(2 / 3) and change.n_pairs == 5
    assert change.upper - change.mean == pytest.approx(wider * (plain.high - np.mean(np.log(factors))))
    assert scores.percent("test")[0] == pytest.approx(100 * (np.exp(np.mean(np.log(factors))) - 1))
    assert scores.drift == pytest.approx(0.1 / math.hypot(0.1, 0.1))


@pytest.mark.parametrize(
    ("factors", "outcome", "words"),
    [
        ([0.30, 0.32, 0.29, 0.31, 0.30], HYBRID, "Hybrid: static network at joint1/motor, 8 wide"),
        ([1.0, 1.001, 0.999, 1.0, 1.0], PHYSICS, "not worth its freedom"),
        ([0.99, 0.991, 0.989, 0.99, 0.99], PHYSICS, "not worth its freedom"),  # a gain, but too small
        ([0.3, 2.0, 0.5, 1.5, 0.8], OPEN, "do not show"),
        ([0.3, 0.3, math.inf, 0.3, 0.3], PHYSICS, "diverged in 1 of 5"),
    ],
)
def test_the_answer_weighs_gain_and_chance(factors: list[float], outcome: str, words: str) -> None:
    result = compared({NETWORK: factors})
    assert answer(result) == outcome and words in verdict(result)[0]


def test_the_network_is_chosen_by_validation_and_judged_by_test() -> None:
    cells = [cell(Arm(), s, e, validation=3.0) for s, e in enumerate(PHYSICS_ERROR)]
    cells += [cell(NETWORK, s, 0.1 * e, validation=2.0) for s, e in enumerate(PHYSICS_ERROR)]
    cells += [cell(OTHER, s, 1.0 * e, validation=1.0) for s, e in enumerate(PHYSICS_ERROR)]
    result = gather(cells)
    assert result.best is not None and result.best.arm == OTHER and answer(result) == PHYSICS


def test_cautions_are_said() -> None:
    words = " ".join(verdict(compared({NETWORK: [0.3] * 5}, far=8.0, overlap=0.9)))
    assert "Out of range it harms" in words and "do not read these as physical" in words
    words = " ".join(verdict(compared({NETWORK: [0.3] * 5}, far=1.0)))
    assert "Out of range it helps" in words and "physical" not in words


def test_a_broken_cell_takes_only_itself_out() -> None:
    cells = [cell(Arm(), s, e) for s, e in enumerate(PHYSICS_ERROR)]
    cells += [cell(NETWORK, s, 0.3 * e) for s, e in enumerate(PHYSICS_ERROR) if s != 2]
    result = gather(cells, {"static-seed-2": "MemoryError: no more"})
    assert result.scores[1].seeds == (0, 1, 3, 4) and result.scores[1].change["test"].n_pairs == 4
    assert "1 cell came to nothing" in " ".join(verdict(result))
    with pytest.raises(InputError, match="no fit of physics only came to an end"):
        gather([cell(NETWORK, 0, 1.0)], result.failed)


def test_one_repeat_has_no_interval_and_no_answer() -> None:
    result = gather([cell(Arm(), 0, 4.0), cell(NETWORK, 0, 1.0)])
    assert answer(result) == OPEN and math.isnan(result.scores[1].change["test"].upper)
    words = " ".join(verdict(result))
    assert "test error -75.0 % (one repeat, no interval);" in words and "nan" not in words


def test_physics_only_alone_answers_nothing() -> None:
    result = gather([cell(Arm(), 0, 4.0)])
    assert result.best is None and "nothing can be said" in verdict(result)[0]

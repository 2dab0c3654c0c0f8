"""Residual tests in words: the verdict first, with the figures that it rests on."""

import math

import pytest

from hybrid_id.reporting.residuals import residual_result, sentence
from hybrid_id.statistics.residuals import Follows, ResidualTest

WHITE = ResidualTest("q_m1", 4000, 1.02, 100, 0.01, 0.4, 0.003, (Follows("u1", 0.01, 3, 0.06),))
FAINT = ResidualTest("q_m1", 4000, 1.05, 100, 0.05, 1e-4, 0.06, ())
SMOOTH = ResidualTest("q_m1", 4000, 7.3, 100, 0.9, 0.0, 0.84, (Follows("u1", 0.05, 3, 0.3),))
LATE = ResidualTest("q_m1", 4000, 2.1, 100, 0.02, 0.3, 0.04, (Follows("u1", -0.31, 7, 0.06),))
COUNTS = ResidualTest("q_m1", 4000, 0.3, 100, 0.9, 0.0, 0.6, ())
LOST = ResidualTest("q_m1", 4000, math.inf, 100, math.nan, math.nan, math.nan, ())


@pytest.mark.parametrize(
    ("test", "words"),
    [
        (WHITE, "white: nothing left to model. The residual is 1.02 times the noise (RMS)."),
        (FAINT, "nearly white: next to nothing left to model."),
        (SMOOTH, "not white: neighbours correlate by 0.84, as where an effect is missing"),
        (LATE, "not white: the residual follows u1 (correlation -0.31, 7 samples later)"),
        (COUNTS, "not white, but only 0.3 times the noise"),
        (LOST, "the simulation has diverged"),
    ],
)  # fmt: skip
def test_each_verdict_is_a_sentence(test: ResidualTest, words: str) -> None:
    assert sentence(test).startswith(words)
    assert sentence(test).endswith(".")


def test_plain_data_has_every_figure() -> None:
    (told,) = residual_result({"corrected": [LATE]})["corrected"]
    assert told["verdict"] == "not white" and told["inputs"]["u1"]["lag"] == 7

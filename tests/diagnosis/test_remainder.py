"""What the chosen model leaves, on a drive whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from gapcase import small_case

import hybrid_id.diagnosis.remainder as module
from hybrid_id.components import Backlash
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.diagnosis.remainder import halted_elsewhere, no_noise, outside, worst_unseen
from hybrid_id.reporting.gap_words import gap_line


def test_what_only_unseen_records_show_is_outside_the_catalogue(diagnosed, sound) -> None:
    first, chosen = diagnosed[2].refit, diagnosed[2].search.chosen
    assert first is not None and chosen.effects

    def lacks(explanation: Explanation, size: float, share: float) -> bool:
        return outside(explanation, first, replace(first, nrmse=size * first.nrmse, coloured=share))

    # the spring fits the train records to the noise; what it leaves of the gap on the test record decides
    assert lacks(chosen, 0.6, 0.9)
    assert not lacks(chosen, 0.6, 0.2)
    assert not lacks(chosen, 0.2, 0.4)
    # or that most of it has a cause, where the model follows the records
    assert lacks(chosen, 0.2, 0.9)
    assert not outside(chosen, replace(first, nrmse=10.0), replace(first, nrmse=1.0, coloured=0.9))
    wave = replace(chosen, effects=(("cogging", "joint1/motor"),))
    assert not lacks(wave, 0.2, 0.9)  # it may have halted at another detent
    # without an effect there is no gap that could have closed
    assert lacks(sound[2].search.chosen, 0.2, 0.9)
    assert not lacks(sound[2].search.chosen, 0.2, 0.2)


def test_free_runs_that_halt_at_another_detent_are_judged_from_measured_states(
    diagnosed, monkeypatch
) -> None:
    dataset, _, found = diagnosed
    spring, base, lost = found.search.chosen, found.search.base, replace(found.refit, coloured=0.9)
    wave, refit = replace(spring, effects=(("cogging", "joint1/motor"),)), Refit(dataset)
    assert not halted_elsewhere(refit, base, wave, lost)  # records of less than four windows tell nothing
    monkeypatch.setattr(module, "WINDOW", 0.3)
    assert halted_elsewhere(refit, base, wave, lost)
    assert not outside(wave, found.refit, lost, halted=True)
    assert not halted_elsewhere(refit, base, spring, lost)  # a spring has no detents
    assert not halted_elsewhere(refit, base, wave, replace(lost, coloured=0.2))
    assert not halted_elsewhere(refit, wave, wave, lost)  # where nothing is missing, nothing can be closed
    # a machine that the model does not follow from measured states either
    other = Refit(replace(dataset, records=(*dataset.train, small_case()[0].test[0])))
    assert not halted_elsewhere(other, base, wave, lost)
    assert "another detent" in gap_line(replace(found, halted=True))


def test_behind_play_test_errors_lower_the_claim_and_not_the_verdict(diagnosed) -> None:
    found = diagnosed[2]
    loose = found.model.with_component("joint1/transmission", Backlash(gap=0.01))
    chosen = replace(found.search.chosen, result=replace(found.search.chosen.result, system=loose))
    bad = replace(found.refit, coloured=0.9)
    assert not outside(chosen, found.refit, bad)
    assert no_noise(chosen, found.left, bad) == 0.9
    assert no_noise(chosen, found.left, replace(bad, coloured=0.1)) == 0.1


def test_colour_that_random_torques_leave_is_taken_for_noise(diagnosed) -> None:
    found = diagnosed[2]
    chosen, after = found.search.chosen, (replace(found.left[0], share=0.0),)
    assert no_noise(chosen, after, replace(found.refit, coloured=0.2)) == 0.0
    assert no_noise(chosen, after, replace(found.refit, coloured=0.6)) == pytest.approx(0.6)


def test_a_test_record_is_opened_only_where_another_can_bear_it_out(diagnosed) -> None:
    found = diagnosed[2]
    chosen, two = found.search.chosen, replace(found.refit, over_noise={"a": 2.0, "b": 5.0})
    assert worst_unseen(chosen, two, True) == "b"
    assert worst_unseen(chosen, replace(two, over_noise={"b": 5.0}), True) is None
    assert worst_unseen(chosen, None, True) is None
    assert worst_unseen(chosen, replace(two, coloured=0.25), True) is None
    # where a torque over the angle acts, free runs may be halted elsewhere: the rest has to be large
    waved = replace(chosen, effects=(("cogging", "joint1/motor"),))
    assert worst_unseen(waved, two, False) is None and worst_unseen(waved, two, True) == "b"
    # the train records show it themselves
    wave = np.sin(0.01 * np.arange(4000))[:, None]
    assert worst_unseen(replace(chosen, result=replace(chosen.result, residual=(wave,))), two, True) is None
    loose = found.model.with_component("joint1/transmission", Backlash(gap=0.01))
    assert worst_unseen(replace(chosen, result=replace(chosen.result, system=loose)), two, True) is None

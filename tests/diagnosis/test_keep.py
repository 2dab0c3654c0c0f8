"""Fits that a search keeps: a search that was stopped goes on with them and says the same to the last byte."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import text_of

import hybrid_id.diagnosis.fits as search_fits
import hybrid_id.diagnosis.select as selection
import hybrid_id.identification.fit as single_fit
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.diagnosis.fits import FULL, Fits, Task
from hybrid_id.diagnosis.model import Tally
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.keep import Kept
from hybrid_id.reporting.diagnosis import diagnosis_table
from hybrid_id.reporting.diagnosis_words import failed_lines

HALF = Horizon("windows", 0.5)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Kept:
    return Kept(tmp_path_factory.mktemp("fits"), "this program")


def test_a_stopped_search_goes_on_to_the_same_answer(diagnosed, stopped: Kept, monkeypatch) -> None:
    dataset, nominal, whole = diagnosed

    def stop(stage: str, done: int, total: int) -> None:
        if done == 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        diagnose(dataset, nominal, max_effects=1, kept=stopped, progress=stop)
    assert 20 <= stopped.count < 40
    again = diagnose(dataset, nominal, max_effects=1, kept=stopped)
    assert json.dumps(again.as_dict()) == json.dumps(whole.as_dict())
    count = stopped.count

    def again_fitted(*_: object, **__: object) -> None:
        raise AssertionError("a fit that is kept")

    monkeypatch.setattr(search_fits, "_fit", again_fitted)
    monkeypatch.setattr(single_fit, "fit", again_fitted)  # those of no search, too: before, between and after
    once_more = diagnose(dataset, nominal, max_effects=1, kept=stopped)
    assert json.dumps(once_more.as_dict()) == json.dumps(whole.as_dict()) and stopped.count == count


def test_what_a_search_has_found_is_told_when_it_is_stopped(diagnosed, stopped: Kept, monkeypatch) -> None:
    dataset, nominal, whole = diagnosed

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(selection, "_freed", stop)
    cut = diagnose(dataset, nominal, max_effects=1, kept=stopped)
    assert cut.interrupted and cut.verdict == "effects"
    assert [one.name for one in cut.selected] == [one.name for one in whole.selected]


def test_other_records_horizons_and_programs_are_fitted_anew(diagnosed, tmp_path: Path) -> None:
    dataset, nominal, _ = diagnosed
    keep, asked = Kept(tmp_path, "this program"), [Task((), nominal)]
    (first,) = Fits(dataset, kept=keep).run(asked, 1)
    assert first is not None and keep.count == 1
    (again,) = Fits(dataset, kept=keep).run(asked, 1)
    assert keep.count == 1 and again is not None
    assert np.array_equal(again.result.values, first.result.values) and again.error == first.error
    assert again.system.theta().equal(first.system.theta())
    for number, fits in enumerate(
        (
            Fits(dataset.select([r.name for r in dataset.records[1:]]), kept=keep),
            Fits(dataset, kept=keep, horizon=HALF),
            Fits(dataset, kept=Kept(tmp_path, "another program")),
        )
    ):
        fits.run(asked, 1)
        assert keep.count == number + 2
    Fits(dataset, kept=keep).run([Task((), nominal, cost=1.0)], 1)
    Fits(dataset, kept=keep).run(asked, FULL)
    assert keep.count == 6


def test_the_horizon_is_what_was_asked_for(diagnosed) -> None:
    found = diagnose(*diagnosed[:2], max_effects=1, horizon=HALF)
    assert found.horizon == HALF and found.as_dict()["horizon"]["seconds"] == 0.5
    assert found.selected[0].name in ("spring_load", "gravity_load")  # alike over so short a time
    assert len(found.details.studies) == 2


@pytest.mark.parametrize("jobs", [1, 2])
def test_fits_that_raise_are_counted_and_told(diagnosed, tmp_path: Path, monkeypatch, jobs: int) -> None:
    """Class 10 of what breaks programs: what failed is never just absent, not after a resumption either."""
    dataset, nominal, whole = diagnosed
    name = ("spring_load", "joint1/load")
    reasons = iter(["the solver\nhas lost its way", "the solver has lost its way", "NaN"])

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError(next(reasons))

    tasks, keep = (
        [Task((name,), nominal), Task((), nominal, cost=1.0), Task((), nominal)],
        Kept(tmp_path, "this"),
    )
    with monkeypatch.context() as patch:
        patch.setattr(search_fits, "finite_difference_fit", broken)
        Fits(dataset, kept=keep).run(tasks, 1)
    fits = Fits(dataset, kept=keep, jobs=jobs)
    fits.fitted = search_fits.PARALLEL_FROM
    assert fits.over(HALF).run([Task((), nominal)], 1) != [None]
    assert fits.run(tasks, 1) == [None] * 3  # as they are kept
    (worst, count), *_ = fits.tally.failed.most_common()
    assert (fits.tally.tried, fits.tally.failed.total(), count) == (4, 3, 1)
    assert (worst.effects, worst.reason) == ((name,), "the solver has lost its way")
    found = replace(whole, tally=fits.tally)
    (line,) = failed_lines(found)
    assert line.startswith("3 of 4 fits of candidates failed: ") and "the solver has lost its way" in line
    assert "and 1 more kinds" in line and line in text_of(diagnosis_table(found), 2000)
    assert not failed_lines(replace(whole, tally=Tally(158)))

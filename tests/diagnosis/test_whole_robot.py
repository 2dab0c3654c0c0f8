"""How long a whole robot runs free."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from gapcase import small_case

from hybrid_id.diagnosis.fits import Fits, Task, with_priors
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.whole_robot import common_horizon, held
from hybrid_id.identification.horizons import WHOLE, Horizon


def answer(horizon: Horizon, inertia: float) -> Any:
    """A joint whose re-fitted model has so many times the true inertia."""
    dataset, nominal = small_case()
    (name,) = (info.name for info in nominal.table if info.symbol == "J")
    system = nominal.with_values({name: inertia * nominal.parameter(name).spec.value})
    fits = SimpleNamespace(horizon=horizon, dataset=dataset)
    return SimpleNamespace(fits=fits, found=SimpleNamespace(base=SimpleNamespace(system=system)))


def test_runs_that_have_lost_their_records_begin_again_from_measured_states() -> None:
    short = Horizon("windows", 0.5)
    good, lost = answer(WHOLE, 1.0), answer(WHOLE, 20.0)
    assert common_horizon({"lift": good, "elbow": good}) == WHOLE
    found = common_horizon({"lift": good, "elbow": lost})
    assert found.seconds == short.seconds and "elbow" in found.reason and "lift" not in found.reason
    # what a joint asks for anyway stays
    assert common_horizon({"lift": answer(short, 1.0), "elbow": lost}) == short


def test_a_joint_is_held_as_its_search_has_left_it() -> None:
    """Priors that the search itself has dropped would pull the others back to values that are wrong."""
    dataset, nominal = small_case()
    fits = Fits(dataset)
    free = fits.run([Task((), nominal)], 4)[0]
    assert free is not None
    base = replace(free, result=replace(free.result, system=with_priors(nominal, nominal, free, 0.1)))
    spring = ("spring_load", "joint1/load")
    richer = replace(free, effects=(spring,))

    def priors(chosen: FittedModel) -> list[float | None]:
        answer: Any = SimpleNamespace(searched=SimpleNamespace(chosen=chosen, base=base, steps=()))
        return [info.spec.prior_std for info in held(richer, answer).system.table]

    assert not any(priors(richer)) and any(priors(replace(base, effects=(spring,))))
    assert any(priors(base))  # what the search has not fitted is held as its base is
